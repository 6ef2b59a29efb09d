//! `spherecal plant` and `spherecal controller`: the two halves of a cell as separate processes.
//!
//! As soon as either listens, it prints one line with the address on stdout, so that a script can
//! wait for it. Everything else goes to stderr. Ctrl-C ends it; the other side sees the connection
//! close.

use std::io::Write;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use super::args::{BadValue, base};
use super::exit::{CliError, Exit};
use super::out::errln;
use super::robot_sides;
use spherecal_job::{self as job, Config, JobError, Link};
use spherecal_link::native::enter_real_time;
use spherecal_link::tcp::{DriveServer, TcpDrive, controller_server, listen};
use spherecal_link::{Device, Drive, LinkError, LocalDevice, controller_in_process};

/// Interval at which a controller prints what its robot reported.
const EVENTS: Duration = Duration::from_millis(100);

/// Arguments of `plant`.
#[derive(Args, Clone, Debug)]
pub struct PlantArgs {
    /// Address for controllers. A port alone serves this machine only; port 0 takes any free port.
    /// Default: 7401; with --fci 1337, the only port that official clients know.
    #[arg(long, value_name = "[HOST:]PORT", conflicts_with = "fri")]
    pub listen: Option<String>,
    /// Be a Panda or an FR3 for clients of the Franka Control Interface, in real time.
    #[arg(long, conflicts_with_all = ["fri", "real_time", "once"])]
    pub fci: bool,
    /// Version of the Franka Control Interface: 5 is a Panda; 7, 8 and 10 are an FR3.
    #[arg(long, value_name = "5|7|8|10", requires = "fci")]
    pub version: Option<u16>,
    /// Be a KUKA cabinet with an LBR that sends to the client at this address, in real time.
    #[arg(long, value_name = "HOST:PORT", conflicts_with_all = ["real_time", "once"])]
    pub fri: Option<SocketAddr>,
    /// Stiffness of the cabinet's joint impedance under the overlay, in N m/rad. The application
    /// sets 0.
    #[arg(long, value_name = "NM_RAD", requires = "fri", default_value_t = 0.0)]
    pub stiffness: f64,
    /// Wait up to 100 ms for each answer of a motion, so that a computer without real time causes
    /// no reflex. A real robot does not wait.
    #[arg(long)]
    pub tolerant: bool,
    /// Seed of the arm's errors and noise. Use the run's seed for the same arm.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Configuration of the run, for the same arm and plate.
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Run in real time at 1 kHz, and do not wait for commands.
    #[arg(long)]
    pub real_time: bool,
    /// End when the first controller has disconnected.
    #[arg(long)]
    pub once: bool,
}

impl PlantArgs {
    /// The configuration from the arguments, checked.
    ///
    /// # Errors
    /// A file or a value that cannot be used.
    pub fn configuration(&self) -> Result<Config, JobError> {
        let config = base(self.config.as_deref(), self.seed)?;
        config.check()?;
        Ok(config)
    }
}

/// Arguments of `controller`.
#[derive(Args, Clone, Debug)]
pub struct ControllerArgs {
    /// Drive: tcp:HOST:PORT of a simulator, a gateway or `spherecal plant`; franka:HOST; fri:PORT.
    #[arg(long, value_name = "LINK", value_parser = drive_link)]
    pub drive: Link,
    /// Configuration of the run: robot, tool and thresholds for franka: and fri:. Set
    /// procedure.law.torque_rate_nm_s to 990 in the run's configuration for a Franka robot.
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Address for hosts (`spherecal run --link controller:HOST:PORT`).
    #[arg(long, value_name = "tcp:[HOST:]PORT", value_parser = tcp_address, default_value = "tcp:7402")]
    pub host_link: String,
    /// End when the first host has disconnected.
    #[arg(long)]
    pub once: bool,
}

/// A link to a drive.
fn drive_link(text: &str) -> Result<Link, BadValue> {
    match text.parse() {
        Ok(link @ (Link::Tcp(_) | Link::Franka { .. } | Link::Fri(_))) => Ok(link),
        _ => Err(BadValue("give tcp:HOST:PORT, franka:HOST or fri:PORT")),
    }
}

/// `tcp:ADDRESS`, without its `tcp:`.
fn tcp_address(text: &str) -> Result<String, BadValue> {
    match text.strip_prefix("tcp:") {
        Some(address) if !address.is_empty() => Ok(address.to_owned()),
        _ => Err(BadValue("give tcp:HOST:PORT")),
    }
}

/// Prints the address for the process that started this one.
pub(super) fn announce(line: &str) {
    let mut out = std::io::stdout().lock();
    // A reader that closed the pipe does not matter to a server.
    let _ = writeln!(out, "{line}").and_then(|()| out.flush());
}

/// Warns that other machines can reach a link that has neither a token nor encryption.
pub(super) fn warn_if_open(command: &str, address: SocketAddr) {
    if !address.ip().to_canonical().is_loopback() {
        errln!(
            "spherecal {command}: warning: {address} admits every machine that can reach it, without a token and \
             without encryption: use a network of the cell alone, or give a port without a host for this machine only"
        );
    }
}

/// `spherecal plant`
pub(super) fn plant(args: &PlantArgs) -> Result<Exit, CliError> {
    if args.fci {
        return robot_sides::franka(args);
    }
    if let Some(client) = args.fri {
        return robot_sides::kuka(args, client);
    }
    if args.tolerant {
        return Err(CliError::input("--tolerant: give --fci or --fri with it"));
    }
    let drive = job::simulated_drive(&args.configuration()?)?;
    let (listener, address) = listen(args.listen.as_deref().unwrap_or("7401")).map_err(LinkError::from)?;
    warn_if_open("plant", address);
    let way = if args.real_time { "in real time" } else { "in lock-step" };
    announce(&format!("drive link, {way}, on tcp:{address}"));
    let mut server = DriveServer::new(drive, args.real_time);
    loop {
        match server.serve(&listener) {
            Ok(service) => errln!(
                "a controller disconnected after {} commands ({} missing, {} late, {} damaged frames)",
                service.commands,
                service.missing,
                service.late,
                service.link.crc_errors
            ),
            // One faulty controller does not end the service of a working drive.
            Err(LinkError::Tcp(error)) if !args.once => errln!("spherecal plant: {error}"),
            Err(error) => return Err(error.into()),
        }
        if args.once {
            return Ok(Exit::Done);
        }
    }
}

fn open_drive(args: &ControllerArgs) -> Result<Box<dyn Drive>, CliError> {
    if let Link::Tcp(address) = &args.drive {
        return Ok(Box::new(TcpDrive::connect(address).map_err(LinkError::from)?));
    }
    let mut config = base(args.config.as_deref(), None)?;
    if args.config.is_none()
        && let Some(robot) = args.drive.robot()?
    {
        robot.clone_into(&mut config.robot);
    }
    let model = job::loaded_model(&config)?;
    Ok(job::native::drive(&model, &config.procedure, &args.drive)?)
}

/// `spherecal controller`
pub(super) fn controller(args: &ControllerArgs) -> Result<Exit, CliError> {
    let drive = open_drive(args)?;
    let joints = drive.hello().limits.len();
    let way = if drive.hello().lock_step {
        "lock-step"
    } else {
        "real time"
    };
    let mut cell = LocalDevice::new(controller_in_process(joints)?, drive, joints)?;
    let (listener, address) = listen(&args.host_link).map_err(LinkError::from)?;
    warn_if_open("controller", address);
    announce(&format!(
        "controller, {joints} joints, {way}: host link on tcp:{address}"
    ));
    if let Some(monitor) = Device::monitor(&cell) {
        // The words are written by another thread: this one keeps the period.
        let reader = monitor.clone();
        std::thread::spawn(move || {
            loop {
                while let Some(event) = reader.next_event() {
                    errln!("{event}");
                }
                std::thread::sleep(EVENTS);
            }
        });
        enter_real_time(&monitor);
    }
    let result = controller_server::serve_hosts(&mut cell, &listener, args.once);
    let link = cell.drive_counters();
    errln!(
        "drive link: {} states, {} damaged, {} lost, {} repeated",
        link.frames,
        link.crc_errors,
        link.lost,
        link.duplicates
    );
    result?;
    Ok(Exit::Done)
}
