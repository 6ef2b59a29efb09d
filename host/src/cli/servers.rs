//! `spherecal plant` and `spherecal controller`: the two halves of a cell as
//! processes of their own.
//!
//! Both print one line on stdout as soon as they listen, with the address, so
//! that a script can wait for it; everything else goes to stderr. Ctrl-C ends
//! them: the other side sees the connection close.

use std::io::Write;

use super::args::{ControllerArgs, PlantArgs};
use super::exit::{CliError, Exit};
use super::out::errln;
use crate::job;
use crate::link::tcp::{DriveServer, TcpDrive, listen, station};
use crate::link::{Cell, Drive, LinkError, controller_in_process};

/// Tells whoever started this process where it listens.
fn announce(line: &str) {
    let mut out = std::io::stdout().lock();
    // A reader that has gone does not matter to a server.
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
                "a controller has gone after {} commands ({} missing, {} late, {} damaged frames)",
                service.commands,
                service.missing,
                service.late,
                service.link.crc_errors
            ),
            // One bad controller does not end the service of a drive that works.
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
    let mut cell = Cell::new(controller_in_process(joints)?, Box::new(drive), joints)?;
    let (listener, address) = listen(&args.host_link).map_err(LinkError::from)?;
    announce(&format!(
        "controller, {joints} joints, {way}: host link on tcp:{address}"
    ));
    let result = station::serve_hosts(&mut cell, &listener, args.once);
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
