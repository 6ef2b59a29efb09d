//! What a process that listens says about its address.

use std::io::Write;
use std::net::SocketAddr;

use super::out::errln;

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
