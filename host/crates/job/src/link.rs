//! The links by name: how to reach controller and drive; and what is recorded of them.

use std::net::{Ipv4Addr, SocketAddr};
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use spherecal_link::Injected;
use spherecal_link::native::DriveRecord;
use spherecal_shared::protocol::frame::LinkCounters;
use spherecal_store::Peer;

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
    /// The controller in this process; an external simulator or a robot's gateway behind the drive
    /// link.
    Tcp(String),
    /// The same behind UDP, in real time.
    Udp(String),
    /// A controller process (`spherecal controller`) with any drive.
    Controller(String),
    /// The controller in this process; a Panda or FR3 behind the Franka Control Interface.
    Franka {
        /// Address or name of the control unit.
        host: String,
        /// TCP port; a real robot has 1337.
        port: u16,
    },
    /// The controller in this process; an LBR behind KUKA's Fast Robot Interface. Where this
    /// computer listens for the cabinet.
    Fri(SocketAddr),
    /// The controller in this process; a robot of Universal Robots behind RTDE and a program of ours.
    Ur {
        /// Address or name of the robot.
        host: String,
        /// TCP port of RTDE; a real robot has 30004.
        port: u16,
    },
    /// A robot behind the service `RobotController` (`spherecal serve`).
    Grpc(Peer),
}

impl Link {
    /// Whether the arm and its tracker are in this process. They end with the process. A run over
    /// such a link is continued by repeating it, because the same commands give the same result.
    pub fn simulated(&self) -> bool {
        matches!(self, Self::Sim | Self::Qemu)
    }
}

/// A text that is no link.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "\"{text}\" is not a link: give sim, qemu, serial:DEVICE, tcp:HOST:PORT, udp:HOST:PORT, franka:HOST, fri:PORT, \
     ur:HOST, controller:HOST:PORT, grpc:HOST:PORT or grpcs:HOST:PORT"
)]
pub struct UnknownLink {
    /// As given.
    pub text: String,
}

impl FromStr for Link {
    type Err = UnknownLink;

    fn from_str(text: &str) -> Result<Self, UnknownLink> {
        if let Some(peer) = Peer::parse(text) {
            return Ok(Self::Grpc(peer));
        }
        match text.split_once(':') {
            None if text == "sim" => Ok(Self::Sim),
            None if text == "qemu" => Ok(Self::Qemu),
            Some(("serial", device)) if !device.is_empty() => Ok(Self::Serial(device.to_owned())),
            Some(("tcp", address)) if has_port(address) => Ok(Self::Tcp(address.to_owned())),
            Some(("udp", address)) if has_port(address) => Ok(Self::Udp(address.to_owned())),
            Some(("controller", address)) if has_port(address) => Ok(Self::Controller(address.to_owned())),
            Some(("franka", rest)) => {
                let found = host_and_port(rest, spherecal_fci::TCP_PORT);
                let (host, port) = found.ok_or_else(|| UnknownLink { text: text.to_owned() })?;
                Ok(Self::Franka { host, port })
            }
            Some(("ur", rest)) => {
                let found = host_and_port(rest, spherecal_ur::RTDE_PORT);
                let (host, port) = found.ok_or_else(|| UnknownLink { text: text.to_owned() })?;
                Ok(Self::Ur { host, port })
            }
            Some(("fri", rest)) => fri(rest).ok_or_else(|| UnknownLink { text: text.to_owned() }),
            _ => Err(UnknownLink { text: text.to_owned() }),
        }
    }
}

/// Whether a text is `HOST:PORT`, with a port that there can be.
fn has_port(text: &str) -> bool {
    let port = text.rsplit_once(':').and_then(|(_, port)| port.parse::<u16>().ok());
    port.is_some_and(|port| port > 0)
}

/// `HOST`, `HOST:PORT` or `[HOST]:PORT`, with brackets about an IPv6 address.
fn host_and_port(text: &str, usual: u16) -> Option<(String, u16)> {
    let (host, port) = match text.rsplit_once(':') {
        Some((host, port)) if !host.contains(':') || host.ends_with(']') => (host, port.parse().ok()?),
        _ => (text, usual),
    };
    let host = host.strip_prefix('[').and_then(|h| h.strip_suffix(']')).unwrap_or(host);
    (!host.is_empty() && port > 0).then(|| (host.to_owned(), port))
}

/// The reverse of [`host_and_port`]: the usual port is left out.
fn write_host(f: &mut std::fmt::Formatter<'_>, scheme: &str, host: &str, port: u16, usual: u16) -> std::fmt::Result {
    let (open, close) = if host.contains(':') { ("[", "]") } else { ("", "") };
    write!(f, "{scheme}:{open}{host}{close}")?;
    if port == usual { Ok(()) } else { write!(f, ":{port}") }
}

/// `PORT` on every network card, or `ADDRESS:PORT`.
fn fri(text: &str) -> Option<Link> {
    let any = |port| SocketAddr::from((Ipv4Addr::UNSPECIFIED, port));
    let address = text.parse().map(any).or_else(|_| text.parse()).ok()?;
    (address.port() > 0).then_some(Link::Fri(address))
}

impl std::fmt::Display for Link {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Sim => f.write_str("sim"),
            Self::Qemu => f.write_str("qemu"),
            Self::Serial(device) => write!(f, "serial:{device}"),
            Self::Tcp(address) => write!(f, "tcp:{address}"),
            Self::Udp(address) => write!(f, "udp:{address}"),
            Self::Controller(address) => write!(f, "controller:{address}"),
            Self::Franka { host, port } => write_host(f, "franka", host, *port, spherecal_fci::TCP_PORT),
            Self::Ur { host, port } => write_host(f, "ur", host, *port, spherecal_ur::RTDE_PORT),
            Self::Fri(address) if address.ip() == Ipv4Addr::UNSPECIFIED => write!(f, "fri:{}", address.port()),
            Self::Fri(address) => write!(f, "fri:{address}"),
            Self::Grpc(peer) => peer.fmt(f),
        }
    }
}

/// Counters of the two ends of the host link in a session.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkRecord {
    /// What the host received, and what the controller received.
    pub ends: [LinkCounters; 2],
    /// What was done to frames on purpose.
    #[serde(default)]
    pub injected: Injected,
    /// Commands that came after their start.
    #[serde(default)]
    pub late: u32,
    /// What the drive measured, if it is a robot's own interface.
    #[serde(default)]
    pub drive: Option<DriveRecord>,
    /// Whether the drive said that its arm is simulated.
    #[serde(default)]
    pub simulated: bool,
}

impl LinkRecord {
    /// Reads the stored text. A session that was killed has none.
    pub(super) fn stored(text: &str) -> Self {
        serde_json::from_str(text).unwrap_or_default()
    }

    pub(super) fn add(&mut self, other: &Self) {
        for (sum, part) in self.ends.iter_mut().zip(&other.ends) {
            add(sum, part);
        }
        self.injected = self.injected.plus(other.injected);
        self.late = self.late.saturating_add(other.late);
        self.simulated |= other.simulated;
        if let Some(drive) = &other.drive {
            self.drive.get_or_insert_default().add(drive);
        }
    }
}

fn add(sum: &mut LinkCounters, part: &LinkCounters) {
    sum.frames = sum.frames.saturating_add(part.frames);
    sum.crc_errors = sum.crc_errors.saturating_add(part.crc_errors);
    sum.lost = sum.lost.saturating_add(part.lost);
    sum.duplicates = sum.duplicates.saturating_add(part.duplicates);
    sum.resent = sum.resent.saturating_add(part.resent);
    sum.overflow = sum.overflow.saturating_add(part.overflow);
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a link is not read back as it is written, the usual port is not left out, or a link that cannot be is taken.
    #[test]
    fn links_to_hosts_go_round() {
        for (text, again, host, port) in [
            ("ur:192.0.2.1", "ur:192.0.2.1", "192.0.2.1", 30004),
            ("ur:arm.local:30004", "ur:arm.local", "arm.local", 30004),
            ("ur:[::1]:5", "ur:[::1]:5", "::1", 5),
            ("ur:::1", "ur:[::1]", "::1", 30004),
        ] {
            let link: Link = text.parse().expect("a link");
            let host = host.to_owned();
            assert_eq!(link, Link::Ur { host, port }, "{text}");
            assert_eq!(link.to_string(), again);
            assert_eq!(again.parse(), Ok(link));
        }
        assert_eq!("franka:a:1337".parse::<Link>().expect("a link").to_string(), "franka:a");
        for text in ["ur:", "ur:host:0", "ur:host:port", "ur::30004", "UR:host"] {
            assert!(text.parse::<Link>().is_err(), "{text}");
        }
    }
}
