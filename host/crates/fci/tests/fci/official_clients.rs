//! The official client libraries, unchanged, against our robot side: `panda-python` 1.1.1 speaks version 5,
//! `pylibfranka` 0.21.3 version 10.
//!
//! They are installed by `scripts/official-clients.sh install`. Where they are missing the tests say so and pass, unless
//! `SPHERECAL_REQUIRE_FIELD` is set, as it is in the project's own test run. The libraries connect to port 1337 only, so
//! the tests take turns by a file lock.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::{Command as Process, Output};
use std::time::Duration;

use spherecal_fci::TCP_PORT;
use spherecal_fci::robot::{FR3_URDF, READY, RobotConfig, Tolerance, joint_arm, start_robot};
use spherecal_fci::wire::*;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..")
}

/// The Python that has the libraries; `None` if they are not installed and need not be.
fn python() -> Option<PathBuf> {
    let python = root().join("target/official-clients/bin/python");
    if python.exists() {
        return Some(python);
    }
    let words = "the official clients are not installed: run scripts/official-clients.sh install";
    assert!(std::env::var_os("SPHERECAL_REQUIRE_FIELD").is_none(), "{words}");
    eprintln!("left out: {words}");
    None
}

/// Holds port 1337 for one test of one process at a time.
fn port_1337() -> File {
    let lock = File::create(std::env::temp_dir().join("spherecal-fci-1337.lock")).expect("a lock file");
    lock.lock().expect("the lock");
    lock
}

fn run(python: &Path, version: Version, what: &str) -> Output {
    let script = root().join("tests/python/fci_conformance.py");
    let number = version.number().to_string();
    // A client that hangs must not hang the tests.
    Process::new("timeout")
        .args([
            "120".as_ref(),
            python.as_os_str(),
            script.as_os_str(),
            number.as_ref(),
            what.as_ref(),
        ])
        .output()
        .expect("python runs")
}

fn held(output: &Output) -> String {
    let (out, err) = (
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr),
    );
    assert!(output.status.success(), "{}\n{out}\n{err}", output.status);
    eprintln!("{out}");
    out.into_owned()
}

fn control(version: Version) {
    let Some(python) = python() else { return };
    let _turn = port_1337();
    let config = RobotConfig {
        tolerance: Tolerance::tolerant(),
        ..RobotConfig::new(version)
    };
    let side = start_robot(config, Box::new(joint_arm(READY))).expect("port 1337 is free");
    let out = held(&run(&python, version, "control"));
    assert!(out.contains("controller_torque_discontinuity"));
    let statistics = side.shut_down();
    eprintln!("{statistics:?}");
    assert_eq!(statistics.malformed, 0);
    assert!(statistics.commands > 5000);
}

// Fails if libfranka 0.9.2 does not read states, hold the arm within 1 mrad for 5 s, get the named reflex of a torque
// jump of 5,000 N m/s, or recover.
#[test]
fn panda_python_controls_the_robot_side() {
    control(Version::V5);
}

// The same with libfranka 0.21.3.
#[test]
fn pylibfranka_controls_the_robot_side() {
    control(Version::V10);
}

// Fails if the motion generators of libfranka 0.21.3, with either of the robot's own controllers, do not bring the arm
// where they lead.
#[test]
fn pylibfranka_moves_the_robot_side_by_its_generators() {
    let Some(python) = python() else { return };
    let _turn = port_1337();
    let config = RobotConfig {
        tolerance: Tolerance::tolerant(),
        ..RobotConfig::new(Version::V10)
    };
    let side = start_robot(config, Box::new(joint_arm(READY))).expect("port 1337 is free");
    held(&run(&python, Version::V10, "generators"));
    assert_eq!(side.shut_down().malformed, 0);
}

/// A robot side that only sends states in which every number says where it stands.
fn pattern(version: Version, listener: &TcpListener) {
    listener.set_nonblocking(true).expect("a listener");
    let accepted = (0..30_000).find_map(|_| {
        std::thread::sleep(Duration::from_millis(1));
        listener.accept().ok()
    });
    // The client's own words say why it did not come.
    let Some((mut tcp, peer)) = accepted else { return };
    tcp.set_nonblocking(false).expect("a stream");
    let read = |stream: &mut TcpStream| {
        let mut head = [0; HEADER_SIZE];
        stream.read_exact(&mut head).ok()?;
        let header = CommandHeader::decode(&head, MAX_REQUEST).expect("a header");
        let mut payload = vec![0; header.payload()];
        stream.read_exact(&mut payload).ok()?;
        Some((
            header,
            Request::decode(version, header.command, &payload).expect("a request"),
        ))
    };
    let respond = |stream: &mut TcpStream, command, id, body: &[u8]| {
        let mut bytes = Vec::new();
        let response = Response {
            command,
            id,
            status: Status::Success,
            body,
        };
        response.encode(version, &mut bytes).expect("a response");
        stream.write_all(&bytes)
    };
    let (header, request) = read(&mut tcp).expect("Connect");
    let Request::Connect {
        version: theirs,
        udp_port,
    } = request
    else {
        panic!("{request:?}")
    };
    assert_eq!(theirs, version.number());
    respond(
        &mut tcp,
        CommandKind::Connect,
        header.id,
        &version.number().to_le_bytes(),
    )
    .expect("a client");
    tcp.set_read_timeout(Some(Duration::from_millis(1))).expect("a stream");
    let udp = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let mut state = RobotState {
        robot_mode: RobotMode::Guiding,
        control_command_success_rate: 0.75,
        ..RobotState::default()
    };
    for (field, numbers) in state.numbers_mut().into_iter().enumerate() {
        for (index, number) in numbers.iter_mut().enumerate() {
            *number = 100.0 * (field + 1) as f64 + index as f64;
        }
    }
    for message_id in 1..30_000_u64 {
        state.message_id = message_id;
        let bit = (message_id / 20 % 41) as usize;
        state.errors = ErrorSet::of(ErrorFlag::ALL[bit]);
        state.reflex_reason = ErrorSet::of(ErrorFlag::ALL[40 - bit]);
        let mut bytes = [0; MAX_STATE_SIZE];
        let size = state.encode(version, &mut bytes);
        let _ = udp.send_to(&bytes[..size], SocketAddr::new(peer.ip(), udp_port));
        // A request, or after a millisecond none.
        match tcp.peek(&mut [0]) {
            Ok(0) => return,
            Ok(_) => {
                let Some((header, request)) = read(&mut tcp) else {
                    return;
                };
                let body = if request == Request::GetRobotModel {
                    FR3_URDF.as_bytes()
                } else {
                    &[]
                };
                if respond(&mut tcp, request.command(), header.id, body).is_err() {
                    return;
                }
            }
            Err(error)
                if matches!(
                    error.kind(),
                    std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut
                ) => {}
            Err(_) => return,
        }
    }
}

fn layout(version: Version) {
    let Some(python) = python() else { return };
    let _turn = port_1337();
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, TCP_PORT)).expect("port 1337 is free");
    let output = std::thread::scope(|scope| {
        let client = scope.spawn(|| run(&python, version, "layout"));
        pattern(version, &listener);
        client.join().expect("a client")
    });
    let out = held(&output);
    assert!(out.contains("\"error_flags\": 41"), "{out}");
}

// Fails if libfranka 0.9.2 reads one number of the state, or one error flag, under another name than we write it.
#[test]
fn panda_python_reads_every_field() {
    layout(Version::V5);
}

// The same with libfranka 0.21.3.
#[test]
fn pylibfranka_reads_every_field() {
    layout(Version::V10);
}
