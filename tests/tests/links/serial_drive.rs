//! The drive link over a serial line, as a controller board has it: a pseudo-terminal pair, in real time.

use std::collections::BTreeSet;
use std::thread;

use serial2::SerialPort;
use spherecal::link::tcp::{DriveServer, RemoteDrive, Threaded};
use spherecal::link::{Drive, LinkError};
use spherecal::sim::plant::PlantConfig;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::DriveState;
use spherecal_shared::protocol::host::Event;
use spherecal_tests::plan::{ONCE, carry_out_with, plant, short_plan};

/// A plant that serves the other end of a serial line, and this end.
fn served() -> (SerialPort, thread::JoinHandle<Result<u64, LinkError>>) {
    let (board, port) = SerialPort::pair().expect("a pseudo-terminal");
    let serve = move || {
        let typical = PlantConfig::typical();
        let drive = plant(&typical, &short_plan(&typical, &[1], &[0.0, 0.12]));
        let served = DriveServer::new(drive, true).serve_port(port, "the board");
        served.map(|counts| counts.commands)
    };
    (board, thread::spawn(serve))
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

// Fails if a whole visit of a sphere, in real time over a serial line, ends with a fault or without a recording.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_board_at_a_serial_line_calibrates() {
    let (board, served) = served();
    let drive = RemoteDrive::at_port(board, "the plant").expect("a hello");
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
    drop(device);
    let _ = served.join().expect("no panic");
}
