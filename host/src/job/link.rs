//! The links: how controller and drive are reached, and what stands behind each.

use std::path::Path;
use std::str::FromStr;

use super::{JobError, Prepared};
use crate::inject::{self, Ailing, Upsetting};
use crate::link::qemu::{Qemu, QemuOptions};
use crate::link::tcp::{Remote, TcpDrive, Threaded, check_limits};
use crate::link::{
    Cell, Controller, Device, Drive, LinkError, LossyDevice, Serial, controller_in_process, simulated_arm,
};
use crate::rpc::{Peer, RemoteRobot};

/// How controller and drive are reached.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Link {
    /// Both in this process.
    #[default]
    Sim,
    /// The controller on a Cortex-M7 in QEMU, the plant in this process.
    Qemu,
    /// A controller board on a serial device: `DEVICE` or `DEVICE@BAUD`.
    Serial(String),
    /// The controller in this process, an external simulator or the gateway of
    /// a real robot behind the drive link.
    Tcp(String),
    /// A controller process (`spherecal controller`), whatever its drive.
    Controller(String),
    /// A robot behind the service `RobotController` (`spherecal serve`).
    Grpc(Peer),
}

impl Link {
    /// Whether the arm is in this process, its tracker with it: a run over such a
    /// link goes on by being repeated, since what was there has ended with the
    /// process and does the same again for the same commands.
    pub(super) fn simulated(&self) -> bool {
        matches!(self, Self::Sim | Self::Qemu)
    }
}

impl FromStr for Link {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(peer) = Peer::parse(text) {
            return Ok(Self::Grpc(peer));
        }
        match text.split_once(':') {
            None if text == "sim" => Ok(Self::Sim),
            None if text == "qemu" => Ok(Self::Qemu),
            Some(("serial", device)) if !device.is_empty() => Ok(Self::Serial(device.to_owned())),
            Some(("tcp", address)) if address.contains(':') => Ok(Self::Tcp(address.to_owned())),
            Some(("controller", address)) if address.contains(':') => Ok(Self::Controller(address.to_owned())),
            _ => Err(format!(
                "\"{text}\" is no link: give sim, qemu, serial:DEVICE, tcp:HOST:PORT, controller:HOST:PORT, \
                 grpc:HOST:PORT or grpcs:HOST:PORT"
            )),
        }
    }
}

impl std::fmt::Display for Link {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Sim => f.write_str("sim"),
            Self::Qemu => f.write_str("qemu"),
            Self::Serial(device) => write!(f, "serial:{device}"),
            Self::Tcp(address) => write!(f, "tcp:{address}"),
            Self::Controller(address) => write!(f, "controller:{address}"),
            Self::Grpc(peer) => peer.fmt(f),
        }
    }
}
/// A device, and the ailments of this computer where faults are injected.
type Upset = (Box<dyn Device>, Option<Ailing>);
/// What stands behind the link, and behind what is done to it on purpose; a
/// controller that logs does so in `folder`.
///
/// # Errors
/// A link that cannot be used, or behind which nobody or another robot stands.
pub fn device(prepared: &Prepared, link: &Link, folder: &Path) -> Result<Box<dyn Device>, JobError> {
    Ok(upset_device(prepared, link, folder, None)?.0)
}

/// As [`device`], with what is to go wrong; and what the computer suffers of it.
pub(super) fn upset_device(
    prepared: &Prepared,
    link: &Link,
    folder: &Path,
    inject: Option<&inject::Plan>,
) -> Result<Upset, JobError> {
    let (device, ailing) = good_device(prepared, link, folder, inject)?;
    let lossy = inject
        .and_then(|plan| plan.host_link)
        .unwrap_or(prepared.config.host_link);
    if lossy.is_active() {
        return Ok((Box::new(LossyDevice::new(device, lossy)), ailing));
    }
    Ok((device, ailing))
}

fn good_device(
    prepared: &Prepared,
    link: &Link,
    folder: &Path,
    inject: Option<&inject::Plan>,
) -> Result<Upset, JobError> {
    if inject.is_some() {
        match link {
            Link::Tcp(address) => {
                let drive = TcpDrive::connect(address).map_err(LinkError::from)?;
                check_limits(&drive.hello().limits, &prepared.robot).map_err(LinkError::from)?;
                if drive.hello().lock_step {
                    let controller = controller_in_process(prepared.robot.dof())?;
                    return join(prepared, link, folder, inject, controller, Box::new(drive));
                }
                return Err(no_injection(link));
            }
            Link::Serial(_) | Link::Controller(_) | Link::Grpc(_) => return Err(no_injection(link)),
            Link::Sim | Link::Qemu => {}
        }
    }
    if let Some(device) = distant(prepared, link)? {
        return Ok((device, None));
    }
    let controller = controller(prepared, link, folder)?;
    let home = &prepared.plan.home.joints;
    let drive = simulated_arm(&prepared.robot, &prepared.tool, &prepared.plant, home)?;
    join(prepared, link, folder, inject, controller, drive)
}

/// Controller and drive in lock-step, upset where that is asked for.
fn join(
    prepared: &Prepared,
    link: &Link,
    folder: &Path,
    inject: Option<&inject::Plan>,
    first: Box<dyn Controller>,
    drive: Box<dyn Drive>,
) -> Result<Upset, JobError> {
    let joints = prepared.robot.dof();
    let Some(plan) = inject else {
        return Ok((Box::new(Cell::new(first, drive, joints)?), None));
    };
    let (link, folder) = (link.clone(), folder.to_owned());
    let restart = Box::new(move || match link {
        Link::Qemu => Ok(Box::new(Qemu::start(&QemuOptions::new(&folder))?) as Box<dyn Controller>),
        _ => controller_in_process(joints),
    });
    let device = Upsetting::new(first, drive, joints, plan, restart)?;
    let ailing = device.ailing();
    Ok((Box::new(device), Some(ailing)))
}

fn no_injection(link: &Link) -> JobError {
    JobError::NoInjection {
        link: link.to_string(),
        remedy: "faults are injected between a controller and a drive in lock-step: use sim, qemu or the tcp: of one"
            .to_owned(),
    }
}

/// What is reached over a link whose arm is not in this process; `None` where it is.
pub(super) fn distant(prepared: &Prepared, link: &Link) -> Result<Option<Box<dyn Device>>, JobError> {
    let joints = prepared.robot.dof();
    match link {
        Link::Sim | Link::Qemu => Ok(None),
        Link::Serial(device) => Ok(Some(Box::new(Serial::open(device)?))),
        Link::Tcp(address) => {
            let drive = TcpDrive::connect(address).map_err(LinkError::from)?;
            check_limits(&drive.hello().limits, &prepared.robot).map_err(LinkError::from)?;
            if !drive.hello().lock_step {
                return Ok(Some(Box::new(Threaded::start(drive, joints)?)));
            }
            let controller = controller_in_process(joints)?;
            Ok(Some(Box::new(Cell::new(controller, Box::new(drive), joints)?)))
        }
        Link::Controller(address) => {
            let remote = Remote::connect(address, joints)?;
            check_limits(&remote.hello().limits, &prepared.robot).map_err(LinkError::from)?;
            Ok(Some(Box::new(remote)))
        }
        Link::Grpc(peer) => Ok(Some(Box::new(RemoteRobot::attach(peer, &prepared.robot)?))),
    }
}

/// The controller of a link whose arm is in this process.
pub(super) fn controller(prepared: &Prepared, link: &Link, folder: &Path) -> Result<Box<dyn Controller>, JobError> {
    match link {
        Link::Qemu => Ok(Box::new(Qemu::start(&QemuOptions::new(folder))?)),
        Link::Sim | Link::Serial(_) | Link::Tcp(_) | Link::Controller(_) | Link::Grpc(_) => {
            Ok(controller_in_process(prepared.robot.dof())?)
        }
    }
}
