//! The peers of [`hostile`](super) as servers: every client of the program meets each of them, and leaves it.
//!
//! `SPHERECAL_HOSTILE_S=3600 cargo test -p spherecal --test cli hostile::clients -- --ignored --nocapture` goes on for an
//! hour and prints a table: memory, times and causes.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::os::fd::AsRawFd as _;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use rustix::fs::OFlags;
use spherecal_ur::client::{
    ClientConfig, ClientError, DashboardCommand, ask_dashboard, ask_robot_api, read_kinematics,
};
use spherecal_ur::wire::ControllerVersion;

use super::table::{Client, Wire, clients};
use super::{End, HARMS, Harm, causes, pause, waits};
use crate::support::{PROGRAM, terminal};

/// Most memory of a client, MiB.
const MEMORY_MIB: f64 = 100.0;
/// What a busy machine may add to the longest time that a client waits, a plan of some poses included.
const BUSY: Duration = Duration::from_secs(20);
/// Clients at one time.
const WORKERS: usize = 16;

/// A plan that takes no time.
const CELL: &str = "[plan]\nchoice = \"grid\"\nposes = 4\n";

/// Datagrams to a port of this machine.
struct Datagrams(UdpSocket);

/// Nobody listens yet, or any more.
fn nobody(error: std::io::Error) -> std::io::Error {
    match error.kind() {
        ErrorKind::ConnectionRefused => ErrorKind::WouldBlock.into(),
        _ => error,
    }
}

impl Read for Datagrams {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        self.0.recv(bytes).map_err(nobody)
    }
}

impl Write for Datagrams {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.send(&bytes[..bytes.len().min(1400)]).map_err(nobody)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl End for Datagrams {}
// A pseudo-terminal: the device at the end of a serial line.
impl End for File {}

const BOMB: &str = "bomb";

/// A peer that means harm: what is said of it, whether it greets, and what it does.
type Peer = (&'static str, bool, Harm);

/// The peers that a client meets.
fn peers(client: &Client) -> Vec<Peer> {
    let mut peers: Vec<Peer> = HARMS.iter().map(|(name, harm)| (*name, false, *harm)).collect();
    if !client.greeting.is_empty() {
        peers.extend(HARMS.iter().map(|(name, harm)| (*name, true, *harm)));
    }
    if !client.bomb[0].is_empty() {
        peers.push((BOMB, true, |wire, more| wire.write_all(more)));
    }
    peers
}

/// Does harm until the connection ends, or all do.
fn harmful(wire: &mut dyn End, first: &[u8], harm: Harm, senseless: &[u8], stop: &AtomicBool) {
    let _ = wire.write_all(first);
    while !stop.load(Ordering::Relaxed) {
        match harm(wire, senseless) {
            Err(error) if waits(&error) => pause(1),
            Err(_) => break,
            Ok(()) => {}
        }
    }
}

/// Begins to wait for a client, or to send to it. Returns what the client is to be given as the peer's address.
fn lies_in_wait(client: &Client, (name, greets, harm): Peer, stop: &Arc<AtomicBool>) -> String {
    let (first, bytes) = match (name, greets) {
        (BOMB, _) => ([&client.greeting[..], &client.bomb[0]].concat(), client.bomb[1].clone()),
        (_, true) => (client.greeting.clone(), client.senseless.clone()),
        _ => (Vec::new(), client.senseless.clone()),
    };
    let stop = Arc::clone(stop);
    let soon = Some(Duration::from_millis(100));
    match client.wire {
        Wire::Tcp(above) => {
            let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
            listener.set_nonblocking(true).expect("set");
            let port = listener.local_addr().expect("an address").port() + above;
            thread::spawn(move || {
                let mut threads = Vec::new();
                while !stop.load(Ordering::Relaxed) {
                    let Ok((mut stream, _)) = listener.accept() else {
                        pause(5);
                        continue;
                    };
                    let (first, bytes, stop) = (first.clone(), bytes.clone(), Arc::clone(&stop));
                    threads.push(thread::spawn(move || {
                        let set = TcpStream::set_nonblocking(&stream, false)
                            .and_then(|()| stream.set_read_timeout(soon))
                            .and_then(|()| stream.set_write_timeout(soon));
                        if set.is_ok() {
                            harmful(&mut stream, &first, harm, &bytes, &stop);
                        }
                    }));
                }
                for thread in threads {
                    thread.join().expect("no panic");
                }
            });
            format!("127.0.0.1:{port}")
        }
        Wire::Udp => {
            let free = UdpSocket::bind("127.0.0.1:0").expect("a free port");
            let address = free.local_addr().expect("an address").to_string();
            drop(free);
            let socket = UdpSocket::bind("127.0.0.1:0").expect("a free port");
            socket.connect(&address).expect("set");
            socket.set_read_timeout(soon).expect("set");
            thread::spawn(move || harmful(&mut Datagrams(socket), &first, harm, &bytes, &stop));
            address
        }
        Wire::Serial => {
            let (mut master, slave) = terminal();
            let device = std::fs::read_link(format!("/proc/self/fd/{}", slave.as_raw_fd())).expect("it has a name");
            let flags = rustix::fs::fcntl_getfl(&master).expect("read");
            rustix::fs::fcntl_setfl(&master, flags | OFlags::NONBLOCK).expect("set");
            thread::spawn(move || {
                harmful(&mut master, &first, harm, &bytes, &stop);
                while !stop.load(Ordering::Relaxed) {
                    pause(20);
                }
                drop(slave);
            });
            device.display().to_string()
        }
    }
}

/// How a client ended.
struct Ended {
    took: Duration,
    mib: f64,
    said: String,
    /// `None`: it was ended, because it went on for too long.
    code: Option<i32>,
}

/// The largest memory that a process has had, MiB; 0 if it is gone.
fn most_mib(process: u32) -> f64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM"));
    let kib = line.and_then(|line| line.split_whitespace().nth(1)?.parse::<f64>().ok());
    kib.unwrap_or_default() / 1024.0
}

/// Runs a client to its end, or until it has had so long.
fn led(folder: &Path, arguments: &[String], most: Duration) -> Ended {
    let log = folder.join("said");
    let mut child = Command::new(PROGRAM)
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(File::create(&log).expect("made"))
        .spawn()
        .expect("the program starts");
    let (begun, mut mib) = (Instant::now(), 0f64);
    let code = loop {
        if let Some(status) = child.try_wait().expect("known") {
            break status.code();
        }
        // The newest: the first may still be that of this process, of which the child was made.
        mib = Some(most_mib(child.id())).filter(|now| *now > 0.0).unwrap_or(mib);
        if begun.elapsed() > most {
            child.kill().expect("ended");
            child.wait().expect("ended");
            break None;
        }
        pause(10);
    };
    Ended {
        took: begun.elapsed(),
        mib,
        said: std::fs::read_to_string(log).expect("told"),
        code,
    }
}

/// What was seen of one client.
#[derive(Default)]
struct Seen {
    runs: usize,
    longest: [Duration; 2],
    mib: f64,
    causes: BTreeMap<String, usize>,
    wrong: Vec<String>,
}

/// One client meets one peer. Returns how it ended, and what is wrong with that.
fn meets(client: &Client, peer: Peer) -> (Ended, Option<String>) {
    let stop = Arc::new(AtomicBool::new(false));
    let address = lies_in_wait(client, peer, &stop);
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("cell.toml"), CELL).expect("written");
    let arguments: Vec<String> = client.arguments.iter().map(|a| a.replace("{}", &address)).collect();
    let longest = client.longest[usize::from(peer.1)];
    let ended = led(folder.path(), &arguments, longest + BUSY);
    stop.store(true, Ordering::Relaxed);
    let said = &ended.said;
    // There is one robot, and one controller.
    let named = [&*address, "the robot", "the cabinet", "the controller"]
        .iter()
        .any(|name| said.contains(name));
    let wrong = match ended.code {
        None => "it still runs".to_owned(),
        Some(1 | 2) if ended.mib >= MEMORY_MIB => "too much memory".to_owned(),
        Some(1 | 2) if named && !said.contains("panicked") => return (ended, None),
        code => format!("{code:?}"),
    };
    let wrong = format!(
        "{}, {}, greeted: {}: {wrong} after {:.1?} with {:.1} MiB: {said}",
        client.name, peer.0, peer.1, ended.took, ended.mib
    );
    (ended, Some(wrong))
}

/// A question to an interface of a robot, asked in this process: how far the interface is below RTDE, what is valid there,
/// and the question.
type Question = (
    &'static str,
    u16,
    &'static [u8],
    fn(&ClientConfig) -> Result<String, ClientError>,
);

const QUESTIONS: [Question; 3] = [
    ("dashboard", 5, b"Safetystatus: NORMAL\n", |config| {
        ask_dashboard(config, &[DashboardCommand::UnlockProtectiveStop])
    }),
    (
        "Robot API",
        5,
        b"HTTP/1.1 200 \r\nContent-Length: 0\r\n\r\n",
        |config| {
            let commands = [DashboardCommand::UnlockProtectiveStop];
            ask_robot_api(config, ControllerVersion::POLYSCOPE_X, &commands)
        },
    ),
    // A package without a payload.
    ("primary interface", 3, &[0, 0, 0, 5, 16], |config| {
        read_kinematics(config).map(|info| format!("{info:?}"))
    }),
];

/// Asks a peer, which is left in 6 s: 3 to connect, and 3 for an answer.
fn asked((name, below, valid, ask): Question, (harm_name, harm): (&'static str, Harm)) {
    let client = Client {
        name,
        wire: Wire::Tcp(below),
        arguments: &[],
        greeting: Vec::new(),
        senseless: valid.to_vec(),
        bomb: [Vec::new(), Vec::new()],
        longest: [Duration::from_secs(6); 2],
    };
    let stop = Arc::new(AtomicBool::new(false));
    let address = lies_in_wait(&client, (harm_name, false, harm), &stop);
    let port = address
        .rsplit_once(':')
        .and_then(|(_, port)| port.parse().ok())
        .expect("a port");
    let begun = Instant::now();
    let answer = ask(&ClientConfig {
        port,
        ..ClientConfig::new("127.0.0.1")
    });
    stop.store(true, Ordering::Relaxed);
    println!("{name}, {harm_name}: {:.1?}, {answer:?}", begun.elapsed());
    assert!(begun.elapsed() < client.longest[0] + BUSY, "{name}, {harm_name}");
    // A line without sense is an answer: the robot's next state says what came of the request.
    assert!(
        answer.is_err() || valid.starts_with(answer.unwrap_or_default().as_bytes()),
        "{name}, {harm_name}"
    );
}

/// Lets every client whose budget is at most `wait` meet every peer, again and again for so long; at least once.
fn every_client(total: Duration, wait: Duration) {
    let clients = clients();
    let all: Vec<(usize, Peer)> = clients
        .iter()
        .enumerate()
        .flat_map(|(number, client)| peers(client).into_iter().map(move |peer| (number, peer)))
        .filter(|(number, peer)| clients[*number].longest[usize::from(peer.1)] <= wait)
        .collect();
    let seen: Vec<Mutex<Seen>> = clients.iter().map(|_| Mutex::default()).collect();
    let (next, begun) = (AtomicUsize::new(0), Instant::now());
    thread::scope(|scope| {
        for _ in 0..WORKERS {
            scope.spawn(|| {
                loop {
                    let turn = next.fetch_add(1, Ordering::Relaxed);
                    if turn >= all.len() && begun.elapsed() > total {
                        break;
                    }
                    let (number, peer) = all[turn % all.len()];
                    let (ended, wrong) = meets(&clients[number], peer);
                    let mut seen = seen[number].lock().expect("no panic");
                    seen.runs += 1;
                    seen.longest[usize::from(peer.1)] = seen.longest[usize::from(peer.1)].max(ended.took);
                    seen.mib = seen.mib.max(ended.mib);
                    seen.wrong.extend(wrong);
                    for (cause, count) in causes(&ended.said) {
                        *seen.causes.entry(cause).or_default() += count;
                    }
                }
            });
        }
    });
    let mut wrong = Vec::new();
    for (client, seen) in clients.iter().zip(&seen) {
        let seen = seen.lock().expect("no panic");
        let [before, after] = seen.longest;
        println!(
            "{}: {} peers were left, after {before:.1?} at most, greeted after {after:.1?}; {:.1} MiB",
            client.name, seen.runs, seen.mib
        );
        for (cause, count) in &seen.causes {
            println!("  said {count} times: {cause}");
        }
        wrong.extend(seen.wrong.clone());
    }
    thread::scope(|scope| {
        for question in QUESTIONS {
            for harm in HARMS {
                scope.spawn(move || asked(question, harm));
            }
        }
    });
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

// Fails if a client of the program goes on for longer than its budget with a peer that is silent, trickles, floods, is half
// open, says what has no sense, does not read, comes and goes, or promises the largest message; if it takes much memory,
// panics, or does not name the peer.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_hostile_peers_are_left() {
    every_client(Duration::ZERO, Duration::from_secs(6));
}

// The same with the clients that wait for a person or a paused simulator, for as long as is asked.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_hostile_peers_are_left() {
    let asked = std::env::var("SPHERECAL_HOSTILE_S")
        .ok()
        .and_then(|text| text.parse().ok());
    every_client(Duration::from_secs(asked.unwrap_or(300)), Duration::MAX);
}
