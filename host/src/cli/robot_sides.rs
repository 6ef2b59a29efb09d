//! `spherecal plant --fci` and `--fri`: the simulated arm behind a robot's own interface, in real
//! time.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use spherecal_fci::TCP_PORT;
use spherecal_fci::robot::{RobotConfig, RobotSide, Tolerance};
use spherecal_fci::wire::Version;
use spherecal_fri::robot::{CabinetConfig, CabinetSide};
use spherecal_fri::wire::SessionState;

use super::exit::{CliError, Exit};
use super::interrupt::interrupt;
use super::out::errln;
use super::servers::{PlantArgs, announce};
use spherecal_job as job;

/// Interval at which the simulated application and Ctrl-C are looked after.
const LOOK: Duration = Duration::from_millis(50);
/// Time without a motion after which the simulated application starts the next one.
const NEXT_MOTION: Duration = Duration::from_millis(500);

/// `[HOST:]PORT`; a port alone is on this machine only.
fn address(text: &str) -> Result<SocketAddr, CliError> {
    text.parse()
        .or_else(|_| {
            text.parse()
                .map(|port: u16| SocketAddr::from((Ipv4Addr::LOCALHOST, port)))
        })
        .map_err(|_| CliError::input(format!("--listen: \"{text}\" is no address: give PORT or IP:PORT")))
}

/// Says that other machines can reach the robot.
fn warn(ip: IpAddr) {
    if !ip.is_loopback() {
        errln!(
            "warning: other computers can reach this simulated robot at {ip}. Its interface has no password, like \
             the robot's own. Use it in a network that you trust"
        );
    }
}

/// `spherecal plant --fci`
pub(super) fn franka(args: &PlantArgs) -> Result<Exit, CliError> {
    let number = args.version.unwrap_or(Version::V10.number());
    let version =
        Version::from_number(number).map_err(|_| CliError::input(format!("--version {number}: give 5, 7, 8 or 10")))?;
    let mut config = args.configuration()?;
    if args.config.is_none() {
        let robot = if version.is_panda() { "panda" } else { "fr3" };
        robot.clone_into(&mut config.robot);
    }
    let arm = job::simulated_robot(&config, (0.0, 0.0))?;
    let mut side = RobotConfig::new(version);
    side.address = match &args.listen {
        Some(text) => address(text)?,
        None => SocketAddr::from((Ipv4Addr::LOCALHOST, TCP_PORT)),
    };
    if args.tolerant {
        side.tolerance = Tolerance::tolerant();
    }
    warn(side.address.ip());
    let asked = side.address;
    let interrupt = interrupt()?;
    let side = RobotSide::start(side, Box::new(arm))
        .map_err(|error| CliError::input(format!("cannot listen at {asked}: {error}; is another robot running?")))?;
    announce(&format!(
        "Franka Control Interface, version {number} ({}), on franka:{}",
        config.robot,
        side.address()
    ));
    wait(&interrupt, || ());
    let s = side.shut_down();
    errln!(
        "{} periods ({} behind the wall clock), {} commands, {} missing, {} late, {} after a stop",
        s.periods,
        s.slipped,
        s.commands,
        s.missing,
        s.late,
        s.commands_after_stop
    );
    Ok(Exit::Done)
}

/// `spherecal plant --fri`
pub(super) fn kuka(args: &PlantArgs, client: SocketAddr) -> Result<Exit, CliError> {
    if !(0.0..=5000.0).contains(&args.stiffness) {
        return Err(CliError::input("--stiffness: give 0 to 5000 N m/rad"));
    }
    let config = args.configuration()?;
    // As much damping as stiffness for an inertia of 1 kg m2 and Lehr's damping ratio 0.7.
    let damping = 1.4 * args.stiffness.sqrt();
    let arm = job::simulated_robot(&config, (args.stiffness, damping))?;
    let mut side = CabinetConfig {
        client,
        ..CabinetConfig::new()
    };
    let model = job::loaded_model(&config)?;
    for (limit, joint) in side.torque_limit.iter_mut().zip(&model.robot.joints) {
        *limit = joint.limits.torque_nm;
    }
    if args.tolerant {
        side.tolerance = spherecal_fri::robot::Tolerance::tolerant();
    }
    warn(client.ip());
    let interrupt = interrupt()?;
    let side = CabinetSide::start(side, Box::new(arm))
        .map_err(|error| CliError::job(format!("cannot send to {client}: {error}")))?;
    announce(&format!(
        "Fast Robot Interface ({}), sending to fri:{client}",
        config.robot
    ));
    // The application: a person confirms each motion at once.
    side.controls().command.store(true, Ordering::Relaxed);
    let mut without_motion = Instant::now();
    wait(&interrupt, || {
        let moving = matches!(
            side.statistics().session,
            Some(SessionState::CommandingWait | SessionState::CommandingActive)
        );
        let command = &side.controls().command;
        if moving {
            without_motion = Instant::now();
        } else if !command.load(Ordering::Relaxed) {
            command.store(true, Ordering::Relaxed);
        } else if without_motion.elapsed() > NEXT_MOTION {
            // Off and on again starts the next motion.
            command.store(false, Ordering::Relaxed);
            without_motion = Instant::now();
        }
    });
    let s = side.shut_down();
    errln!(
        "{} periods ({} behind the wall clock), {} answered, {} missing, {} late, {} torques after a stop",
        s.periods,
        s.slipped,
        s.answered,
        s.missing,
        s.late,
        s.torques_after_stop
    );
    Ok(Exit::Done)
}

/// Until Ctrl-C.
fn wait(interrupt: &AtomicBool, mut look: impl FnMut()) {
    while !interrupt.load(Ordering::Relaxed) {
        look();
        std::thread::sleep(LOOK);
    }
}
