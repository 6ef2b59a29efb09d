//! Peers that take without giving: what they get, and for how long.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use spherecal_shared::robot::{iiwa7, iiwa7_tool};
use spherecal_store::{CalibrationStore as _, NewRun, SqlStore};

use crate::live::Hub;
use crate::web::Page;
use crate::{GuardFiles, Offer, Server};

/// Longest wait for an end that must come in a second, on a busy machine.
const END: Duration = Duration::from_mins(1);
/// Bytes of the report: more than the system holds for a client that does not read.
const REPORT: usize = 24 << 20;

/// A server with one stored run, whose report is large.
fn server(folder: &std::path::Path) -> Server {
    let mut store = SqlStore::create_or_open(&folder.join("calibration.db")).expect("made");
    let run = store.create_run(&NewRun {
        created_utc: "2026-01-02T03:04:05Z".to_owned(),
        seed: 1,
        link: "sim".to_owned(),
        robot: iiwa7(),
        tool: iiwa7_tool(),
        config_toml: String::new(),
        plan_json: "{}".to_owned(),
        program: "test".to_owned(),
        spheres: Vec::new(),
        poses: Vec::new(),
        arm: "A-17".to_owned(),
    });
    store.set_state(run.expect("a run"), "complete").expect("set");
    let page = Page {
        hub: Arc::new(Hub::default()),
        store: Some(Arc::new(Mutex::new(Box::new(store)))),
        report: Some(Arc::new(|_, _| Ok(Box::new(|| Ok("x".repeat(REPORT)))))),
    };
    let offer = Offer {
        page: Some((page, false)),
        ..Offer::default()
    };
    Server::start("0", &GuardFiles::default(), offer).expect("a server")
}

fn ask(address: SocketAddr) -> TcpStream {
    let mut stream = TcpStream::connect(address).expect("connects");
    let request = format!("GET /report/1 HTTP/1.1\r\nHost: {address}\r\n\r\n");
    stream.write_all(request.as_bytes()).expect("sent");
    stream
}

/// Everything that comes until the other side has sent so much, or closes.
fn read(mut stream: TcpStream, most: usize) -> usize {
    stream.set_read_timeout(Some(Duration::from_secs(30))).expect("set");
    let (mut buffer, mut total) = (vec![0; 1 << 16], 0);
    while total < most {
        match stream.read(&mut buffer) {
            Ok(count) if count > 0 => total += count,
            _ => break,
        }
    }
    total
}

/// Most memory that this process has had, in MiB.
fn peak_mib() -> usize {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status.lines().find(|line| line.starts_with("VmHWM")).expect("there");
    let kib: usize = line
        .split_whitespace()
        .nth(1)
        .expect("a number")
        .parse()
        .expect("a number");
    kib / 1024
}

// Fails if each client that asks for a report and does not read it costs a copy of it, if such a client is kept for
// ever, or if an honest client is not served beside them.
#[cfg(target_os = "linux")]
#[test]
fn unread_responses_share_their_bytes_and_end() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = server(folder.path());
    assert!(read(ask(server.address()), REPORT) >= REPORT);
    let before = peak_mib();
    let unread: Vec<TcpStream> = (0..60).map(|_| ask(server.address())).collect();
    for _ in 0..3 {
        assert!(read(ask(server.address()), REPORT) >= REPORT, "an honest client");
    }
    let grown = peak_mib() - before;
    // 60 copies of 24 MiB are 1,440 MiB. Sockets hold some.
    assert!(grown < 600, "{grown} MiB");
    for mut stream in unread {
        // A connection that the server has closed takes no more bytes.
        let begun = Instant::now();
        while stream.write_all(b"x").is_ok() {
            assert!(begun.elapsed() < END, "an unread response is kept for ever");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// A server that does this with whoever connects.
#[cfg(feature = "grpc")]
fn hostile(act: fn(&mut TcpStream) -> std::io::Result<()>) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = listener.local_addr().expect("an address");
    std::thread::spawn(move || {
        for mut stream in listener.incoming().flatten() {
            std::thread::spawn(move || while act(&mut stream).is_ok() {});
        }
    });
    address
}

// Fails if a client of a service waits for a server that accepts and says nothing, trickles, or floods, or if it does
// not name the server.
#[cfg(feature = "grpc")]
#[test]
fn a_server_that_does_not_answer_is_left() {
    use crate::grpc::{RemoteRobot, RemoteStore, RemoteTracker};

    let silent: fn(&mut TcpStream) -> std::io::Result<()> = |_| {
        std::thread::sleep(Duration::from_millis(50));
        Ok(())
    };
    let trickle: fn(&mut TcpStream) -> std::io::Result<()> = |stream| {
        std::thread::sleep(Duration::from_millis(50));
        stream.write_all(&[0])
    };
    // Settings of HTTP/2 without end: frames that are valid and say nothing.
    let flood: fn(&mut TcpStream) -> std::io::Result<()> = |stream| stream.write_all(&[0, 0, 0, 4, 0, 0, 0, 0, 0]);
    let wrong: fn(&mut TcpStream) -> std::io::Result<()> = |stream| stream.write_all(&[0x41; 4096]);
    for act in [silent, trickle, flood, wrong] {
        let address = hostile(act);
        let peer = || spherecal_store::Peer {
            address: address.to_string(),
            encrypted: false,
        };
        let said = [
            RemoteStore::connect(&peer()).err().expect("left").to_string(),
            RemoteTracker::connect(&peer()).err().expect("left").to_string(),
            RemoteRobot::attach(&peer(), &iiwa7()).err().expect("left").to_string(),
        ];
        for said in said {
            println!("{said}");
            assert!(said.contains(&address.to_string()), "{said}");
        }
    }
}
