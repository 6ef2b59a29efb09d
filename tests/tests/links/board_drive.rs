//! The drive link in real time as a controller board has it: over a serial line (a pseudo-terminal pair), and over UDP.

use std::collections::BTreeSet;
use std::io::ErrorKind;
use std::net::UdpSocket;
use std::thread;

use serial2::SerialPort;
use spherecal::link::tcp::{DriveServer, RemoteDrive, TcpError, Threaded, listen_udp};
use spherecal::link::{Drive, LinkError};
use spherecal::sim::plant::PlantConfig;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveCommand, DriveState};
use spherecal_shared::protocol::host::Event;
use spherecal_tests::plan::{ONCE, carry_out_with, plant, short_plan};

fn arm() -> DriveServer {
    let typical = PlantConfig::typical();
    DriveServer::new(plant(&typical, &short_plan(&typical, &[1], &[0.0, 0.12])), true)
}

/// A plant that serves the other end of a serial line, and this end.
fn served() -> (SerialPort, thread::JoinHandle<Result<u64, LinkError>>) {
    let (board, port) = SerialPort::pair().expect("a pseudo-terminal");
    let serve = move || arm().serve_port(port, "the board").map(|counts| counts.commands);
    (board, thread::spawn(serve))
}

/// The address of a plant that serves UDP until the process ends.
fn served_udp() -> String {
    let (socket, address) = listen_udp("0").expect("a free port");
    thread::spawn(move || arm().serve_udp(&socket));
    address.to_string()
}

// Fails if a controller that begins in the middle of the states gets no hello, if states are lost or repeated on a whole
// line, if one that begins again does not get the hello again, or if the plant goes on when the line is gone.
#[test]
fn a_board_that_restarts_gets_the_hello_again() {
    let (board, served) = served();
    for _ in 0..2 {
        let again = board.try_clone().expect("the same line");
        let mut drive = RemoteDrive::at_port(again, "the plant").expect("a hello");
        assert!(!drive.hello().lock_step);
        assert_eq!(drive.hello().limits.len(), 7);
        let mut state = DriveState::default();
        drive.exchange(None, &mut state).expect("a state");
        let first = state.tick;
        for _ in 0..50 {
            drive.exchange(None, &mut state).expect("a state");
        }
        assert!(state.tick > first, "{first} to {}", state.tick);
        assert_eq!((drive.counters().crc_errors, drive.counters().duplicates), (0, 0));
    }
    drop(board);
    let _ = served.join().expect("no panic");
}

// Fails if a controller that asks over UDP gets no hello and no states, if who sends no frame takes its place, if a flood of
// another one's datagrams holds its own up, or if another one is not heard after the first was silent for 5 s.
#[test]
#[ignore = "timed: the gate runs it"]
fn timed_datagrams_come_from_one_controller_at_a_time() {
    let address = served_udp();
    let mut state = DriveState::default();
    let stranger = UdpSocket::bind("127.0.0.1:0").expect("a socket");
    stranger.set_nonblocking(true).expect("a socket");
    // No frame: neither of them earns the place.
    stranger.send_to(&[1, 2], &address).expect("sent");
    stranger.send_to(&[1, 0], &address).expect("sent");
    let mut first = RemoteDrive::at_socket(&address).expect("a hello");
    let hello = first.hello().clone();
    assert!(!hello.lock_step);
    let command = DriveCommand {
        session: hello.session,
        ..DriveCommand::default()
    };
    for _ in 0..500 {
        first.exchange(Some(&command), &mut state).expect("a state");
        for _ in 0..20 {
            // The kernel may have no room for a flood.
            let _ = stranger.send_to(&[1, 0], &address);
        }
    }
    let heard = stranger.recv(&mut [0; 64]).map_err(|error| error.kind());
    assert_eq!(heard, Err(ErrorKind::WouldBlock));
    assert!(state.tick > 250, "{}", state.tick);
    assert_eq!((first.counters().crc_errors, first.counters().duplicates), (0, 0));
    drop(first);
    // For the rest of the 5 s in which it might come back it is asked in vain.
    let again = RemoteDrive::at_socket(&address).or_else(|_| RemoteDrive::at_socket(&address));
    assert_eq!(again.expect("a hello").hello().session, hello.session);
}

// Fails if an address where nobody listens is waited for, or is not named.
#[test]
fn nobody_at_a_socket_is_told_at_once() {
    let free = UdpSocket::bind("127.0.0.1:0").and_then(|socket| socket.local_addr());
    let address = free.expect("a free port").to_string();
    let refused = RemoteDrive::at_socket(&address).map(|_| ());
    assert!(matches!(refused, Err(TcpError::Unreachable { .. })), "{refused:?}");
}

// Fails if a whole visit of a sphere, in real time over a serial line, ends with a fault or without a recording.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_board_at_a_serial_line_calibrates() {
    let (board, served) = served();
    visits_a_sphere(RemoteDrive::at_port(board, "the plant").expect("a hello"));
    let _ = served.join().expect("no panic");
}

// The same over UDP.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_board_behind_udp_calibrates() {
    visits_a_sphere(RemoteDrive::at_socket(&served_udp()).expect("a hello"));
}

fn visits_a_sphere(drive: RemoteDrive) {
    let mut device = Threaded::start(Box::new(drive), 7).expect("a controller");
    let plan = short_plan(&PlantConfig::typical(), &[1], &[0.0, 0.12]);
    // The computer may stall both sides for some ms; only silence may be a fault here.
    let mut procedure = Procedure::default();
    procedure.limits.missed_ticks = 100;
    let (memory, outcome, result) = carry_out_with(&mut device, &plan, &BTreeSet::new(), &procedure, ONCE);
    let faults = memory.events.iter().filter(|event| matches!(event, Event::Fault(_)));
    assert!(result.is_ok(), "{result:?} after {:?}", faults.collect::<Vec<_>>());
    assert_eq!((outcome.faults.len(), outcome.contacts.len()), (0, 1));
    assert_eq!(memory.recordings.len(), 2);
}
