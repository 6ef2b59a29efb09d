//! `spherecal plant` and `spherecal controller`: the two halves of a cell as separate processes.
//!
//! As soon as either listens, it prints one line with the address on stdout, so that a script can
//! wait for it. Everything else goes to stderr. Ctrl-C ends it; the other side sees the connection
//! close.

use std::net::{TcpListener, UdpSocket};
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use spherecal_job::{self as job, Link};
use spherecal_link::native::enter_real_time;
use spherecal_link::tcp::conform::{Finding, of_controller, of_drive};
use spherecal_link::tcp::{DriveServer, RemoteDrive, TcpError, controller_server, listen, listen_udp};
use spherecal_link::{Device, Drive, LinkError, LocalDevice, Serial, controller_in_process};

use super::args::{BadValue, base};
use super::exit::{CliError, Exit};
use super::out::{announce, errln, outln, warn_if_open};
use super::robot_sides::{self, PlantArgs};
use super::ur_side;
use crate::simulated;

/// Interval at which a controller prints what its robot reported.
const EVENTS: Duration = Duration::from_millis(100);

/// Arguments of `controller`.
#[derive(Args, Clone, Debug)]
pub struct ControllerArgs {
    /// Drive: tcp:HOST:PORT, udp:HOST:PORT or serial:DEVICE[@BAUD] of a simulator, a gateway or `spherecal plant`; franka:HOST; fri:PORT; ur:HOST.
    #[arg(long, value_name = "LINK", value_parser = drive_link)]
    pub drive: Link,
    /// Configuration of the run: robot, tool and thresholds for franka:, fri: and ur:. Set
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

fn drive_link(text: &str) -> Result<Link, BadValue> {
    match text.parse() {
        Err(_) | Ok(Link::Sim | Link::Qemu | Link::Controller(_) | Link::Grpc(_)) => Err(BadValue(
            "give tcp:HOST:PORT, udp:HOST:PORT, serial:DEVICE[@BAUD], franka:HOST, fri:PORT or ur:HOST",
        )),
        Ok(link) => Ok(link),
    }
}

fn tcp_address(text: &str) -> Result<String, BadValue> {
    match text.strip_prefix("tcp:") {
        Some(address) if !address.is_empty() => Ok(address.to_owned()),
        _ => Err(BadValue("give tcp:HOST:PORT")),
    }
}

/// Where the controllers of a plant come from.
enum Door<'a> {
    Tcp(TcpListener),
    Serial(&'a str),
    Udp(UdpSocket),
}

pub(super) fn plant(args: &PlantArgs) -> Result<Exit, CliError> {
    if args.fci {
        return robot_sides::franka(args);
    }
    if let Some(client) = args.fri {
        return robot_sides::kuka(args, client);
    }
    if let Some(address) = &args.ur {
        return ur_side::universal_robots(args, address);
    }
    if args.guide.is_some() {
        return Err(CliError::input("--guide: give --fci, --fri or --ur with it"));
    }
    if args.tolerant {
        return Err(CliError::input("--tolerant: give --fci or --fri with it"));
    }
    let drive = simulated::drive(&args.configuration()?)?;
    let mut server = DriveServer::new(drive, args.real_time || args.serial.is_some() || args.udp.is_some());
    let door = if let Some(device) = &args.serial {
        Serial::check(device)?;
        announce(&format!("drive link, in real time, on serial:{device}"));
        Door::Serial(device)
    } else if let Some(address) = &args.udp {
        let (socket, address) = listen_udp(address).map_err(LinkError::from)?;
        warn_if_open("plant", address);
        announce(&format!("drive link, in real time, on udp:{address}"));
        Door::Udp(socket)
    } else {
        let (listener, address) = listen(args.listen.as_deref().unwrap_or("7401")).map_err(LinkError::from)?;
        warn_if_open("plant", address);
        let way = if args.real_time { "in real time" } else { "in lock-step" };
        announce(&format!("drive link, {way}, on tcp:{address}"));
        Door::Tcp(listener)
    };
    loop {
        let served = match &door {
            Door::Tcp(listener) => server.serve(listener),
            Door::Serial(device) => server.serve_serial(device),
            Door::Udp(socket) => server.serve_udp(socket),
        };
        match served {
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
        return Ok(Box::new(RemoteDrive::connect(address).map_err(LinkError::from)?));
    }
    if let Link::Udp(address) = &args.drive {
        return Ok(Box::new(RemoteDrive::at_socket(address).map_err(LinkError::from)?));
    }
    if let Link::Serial(device) = &args.drive {
        return Ok(Box::new(RemoteDrive::open(device)?));
    }
    let mut config = base(args.config.as_deref(), None)?;
    if args.config.is_none()
        && let Some(robot) = args.drive.robot()?
    {
        robot.clone_into(&mut config.robot);
    }
    let model = job::loaded_model(&config)?;
    Ok(job::native::drive(&model, &config, &args.drive)?)
}

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
    let told = &mut |reason: &TcpError| errln!("spherecal controller: {reason}");
    let result = controller_server::serve_hosts(&mut cell, &listener, args.once, told);
    if let Some(monitor) = Device::monitor(&cell) {
        errln!("{}", monitor.record().words());
    }
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

/// Arguments of `conform`.
#[derive(Args, Clone, Debug)]
pub struct ConformArgs {
    /// A drive of the drive link: a simulator or a gateway. It is never enabled.
    #[arg(
        long,
        value_name = "HOST:PORT",
        required_unless_present = "controller",
        conflicts_with = "controller"
    )]
    pub drive: Option<String>,
    /// A controller process, by its host link. It is told to stop, and nothing else.
    #[arg(long, value_name = "HOST:PORT")]
    pub controller: Option<String>,
    /// Print one JSON document on stdout and nothing else.
    #[arg(long)]
    pub json: bool,
}

pub(super) fn run(args: &ConformArgs) -> Exit {
    let findings = match (&args.drive, &args.controller) {
        (Some(address), _) => of_drive(address),
        (None, Some(address)) => of_controller(address),
        // The parser demands one of them.
        (None, None) => Vec::new(),
    };
    let failed = findings.iter().filter(|finding| !finding.holds()).count();
    if args.json {
        let sentences: Vec<_> = findings.iter().map(document).collect();
        outln!(
            "{:#}",
            serde_json::json!({ "conforms": failed == 0, "sentences": sentences })
        );
    } else {
        for finding in &findings {
            let word = if finding.holds() { "holds" } else { "FAILS" };
            outln!("{word}  {}: {}", finding.document, finding.sentence);
            if let Some(seen) = &finding.seen {
                outln!("       seen: {seen}");
            }
        }
        outln!("{} of {} sentences hold", findings.len() - failed, findings.len());
    }
    if failed == 0 { Exit::Done } else { Exit::Failed }
}

fn document(finding: &Finding) -> serde_json::Value {
    serde_json::json!({
        "document": finding.document,
        "sentence": finding.sentence,
        "holds": finding.holds(),
        "seen": finding.seen,
    })
}
