//! Robots that are driven over their own interface: which one, with which settings, and simulated
//! ones for the other side.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use spherecal_cyclic::{Machine, this_machine};
use spherecal_fci::client as fci;
use spherecal_fri::client as fri;
use spherecal_link::native::{
    FrankaDrive, FrankaOptions, KukaDrive, KukaOptions, Undeclared, UrDrive, UrOptions, collision_behavior,
};
use spherecal_link::{Drive, LinkError};
use spherecal_model::robots::{RobotModel, UR_MOTOR_KG_M2};
use spherecal_shared::MAX_JOINTS;
use spherecal_shared::procedure::Procedure;
use spherecal_ur::client as ur;

use super::link::Link;
use super::{Config, DriveSection, JobError};

/// Largest rate of a commanded torque on a Franka robot, in N m/s. The robot stops at 1,000, its
/// client clamps to 999.
const FRANKA_RATE_NM_S: f64 = 990.0;

impl Link {
    /// The procedure within the limits of the robot behind this link.
    pub fn adapt(&self, mut procedure: Procedure) -> Procedure {
        if let Self::Franka { .. } = self {
            let rate = &mut procedure.law.torque_rate_nm_s;
            *rate = rate.min(FRANKA_RATE_NM_S);
        }
        procedure
    }

    /// Asks the robot behind the link which one it is: the name of a built-in robot. `None` where
    /// the link does not tell.
    ///
    /// # Errors
    /// The robot cannot be reached.
    pub fn robot(&self) -> Result<Option<&'static str>, JobError> {
        let Self::Franka { host, port } = self else {
            return Ok(None);
        };
        let client =
            fci::ReadOnlyClient::connect(&franka(host, *port, &DriveSection::default())).map_err(LinkError::device)?;
        Ok(Some(client.version().robot()))
    }
}

/// How long a robot may be silent before the drive reports it. Nothing can be commanded without a
/// state, and the robot's own clock says how many periods were missed.
const SILENCE: Duration = Duration::from_millis(500);

fn franka(host: &str, port: u16, waiting: &DriveSection) -> fci::ClientConfig {
    fci::ClientConfig {
        port,
        state_timeout: SILENCE,
        busy_poll_us: busy_poll(waiting),
        spin: Duration::from_micros(waiting.spin_us.into()),
        ..fci::ClientConfig::new(host)
    }
}

fn cabinet(address: SocketAddr, waiting: &DriveSection) -> fri::ClientConfig {
    fri::ClientConfig {
        address,
        timeout: SILENCE,
        busy_poll_us: busy_poll(waiting),
        spin: Duration::from_micros(waiting.spin_us.into()),
        ..fri::ClientConfig::new(fri::TorqueLimits::IIWA_7)
    }
}

/// Checks that this computer can listen for a cabinet, whose own session may begin at any time.
/// Errors: the port of a link `fri:` cannot be opened.
pub(super) fn can_listen(link: &Link) -> Result<(), JobError> {
    if let Link::Fri(address) = link {
        fri::ReadOnlyClient::listen(&cabinet(*address, &DriveSection::default())).map_err(LinkError::device)?;
    }
    Ok(())
}

fn undeclared(section: &DriveSection) -> Undeclared {
    Undeclared {
        motor_kg_m2: section.motor_kg_m2.iter().copied().take(MAX_JOINTS).collect(),
        latency_us: section.latency_us,
    }
}

fn busy_poll(waiting: &DriveSection) -> Option<u32> {
    Some(waiting.busy_poll_us).filter(|us| *us > 0)
}

/// The drive behind a link to a robot's own interface. It declares the load of the model's tool and
/// the thresholds of the configured procedure.
///
/// # Errors
/// The robot cannot be reached or refuses a setting, or the link is of another kind.
pub fn drive(model: &RobotModel, config: &Config, link: &Link) -> Result<Box<dyn Drive>, JobError> {
    drive_on(&this_machine(), model, config, link)
}

/// As [`drive`], with time and network of this machine.
///
/// # Errors
/// Those of [`drive`].
pub fn drive_on(
    machine: &Arc<dyn Machine>,
    model: &RobotModel,
    config: &Config,
    link: &Link,
) -> Result<Box<dyn Drive>, JobError> {
    let machine = Arc::clone(machine);
    let (procedure, waiting) = (&config.procedure, &config.cell.drive);
    match link {
        Link::Franka { host, port } => Ok(Box::new(FrankaDrive::connect(FrankaOptions {
            config: fci::ClientConfig {
                machine,
                ..franka(host, *port, waiting)
            },
            load: model.tool.body,
            thresholds: collision_behavior(procedure),
            undeclared: undeclared(waiting),
        })?)),
        Link::Fri(address) => Ok(Box::new(KukaDrive::listen(&KukaOptions {
            config: fri::ClientConfig {
                machine,
                ..cabinet(*address, waiting)
            },
            torque_rate: procedure.law.torque_rate_nm_s,
            robot: model.robot.clone(),
            tool: model.tool_in_table(),
            undeclared: undeclared(waiting),
        })?)),
        Link::Ur { host, port } => {
            let mut undeclared = undeclared(waiting);
            // Torques are commanded and measured at the motors: these always show.
            if undeclared.motor_kg_m2.is_empty() {
                undeclared.motor_kg_m2 = model.robot.joints.iter().map(|_| UR_MOTOR_KG_M2).collect();
            }
            Ok(Box::new(UrDrive::connect(UrOptions {
                config: ur::ClientConfig {
                    machine,
                    port: *port,
                    state_timeout: SILENCE,
                    ..ur::ClientConfig::new(host)
                },
                robot: model.robot.clone(),
                tool: model.tool_in_table(),
                load: model.tool.body,
                undeclared,
            })?))
        }
        other => Err(JobError::NoRobot {
            link: other.to_string(),
        }),
    }
}
