//! What each link connects to.

use std::path::Path;

use spherecal_link::qemu::{Qemu, QemuOptions};
use spherecal_link::tcp::{Remote, RemoteDrive, Threaded};
use spherecal_link::{
    Attended, Controller, Device, Drive as _, LinkError, LocalDevice, Serial, check_drive, controller_in_process,
};
use spherecal_model::robots::RobotModel;
use spherecal_shared::robot::Robot;
use spherecal_store::Peer;

use super::link::Link;
use super::{Config, Connection, JobError, PreparedRun, loaded_model, native};

/// The device behind the link, with what `[host_link]` of the configuration does to frames. A controller that logs writes to
/// `folder`.
///
/// # Errors
/// The link cannot be used, nothing answers there, or another robot does.
pub fn device(prepared: &PreparedRun, link: &Link, folder: &Path) -> Result<Box<dyn Device>, JobError> {
    let connection = Connection {
        link,
        folder,
        early: None,
        repeated: false,
        in_file: true,
    };
    Ok(prepared.simulator.connect(prepared, connection)?.device)
}

/// The device behind the link, over a host link without losses. The simulator makes an arm that is in this process.
///
/// # Errors
/// The link cannot be used, nothing answers there, or another robot does.
pub fn reliable(prepared: &PreparedRun, link: &Link, folder: &Path) -> Result<Box<dyn Device>, JobError> {
    if let Some(device) = distant(&prepared.model, &prepared.config, link)? {
        return Ok(device);
    }
    let controller = controller(prepared, link, folder)?;
    let drive = prepared.simulator.arm(prepared)?;
    Ok(Box::new(LocalDevice::new(controller, drive, prepared.robot.dof())?))
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
        Link::Tcp(_) | Link::Udp(_) | Link::Franka { .. } | Link::Ur { .. } => open(),
        Link::Controller(_) | Link::Grpc(_) => open().map(|_| None),
        Link::Serial(device) => Serial::check(device).map(|()| None).map_err(JobError::from),
        Link::Fri(_) => native::can_listen(link).map(|()| None),
        Link::Sim | Link::Qemu => Ok(None),
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
        Link::Serial(device) => attended(Serial::open(device)?),
        Link::Tcp(address) => {
            let drive = RemoteDrive::connect(address).map_err(LinkError::from)?;
            check_drive(drive.hello(), robot)?;
            if !drive.hello().lock_step {
                return attended(Threaded::start(Box::new(drive), joints)?);
            }
            let controller = controller_in_process(joints)?;
            Ok(Some(Box::new(LocalDevice::new(controller, Box::new(drive), joints)?)))
        }
        Link::Udp(address) => {
            let drive = RemoteDrive::at_socket(address).map_err(LinkError::from)?;
            check_drive(drive.hello(), robot)?;
            attended(Threaded::start(Box::new(drive), joints)?)
        }
        Link::Franka { .. } | Link::Fri(_) | Link::Ur { .. } => {
            let drive = native::drive(model, config, link)?;
            check_drive(drive.hello(), robot)?;
            attended(Threaded::start(drive, joints)?)
        }
        Link::Controller(address) => {
            let remote = Remote::connect(address, joints)?;
            check_drive(remote.hello(), robot)?;
            attended(remote)
        }
        Link::Grpc(peer) => remote_robot(robot, peer),
    }
}

/// A device whose time does not wait for this program, with a thread that nothing else can hold up.
fn attended(device: impl Device + 'static) -> Result<Option<Box<dyn Device>>, JobError> {
    Ok(Some(Box::new(Attended::start(device)?)))
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
fn remote_robot(robot: &Robot, peer: &Peer) -> Result<Option<Box<dyn Device>>, JobError> {
    attended(spherecal_services::grpc::RemoteRobot::attach(peer, robot)?)
}

#[cfg(not(feature = "services"))]
fn remote_robot(_robot: &Robot, _peer: &Peer) -> Result<Option<Box<dyn Device>>, JobError> {
    Err(JobError::Feature {
        what: "a robot behind gRPC (--link grpc:)",
        feature: "services",
    })
}
