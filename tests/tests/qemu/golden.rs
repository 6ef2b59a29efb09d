//! One fixed run of the controller, contact and recordings included, has the
//! bits that it always had: in this process, and on the Cortex-M7 in QEMU.
//!
//! The arm and the host are the stand-ins of [`spherecal_tests::bench`], so
//! that nothing but the control path changes the hash. When the law is changed
//! on purpose, the failing test names the new one for [`GOLDEN`].

use sha2::{Digest, Sha256};
use spherecal::link::qemu::{Qemu, QemuOptions};
use spherecal::link::{Controller, InProcess};
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::DriveCommand;
use spherecal_shared::protocol::host::{Command, Phase, Recording};
use spherecal_tests::bench::{Bench, HOME, joints};
use spherecal_tests::qemu::image;

/// SHA-256 over torques and recordings of [`run`].
const GOLDEN: &str = "485f22861a09e1fca33111b1d5556248f96edff47ef5b077a13dfdf27c323871";
/// Seed of what the drives' noise is made of.
const SEED: u64 = 20_261_121;
/// Least number of ticks that the hash is to cover.
const TICKS: u64 = 10_000;

fn add(hash: &mut Sha256, values: impl IntoIterator<Item = f64>) {
    for value in values {
        hash.update(value.to_bits().to_le_bytes());
    }
}

fn add_command(hash: &mut Sha256, command: &DriveCommand) {
    hash.update(command.tick.to_le_bytes());
    hash.update([u8::from(command.enable)]);
    add(hash, command.tau.iter().copied());
}

fn add_recording(hash: &mut Sha256, recording: &Recording) {
    for number in [recording.sphere, recording.pose, recording.count, recording.gaps] {
        hash.update(number.to_le_bytes());
    }
    for time in [recording.start_us, recording.end_us] {
        hash.update(time.to_le_bytes());
    }
    for s in recording.q.iter().chain(&recording.tau) {
        add(hash, [s.mean, s.std, s.min, s.max]);
    }
    add(hash, [recording.tcp_spread_m]);
    add(hash, recording.force_n);
}

/// A motion, a contact, two recorded poses and the way off the sphere; returns
/// the hash and the number of ticks.
fn run(controller: impl Controller) -> (String, u64) {
    let mut hash = Sha256::new();
    let mut away = HOME;
    away[0] += 0.1;
    away[3] -= 0.05;
    // The motions and the spring of the paper: they take longer, and so cover more ticks.
    let mut procedure = Procedure {
        motion: Procedure::default().paper().motion,
        approach: Procedure::default().paper().approach,
        ..Procedure::default()
    };
    procedure.couple.hold_s = 1.0;
    let mut bench = Bench::configured(controller, &away, SEED, procedure);
    let mut tick = |bench: &mut Bench<_>, until: Phase, most: u64| {
        let last = bench.tick + most;
        loop {
            let seen = bench.events.len();
            let command = bench.step();
            add_command(&mut hash, &command);
            if bench.entered(until, seen) {
                return;
            }
            assert!(bench.tick < last, "{until:?} was not reached: {:?}", bench.fault());
        }
    };
    bench.order(Command::Move { target: joints(&HOME) });
    tick(&mut bench, Phase::Idle, 5_000);
    bench.approach(0.015);
    tick(&mut bench, Phase::Coupled, 15_000);
    for (pose, angle) in [(1, 0.2), (2, -0.15)] {
        bench.pose(pose, angle);
        tick(&mut bench, Phase::Coupled, 10_000);
    }
    bench.order(Command::Decouple);
    tick(&mut bench, Phase::Idle, 5_000);
    let recordings = bench.recordings();
    assert_eq!((recordings.len(), bench.fault()), (2, None));
    for recording in recordings {
        add_recording(&mut hash, recording);
    }
    let hash = hash.finalize();
    (hash.iter().map(|byte| format!("{byte:02x}")).collect(), bench.tick)
}

// Fails if a bit of a torque or of a recording differs from the committed run.
#[test]
fn in_this_process() {
    let (hash, ticks) = run(InProcess::<7>::default());
    assert!(ticks >= TICKS, "only {ticks} ticks");
    assert_eq!(
        hash, GOLDEN,
        "if the law was changed on purpose: GOLDEN is now \"{hash}\""
    );
}

/// The same run on the emulated Cortex-M7, this many times.
fn in_qemu(times: usize) {
    let Some(image) = image() else { return };
    for turn in 1..=times {
        let folder = tempfile::tempdir().expect("a folder");
        let options = QemuOptions {
            image: Some(image.clone()),
            ..QemuOptions::new(folder.path())
        };
        let start = std::time::Instant::now();
        let (hash, ticks) = run(Qemu::start(&options).expect("QEMU starts"));
        let rate = ticks as f64 / start.elapsed().as_secs_f64();
        eprintln!("run {turn}: {ticks} ticks, {rate:.0} a second");
        assert_eq!(hash, GOLDEN, "run {turn} of {times}");
    }
}

// Fails if a bit differs on the Cortex-M7.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_in_qemu() {
    in_qemu(1);
}

// Fails if a bit differs on the Cortex-M7 in one run out of three.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_in_qemu_three_times_out_of_three() {
    in_qemu(3);
}
