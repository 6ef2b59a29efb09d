//! Text on stdout and stderr, and what a server says first.
//!
//! A reader that has read enough (`spherecal run --json | head -1`) closes the pipe. The remaining
//! text is then dropped silently, and the command finishes with its own exit code. Any other
//! failure of stdout (a full disk) makes the command fail at its end.
//!
//! Names and messages from files, databases and other machines may contain escape sequences. They
//! are always shown as text ([`printable_lines`]).

use std::fmt::Arguments;
use std::io::{Error, ErrorKind, Write as _};
use std::net::SocketAddr;
use std::sync::OnceLock;

use spherecal_model::printable_lines;

/// Why stdout takes nothing more.
static CLOSED: OnceLock<Error> = OnceLock::new();

/// Writes to stdout, until it takes nothing more.
pub fn write(words: Arguments<'_>) {
    if CLOSED.get().is_some() {
        return;
    }
    let text = words.to_string();
    let mut out = std::io::stdout().lock();
    let written = out.write_all(printable_lines(&text).as_bytes());
    if let Err(error) = written.and_then(|()| out.flush()) {
        // The first reason counts.
        let _ = CLOSED.set(error);
    }
}

/// Writes to stderr, if anybody listens.
pub fn write_error(words: Arguments<'_>) {
    let text = words.to_string();
    let _ = std::io::stderr().lock().write_all(printable_lines(&text).as_bytes());
}

/// Why the output is incomplete. A reader that closed the pipe does not count.
pub(super) fn failure() -> Option<&'static Error> {
    CLOSED.get().filter(|error| error.kind() != ErrorKind::BrokenPipe)
}

/// `println!` that a reader may leave.
#[macro_export]
macro_rules! outln {
    () => { $crate::cli::out::write(format_args!("\n")) };
    ($($words:tt)*) => { $crate::cli::out::write(format_args!("{}\n", format_args!($($words)*))) };
}

/// `print!` that a reader may leave.
#[macro_export]
macro_rules! out {
    ($($words:tt)*) => { $crate::cli::out::write(format_args!($($words)*)) };
}

/// `eprintln!` that a reader may leave.
#[macro_export]
macro_rules! errln {
    ($($words:tt)*) => { $crate::cli::out::write_error(format_args!("{}\n", format_args!($($words)*))) };
}

/// `eprint!` that a reader may leave.
macro_rules! err {
    ($($words:tt)*) => { $crate::cli::out::write_error(format_args!($($words)*)) };
}

pub(super) use {err, errln, out, outln};

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
