//! The links by name: how to reach controller and drive.

use std::net::{Ipv4Addr, SocketAddr};
use std::str::FromStr;

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
    "\"{text}\" is not a link: give sim, qemu, serial:DEVICE, tcp:HOST:PORT, franka:HOST, fri:PORT, \
     controller:HOST:PORT, grpc:HOST:PORT or grpcs:HOST:PORT"
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
            Some(("controller", address)) if has_port(address) => Ok(Self::Controller(address.to_owned())),
            Some(("franka", rest)) => franka(rest).ok_or_else(|| UnknownLink { text: text.to_owned() }),
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
fn franka(text: &str) -> Option<Link> {
    let (host, port) = match text.rsplit_once(':') {
        Some((host, port)) if !host.contains(':') || host.ends_with(']') => (host, port.parse().ok()?),
        _ => (text, spherecal_fci::TCP_PORT),
    };
    let host = host.strip_prefix('[').and_then(|h| h.strip_suffix(']')).unwrap_or(host);
    (!host.is_empty() && port > 0).then(|| Link::Franka {
        host: host.to_owned(),
        port,
    })
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
            Self::Controller(address) => write!(f, "controller:{address}"),
            Self::Franka { host, port } => {
                let host = if host.contains(':') {
                    format!("[{host}]")
                } else {
                    host.clone()
                };
                if *port == spherecal_fci::TCP_PORT {
                    write!(f, "franka:{host}")
                } else {
                    write!(f, "franka:{host}:{port}")
                }
            }
            Self::Fri(address) if address.ip() == Ipv4Addr::UNSPECIFIED => write!(f, "fri:{}", address.port()),
            Self::Fri(address) => write!(f, "fri:{address}"),
            Self::Grpc(peer) => peer.fmt(f),
        }
    }
}
