//! The host link over a serial line: a pseudo-terminal stands for the cable, a
//! controller that keeps its own beat for the board.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use serial2::SerialPort;
use spherecal::campaign::Outcome;
use spherecal::link::{Device, LinkError, LocalDevice, Serial};
use spherecal::plan::Plan;
use spherecal::sim::plant::PlantConfig;
use spherecal_shared::protocol::host::Recording;
use spherecal_tests::plan::{carry_out, cell, plant, short_plan};

/// The turns of a short campaign about one sphere, in rad.
const TURNS: [f64; 2] = [0.0, 0.12];

/// A short plan of one sphere.
fn short() -> Plan {
    short_plan(&PlantConfig::typical(), &[1], &TURNS)
}

fn simulated() -> LocalDevice {
    cell(plant(&PlantConfig::typical(), &short()))
}

fn campaign(device: &mut dyn Device) -> (Vec<Recording>, Outcome) {
    let (memory, outcome, result) = carry_out(device, &short(), &BTreeSet::new());
    result.expect("the campaign ends well");
    (memory.recordings, outcome)
}

/// A board: a control period at every millisecond, whoever listens.
fn board(mut cell: LocalDevice, line: &SerialPort, gone: &AtomicBool) {
    let (begun, mut periods) = (Instant::now(), 0);
    let (mut down, mut up, mut buffer) = (Vec::new(), Vec::new(), [0; 4096]);
    while !gone.load(Ordering::Relaxed) {
        // The timeout of the port paces this loop.
        if let Ok(count) = line.read(&mut buffer) {
            down.extend_from_slice(&buffer[..count]);
        }
        while begun.elapsed() > Duration::from_millis(periods) {
            periods += 1;
            up.clear();
            cell.step(&down, &mut up).expect("a period");
            down.clear();
            // What nobody takes is lost, as on a wire.
            let _ = line.write(&up);
        }
    }
}

// Fails if the bytes of a serial line (echo, line ends, signals) reach the
// frames, if the host's clock is taken for the board's, or if a campaign in real
// time ends with other joint angles than in lock-step.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_board_on_a_serial_line_records_what_the_lock_step_does() {
    let (mut line, port) = SerialPort::pair().expect("a pseudo-terminal");
    line.set_read_timeout(Duration::from_millis(1)).expect("set up");
    line.set_write_timeout(Duration::from_millis(1)).expect("set up");
    let gone = Arc::new(AtomicBool::new(false));
    let thread = thread::spawn({
        let (gone, cell) = (Arc::clone(&gone), simulated());
        move || board(cell, &line, &gone)
    });
    let mut device = Serial::over(port, "serial:test").expect("a device");
    let (recorded, outcome) = campaign(&mut device);
    gone.store(true, Ordering::Relaxed);
    thread.join().expect("the board lived");
    assert_eq!((outcome.faults.len(), outcome.contacts.len()), (0, 1));
    let (expected, _) = campaign(&mut simulated());
    assert_eq!(recorded.len(), expected.len());
    for (a, b) in recorded.iter().zip(&expected) {
        for (a, b) in a.q.iter().zip(&b.q) {
            // Equal in ten runs, also beside six busy processes; 2e-4 rad apart in one, in which the host's command came late.
            assert!((a.mean - b.mean).abs() < 5e-4, "{} and {} rad", a.mean, b.mean);
        }
    }
}

// Fails if a device that is not there, or a rate that is none, is refused
// without a word of what to do.
#[test]
fn a_device_that_cannot_be_opened_is_refused_with_a_remedy() {
    let said = |device: &str| {
        Serial::open(device)
            .err()
            .map(|e: LinkError| e.to_string())
            .unwrap_or_default()
    };
    let absent = said("/dev/no-such-board");
    assert!(
        absent.contains("/dev/no-such-board") && absent.contains("spherecal doctor"),
        "{absent}"
    );
    let rate = said("/dev/null@fast");
    assert!(rate.contains("@921600"), "{rate}");
}
