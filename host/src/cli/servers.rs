//! `spherecal plant` and `spherecal controller`: the two halves of a cell as separate processes.
//!
//! As soon as either listens, it prints one line with the address on stdout, so that a script can
//! wait for it. Everything else goes to stderr. Ctrl-C ends it; the other side sees the connection
//! close.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;

use super::args::{BadValue, base};
use super::exit::{CliError, Exit};
use super::out::errln;
use spherecal_job::{self as job, Config, JobError};
use spherecal_link::tcp::{DriveServer, TcpDrive, controller_server, listen};
use spherecal_link::{Drive, LinkError, LocalDevice, controller_in_process};

/// Arguments of `plant`.
#[derive(Args, Clone, Debug)]
pub struct PlantArgs {
    /// Address for controllers. A port alone serves this machine only; port 0 takes any free port.
    #[arg(long, value_name = "[HOST:]PORT", default_value = "7401")]
    pub listen: String,
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
    /// Drive: tcp:HOST:PORT of a simulator, a gateway or `spherecal plant`.
    #[arg(long, value_name = "tcp:HOST:PORT", value_parser = tcp_address)]
    pub drive: String,
    /// Address for hosts (`spherecal run --link controller:HOST:PORT`).
    #[arg(long, value_name = "tcp:[HOST:]PORT", value_parser = tcp_address, default_value = "tcp:7402")]
    pub host_link: String,
    /// End when the first host has disconnected.
    #[arg(long)]
    pub once: bool,
}

/// `tcp:ADDRESS`, without its `tcp:`.
fn tcp_address(text: &str) -> Result<String, BadValue> {
    match text.strip_prefix("tcp:") {
        Some(address) if !address.is_empty() => Ok(address.to_owned()),
        _ => Err(BadValue("give tcp:HOST:PORT")),
    }
}

/// Prints the address for the process that started this one.
fn announce(line: &str) {
    let mut out = std::io::stdout().lock();
    // A reader that closed the pipe does not matter to a server.
    let _ = writeln!(out, "{line}").and_then(|()| out.flush());
}

/// `spherecal plant`
pub(super) fn plant(args: &PlantArgs) -> Result<Exit, CliError> {
    let drive = job::simulated_drive(&args.configuration()?)?;
    let (listener, address) = listen(&args.listen).map_err(LinkError::from)?;
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

/// `spherecal controller`
pub(super) fn controller(args: &ControllerArgs) -> Result<Exit, CliError> {
    let drive = TcpDrive::connect(&args.drive).map_err(LinkError::from)?;
    let joints = drive.hello().limits.len();
    let way = if drive.hello().lock_step {
        "lock-step"
    } else {
        "real time"
    };
    let mut cell = LocalDevice::new(controller_in_process(joints)?, Box::new(drive), joints)?;
    let (listener, address) = listen(&args.host_link).map_err(LinkError::from)?;
    announce(&format!(
        "controller, {joints} joints, {way}: host link on tcp:{address}"
    ));
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
