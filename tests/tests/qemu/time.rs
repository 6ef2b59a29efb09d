//! Time on a board: a 32-bit counter that wraps, beats that others would move,
//! ticks that take too long.

use spherecal::link::qemu::{Machine, QemuOptions};
use spherecal_shared::protocol::host::{Event, Fault, Phase};
use spherecal_tests::bench::HOME;
use spherecal_tests::qemu::{bench, image, log_of, numbers, options, scenario, scenario_log};

/// Counts of the board's 25 MHz timer in one tick of embassy's time, 1 µs.
const TICK: u64 = 25;
/// Both a beat and the first beat are read in whole counts: their difference is known to one.
const READ: u64 = 1;
/// Ticks of embassy's time by which a beat may move: one, because alarms are set in whole ticks; and
/// one more, because the alarm of another task that is due at the same time may be served first. The
/// timer's handler has up to 160 instructions. How long it takes depends on the compiler: the same
/// sources gave 25 to 28 counts.
const TICKS: u64 = 2;

// Fails if a task that hogs the processor for 20 ms at a time moves the start of
// one control tick by more than 2 µs, through rest, approach and contact.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_hog_below_does_not_move_the_beat() {
    let Some(image) = image() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let options = QemuOptions {
        scenario: "hog".to_owned(),
        ..options(&image, folder.path())
    };
    let mut bench = bench(&options, &HOME);
    bench.approach(0.015);
    bench.until(Phase::Coupled, 15_000);
    let (ticks, fault) = (bench.tick, bench.fault());
    let log = log_of(bench, folder.path());
    let beats = numbers(&log, "ticks:");
    let [count, early, late, ..] = beats[..] else {
        panic!("{log}")
    };
    eprintln!("{count} beats, {early} counts early to {late} late");
    assert_eq!(fault, None, "{log}");
    // The count begins afresh behind a missed beat: none was. The last beat
    // finds that the drive has gone.
    assert_eq!(count, ticks + 1, "{log}");
    assert!(
        early <= TICKS * TICK + READ && late <= TICKS * TICK + READ,
        "{early} early, {late} late of {} counts",
        TICKS * TICK
    );
}

// Fails if ticks that take longer than their period are not counted, not told
// to the host, or never become a fault with a damped hold.
#[test]
fn an_overrun_is_counted_and_becomes_a_fault() {
    let Some(image) = image() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let options = QemuOptions {
        // 128 ns an instruction: a tick and its links take over 2 ms.
        shift: 7,
        ..options(&image, folder.path())
    };
    let mut bench = bench(&options, &HOME);
    for _ in 0..1200 {
        bench.still(&HOME);
    }
    assert_eq!(bench.fault(), Some(Fault::Overrun));
    let missed = bench.events.iter().rev().find_map(|event| match event {
        Event::Statistics(statistics) => Some(statistics.missed),
        _ => None,
    });
    assert!(missed.is_some_and(|missed| missed > 500), "{missed:?} missed");
    let held = bench.still(&HOME);
    assert!(held.enable && held.tau[1].abs() > 5.0, "gravity is held: {held:?}");
    let log = log_of(bench, folder.path());
    assert!(log.contains("overrun:"), "{log}");
}

// Fails if a beat is lost or moved, or time goes back, where the 32-bit counter wraps.
#[test]
fn time_goes_on_across_the_wrap_of_the_counter() {
    let Some(image) = image() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let output = scenario(&image, Machine::CortexM7, "wrap", folder.path());
    assert!(output.status.success(), "{}", scenario_log(&image, folder.path()));
}
