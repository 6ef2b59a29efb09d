//! The clients of the program that meet peers that mean harm, and how long each may wait.

use std::io::Read as _;
use std::net::TcpStream;
use std::time::Duration;

use spherecal_shared::protocol::drive::DriveCommand;

use super::framed;
use crate::support::Server;

/// How a client reaches its peer.
#[derive(Clone, Copy)]
pub(super) enum Wire {
    /// It connects to a port this far above the one at which the peer listens.
    Tcp(u16),
    Udp,
    Serial,
}

/// A client of the program.
pub(super) struct Client {
    pub(super) name: &'static str,
    pub(super) wire: Wire,
    /// `{}` stands for the peer's address.
    pub(super) arguments: &'static [&'static str],
    /// What an honest peer says first.
    pub(super) greeting: Vec<u8>,
    /// Valid on this wire, but not what this client waits for.
    pub(super) senseless: Vec<u8>,
    /// The head of the largest message that a peer can promise, and what follows without end. Both may be empty.
    pub(super) bomb: [Vec<u8>; 2],
    /// The longest time that it may wait before and after a greeting: its budget.
    pub(super) longest: [Duration; 2],
}

/// What an honest server says first.
fn greeting(server: &Server) -> Vec<u8> {
    let mut stream = TcpStream::connect(&server.address).expect("connects");
    let (mut bytes, mut byte) = (Vec::new(), [1]);
    while byte != [0] {
        stream.read_exact(&mut byte).expect("a hello");
        bytes.extend(byte);
    }
    bytes
}

/// A client of a service, which begins with the settings of HTTP/2.
#[cfg(feature = "services")]
fn of_service(name: &'static str, arguments: &'static [&'static str], longest: u64) -> Client {
    use super::grpc::SETTINGS;
    // An answer of status 200 whose message has 64 MiB less one byte, and 16,000 zeros of it in each further frame.
    let mut head = vec![0, 0, 20, 1, 4, 0, 0, 0, 1, 0x88, 0x0f, 0x10, 16];
    head.extend(b"application/grpc");
    head.extend([0, 0, 5, 0, 0, 0, 0, 0, 1, 0, 3, 0xff, 0xff, 0xff]);
    let mut more = vec![0, 0x3e, 0x80, 0, 0, 0, 0, 0, 1];
    more.resize(9 + 16_000, 0);
    Client {
        name,
        wire: Wire::Tcp(0),
        arguments,
        greeting: SETTINGS.to_vec(),
        // Pings.
        senseless: vec![0, 0, 8, 6, 0, 0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8],
        bomb: [head, more],
        longest: [Duration::from_secs(longest); 2],
    }
}

/// The clients, and their budgets.
pub(super) fn clients() -> Vec<Client> {
    let hello = greeting(&Server::start(&["plant", "--listen", "0"]));
    let client = |name, wire, arguments, senseless: &[u8], bomb: &[u8], longest: [u64; 2]| Client {
        name,
        wire,
        arguments,
        greeting: Vec::new(),
        senseless: senseless.to_vec(),
        bomb: [bomb.to_vec(), vec![0; 1 << 14]],
        longest: longest.map(Duration::from_secs),
    };
    let command = framed(&DriveCommand::default());
    let drive = ["run", "--config", "cell.toml", "--link", "tcp:{}"].as_slice();
    let controller = ["run", "--config", "cell.toml", "--link", "controller:{}"].as_slice();
    let apart = ["controller", "--host-link", "tcp:0", "--drive", "tcp:{}"].as_slice();
    let greeted = |client: Client| Client {
        greeting: hello.clone(),
        ..client
    };
    // A state of a cabinet, as KUKA's program sends it.
    let hex = include_str!("../../../crates/fri/tests/monitoring.hex");
    let digits: Vec<u8> = hex.bytes().filter(u8::is_ascii_hexdigit).collect();
    let state: Vec<u8> = digits
        .chunks(2)
        .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).expect("digits"), 16).expect("a number"))
        .collect();
    // RTDE: a text without words; FCI: an answer to a question that nobody has asked.
    let (text, answer) = ([0, 6, b'M', 0, 0, 3], [0, 0, 0, 0, 99, 0, 0, 0, 12, 0, 0, 0]);
    let huge = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1];
    let ur = ["run", "--config", "cell.toml", "--robot", "ur5e", "--link", "ur:{}"].as_slice();
    let franka = ["run", "--config", "cell.toml", "--robot", "fr3", "--link", "franka:{}"].as_slice();
    let fri = ["run", "--config", "cell.toml", "--link", "fri:{}"].as_slice();
    let serial = ["run", "--config", "cell.toml", "--link", "serial:{}"].as_slice();
    let mut clients = vec![
        greeted(client("drive link", Wire::Tcp(0), drive, &command, &[], [5, 60])),
        // While it has no host, it does not ask a drive in lock-step that has greeted it.
        client("drive link of a controller", Wire::Tcp(0), apart, &command, &[], [5; 2]),
        greeted(client("host link", Wire::Tcp(0), controller, &command, &[], [15, 60])),
        client("RTDE", Wire::Tcp(0), ur, &text, &[0xff, 0xff, b'V'], [6; 2]),
        client("FCI", Wire::Tcp(0), franka, &answer, &huge, [8; 2]),
        client("FRI", Wire::Udp, fri, &state, &[], [120; 2]),
        client("serial", Wire::Serial, serial, &command, &[], [35; 2]),
    ];
    #[cfg(feature = "services")]
    clients.extend([
        of_service("store", &["history", "--store", "grpc:{}"], 5),
        of_service("tracker", &["run", "--config", "cell.toml", "--tracker", "grpc:{}"], 5),
        of_service("robot", &["run", "--config", "cell.toml", "--link", "grpc:{}"], 5),
    ]);
    clients
}
