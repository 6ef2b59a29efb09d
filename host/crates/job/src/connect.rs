//! What each link connects to.

use std::path::Path;

use spherecal_link::qemu::{Qemu, QemuOptions};
use spherecal_link::tcp::{Remote, TcpDrive, Threaded, check_limits};
use spherecal_link::{Controller, Device, Drive as _, LinkError, LocalDevice, Serial, controller_in_process};
use spherecal_model::robots::RobotModel;
use spherecal_shared::robot::Robot;
use spherecal_sim::inject::{self, FaultyCell, FaultyDrive, HostFaults};
use spherecal_sim::{Injected, InjectedCounter, LossyDevice, simulated_arm};
use spherecal_store::Peer;

use super::link::Link;
use super::{Config, JobError, PreparedRun, loaded_model, native};

/// The connected device, with handles to the injected faults.
pub(super) struct ConnectedDevice {
    pub(super) device: Box<dyn Device>,
    /// Faults of this computer, if faults are injected.
    pub(super) host_faults: Option<HostFaults>,
    /// What is done to frames of the host link.
    counters: Vec<InjectedCounter>,
}

impl ConnectedDevice {
    /// A device to which nothing is done.
    fn plain(device: Box<dyn Device>) -> Self {
        Self {
            device,
            host_faults: None,
            counters: Vec::new(),
        }
    }

    /// What was done to frames of the host link.
    pub(super) fn injected(&self) -> Injected {
        self.counters
            .iter()
            .fold(Injected::default(), |sum, counter| sum.plus(counter.get()))
    }
}

/// The device behind the link, with the injected faults around it. A controller that logs writes to
/// `folder`.
///
/// # Errors
/// The link cannot be used, nothing answers there, or another robot does.
pub fn device(prepared: &PreparedRun, link: &Link, folder: &Path) -> Result<Box<dyn Device>, JobError> {
    Ok(connect(prepared, link, folder, None, None)?.device)
}

/// Connects to the arm of `link` before the poses are planned, so that a link that cannot be used is told at once. The
/// device is for [`measure`](crate::measure). `None`: the arm is in this process, or its link is opened again for the
/// run, because a host that is silent during the planning would be disconnected, or because the robot connects to us.
///
/// # Errors
/// The link cannot be used, nothing answers there, or another robot does.
pub fn connect_early(config: &Config, link: &Link) -> Result<Option<Box<dyn Device>>, JobError> {
    let open = || distant(&loaded_model(config)?, config, link);
    match link {
        Link::Tcp(_) | Link::Franka { .. } => open(),
        Link::Controller(_) | Link::Grpc(_) => open().map(|_| None),
        Link::Serial(device) => Serial::check(device).map(|()| None).map_err(JobError::from),
        Link::Fri(_) => native::can_listen(link).map(|()| None),
        Link::Sim | Link::Qemu => Ok(None),
    }
}

/// As [`device`], with what is to go wrong. `early` is the device that [`connect_early`] gave, if it gave one.
pub(super) fn connect(
    prepared: &PreparedRun,
    link: &Link,
    folder: &Path,
    inject: Option<&inject::FaultPlan>,
    early: Option<Box<dyn Device>>,
) -> Result<ConnectedDevice, JobError> {
    let mut connected = match early {
        Some(device) => ConnectedDevice::plain(device),
        None => reliable(prepared, link, folder, inject)?,
    };
    let lossy = inject
        .and_then(|plan| plan.host_link)
        .unwrap_or(prepared.config.host_link);
    if lossy.is_active() {
        let device = LossyDevice::new(connected.device, lossy);
        connected.counters.push(device.injected());
        connected.device = Box::new(device);
    }
    Ok(connected)
}

/// Like [`connect`], over a host link without losses.
fn reliable(
    prepared: &PreparedRun,
    link: &Link,
    folder: &Path,
    inject: Option<&inject::FaultPlan>,
) -> Result<ConnectedDevice, JobError> {
    let joints = prepared.robot.dof();
    let Some(plan) = inject else {
        if let Some(device) = distant(&prepared.model, &prepared.config, link)? {
            return Ok(ConnectedDevice::plain(device));
        }
        let controller = controller(prepared, link, folder)?;
        let drive = simulated_arm(
            &prepared.robot,
            &prepared.tool,
            &prepared.plant,
            &prepared.plan.home.joints,
        )?;
        return Ok(ConnectedDevice::plain(Box::new(LocalDevice::new(
            controller, drive, joints,
        )?)));
    };
    let drive = match link {
        Link::Tcp(address) => FaultyDrive::Other(Box::new(lock_step_drive(prepared, link, address)?)),
        Link::Serial(_) | Link::Controller(_) | Link::Grpc(_) | Link::Franka { .. } | Link::Fri(_) => {
            return Err(no_injection(link));
        }
        Link::Sim | Link::Qemu => FaultyDrive::Simulated(simulated_arm(
            &prepared.robot,
            &prepared.tool,
            &prepared.plant,
            &prepared.plan.home.joints,
        )?),
    };
    let first = controller(prepared, link, folder)?;
    let (link, folder) = (link.clone(), folder.to_owned());
    let restart = Box::new(move || match link {
        Link::Qemu => Ok(Box::new(Qemu::start(&QemuOptions::new(&folder))?) as Box<dyn Controller>),
        _ => controller_in_process(joints),
    });
    let device = FaultyCell::new(first, drive, joints, plan, restart)?.ending_process();
    Ok(ConnectedDevice {
        host_faults: Some(device.host_faults()),
        counters: vec![device.injected()],
        device: Box::new(device),
    })
}

/// A drive in lock-step, as fault injection needs it.
fn lock_step_drive(prepared: &PreparedRun, link: &Link, address: &str) -> Result<TcpDrive, JobError> {
    let drive = TcpDrive::connect(address).map_err(LinkError::from)?;
    check_limits(&drive.hello().limits, &prepared.robot).map_err(LinkError::from)?;
    if drive.hello().lock_step {
        Ok(drive)
    } else {
        Err(no_injection(link))
    }
}

fn no_injection(link: &Link) -> JobError {
    JobError::NoInjection {
        link: link.to_string(),
        remedy: "faults can be injected only between a controller and a drive in lock-step: use sim, qemu or the tcp: link of such a drive"
            .to_owned(),
    }
}

/// The device of a link whose arm is outside this process; `None` if it is inside.
///
/// # Errors
/// The link cannot be used, nothing answers there, or another robot does.
pub fn distant(model: &RobotModel, config: &Config, link: &Link) -> Result<Option<Box<dyn Device>>, JobError> {
    let robot = &model.robot;
    let joints = robot.dof();
    match link {
        Link::Sim | Link::Qemu => Ok(None),
        Link::Serial(device) => Ok(Some(Box::new(Serial::open(device)?))),
        Link::Tcp(address) => {
            let drive = TcpDrive::connect(address).map_err(LinkError::from)?;
            check_limits(&drive.hello().limits, robot).map_err(LinkError::from)?;
            if !drive.hello().lock_step {
                return Ok(Some(Box::new(Threaded::start(Box::new(drive), joints)?)));
            }
            let controller = controller_in_process(joints)?;
            Ok(Some(Box::new(LocalDevice::new(controller, Box::new(drive), joints)?)))
        }
        Link::Franka { .. } | Link::Fri(_) => {
            let drive = native::drive(model, config, link)?;
            check_limits(&drive.hello().limits, robot).map_err(LinkError::from)?;
            Ok(Some(Box::new(Threaded::start(drive, joints)?)))
        }
        Link::Controller(address) => {
            let remote = Remote::connect(address, joints)?;
            check_limits(&remote.hello().limits, robot).map_err(LinkError::from)?;
            Ok(Some(Box::new(remote)))
        }
        Link::Grpc(peer) => remote_robot(robot, peer).map(Some),
    }
}

/// The controller of a link whose arm is in this process.
///
/// # Errors
/// QEMU or its image is missing, or no controller exists for that number of joints.
pub fn controller(prepared: &PreparedRun, link: &Link, folder: &Path) -> Result<Box<dyn Controller>, JobError> {
    match link {
        Link::Qemu => Ok(Box::new(Qemu::start(&QemuOptions::new(folder))?)),
        _ => Ok(controller_in_process(prepared.robot.dof())?),
    }
}

#[cfg(feature = "services")]
fn remote_robot(robot: &Robot, peer: &Peer) -> Result<Box<dyn Device>, JobError> {
    let robot = spherecal_services::grpc::RemoteRobot::attach(peer, robot)?;
    Ok(Box::new(robot))
}

#[cfg(not(feature = "services"))]
fn remote_robot(_robot: &Robot, _peer: &Peer) -> Result<Box<dyn Device>, JobError> {
    Err(JobError::Feature {
        what: "a robot behind gRPC (--link grpc:)",
        feature: "services",
    })
}
