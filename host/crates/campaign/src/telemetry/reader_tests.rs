//! Telemetry files, whole and torn.

use std::collections::BTreeMap;

use spherecal_shared::MAX_JOINTS;
use spherecal_shared::protocol::host::{Phase, Sample};

use super::super::{DrawnArm, Moment, TelemetryWriter};
use super::*;

const DAY_NS: u64 = 1_800_000_000_000_000_000;

fn written(samples: &[(u64, Sample)]) -> Vec<u8> {
    written_by(samples, |writer| writer.finish().expect("finished"))
}

fn written_by(samples: &[(u64, Sample)], end: impl FnOnce(TelemetryWriter<&mut std::io::Cursor<Vec<u8>>>)) -> Vec<u8> {
    let model = spherecal_model::robots::built_in("ur5e").expect("built in");
    let arm = DrawnArm::new(&model, &model.tool_in_table());
    let mut bytes = std::io::Cursor::new(Vec::new());
    let mut writer = TelemetryWriter::new(&mut bytes, arm, &BTreeMap::new(), DAY_NS).expect("a writer");
    for &(device_us, sample) in samples {
        let utc_ns = DAY_NS + 1000 * device_us;
        writer.write(Moment { utc_ns, device_us }, &sample).expect("written");
    }
    end(writer);
    bytes.into_inner()
}

// Fails if a time, a phase, a number that is not finite or a zero reads back as another, or if a number is another by more
// than sensors tell: 0.3e-6 rad, 4e-6 rad/s, 1 mN m, 4 mN, 0.3 µm.
#[test]
fn samples_read_back() {
    let sample = Sample {
        phase: Phase::HandGuiding,
        q: [0.1, -1.0 / 3.0, f32::MIN_POSITIVE, 1e-7, 2.5, -0.0, 9.0, 9.0],
        dq: [1e-3, -0.7, 0.0, 0.0, 0.0, 2.0, 9.0, 9.0],
        tau: [f32::NAN; MAX_JOINTS],
        command: [-12.3; MAX_JOINTS],
        force_n: [0.1, f32::INFINITY, -7.3],
        tcp_m: [0.3, 0.2, 0.103],
        setpoint_m: [0.3, 0.2, 0.1],
        flags: 5,
        ..Sample::default()
    };
    let bytes = written(&[(1_234_567, sample), (1_236_567, Sample::default())]);
    let periods: Vec<Period> = TelemetryReader::new(&bytes)
        .expect("a file")
        .collect::<Result<_, _>>()
        .expect("readable");
    assert_eq!(
        periods
            .iter()
            .map(|p| (p.utc_ns - DAY_NS, p.device_ns))
            .collect::<Vec<_>>(),
        [(1_234_567_000, 1_234_567_000), (1_236_567_000, 1_236_567_000)]
    );
    let near = |told: &[f64], measured: &[f32], most: f64| {
        let pairs = told.iter().zip(measured);
        assert!(told.len() == 6 && pairs.into_iter().all(|(a, b)| (a - f64::from(*b)).abs() < most));
    };
    let joints = &periods[0].joints;
    assert_eq!(joints.header.stamp.sec, 1_800_000_001);
    assert_eq!(joints.header.stamp.nanosec, 234_567_000);
    assert_eq!(joints.name[5], "joint_6");
    near(&joints.position, &sample.q, 0.3e-6);
    near(&joints.velocity, &sample.dq, 4e-6);
    assert!(joints.effort.len() == 6 && joints.effort.iter().all(|x| x.is_nan()));
    let wrench = periods[0].wrench.expect("a wrench");
    assert!((wrench.force.x - 0.1).abs() < 4e-3 && wrench.force.y == f64::INFINITY);
    let control = periods[0].control.as_ref().expect("a command");
    assert!(control.command.len() == 6 && control.command.iter().all(|c| (c + 12.3).abs() < 1e-3));
    assert!((control.setpoint.x - 0.3).abs() < 0.3e-6 && (control.deviation_mm - 3.0).abs() < 3e-3);
    let phase = periods[0].phase.as_ref().expect("a phase");
    assert_eq!((phase.phase.as_str(), phase.saturated), ("hand_guiding", true));
    assert!(phase.near_singular && !phase.rate_limited);
    // The uncertainty depends on the posture: it is told once for both samples.
    let uncertain = periods[0].uncertainty.expect("an uncertainty");
    assert!(uncertain.force.x > 1.0, "{uncertain:?}");
    assert_eq!(periods[1].uncertainty, periods[0].uncertainty);
    assert_eq!(periods[1].phase.as_ref().expect("a phase").phase, "idle");
}

/// So many samples, one each ms.
fn samples(count: u32) -> Vec<(u64, Sample)> {
    (0..count)
        .map(|k| {
            let sample = Sample {
                q: [k as f32 * 1e-3; MAX_JOINTS],
                ..Sample::default()
            };
            (u64::from(k) * 1000, sample)
        })
        .collect()
}

/// Samples of some seconds, in several chunks.
fn long() -> Vec<u8> {
    written(&samples(2500))
}

fn read(bytes: &[u8]) -> (Result<Vec<Period>, TelemetryError>, bool) {
    let mut reader = match TelemetryReader::new(bytes) {
        Ok(reader) => reader,
        Err(error) => return (Err(error), false),
    };
    let periods = reader.by_ref().collect();
    (periods, reader.torn().is_some())
}

// Fails if the whole chunks of a file whose writer was killed are not read, or if such a file
// counts as a whole one.
#[test]
fn a_torn_file_is_read_to_its_last_whole_chunk() {
    let bytes = long();
    let (all, torn) = read(&bytes);
    let all = all.expect("readable");
    assert!(all.len() == 2500 && !torn);
    for cut in [bytes.len() / 2, bytes.len() * 3 / 4, bytes.len() - 3] {
        let (periods, torn) = read(&bytes[..cut]);
        let periods = periods.expect("readable");
        assert!(torn && !periods.is_empty(), "{} periods of {cut} bytes", periods.len());
        assert_eq!(periods, all[..periods.len()]);
    }
    let (other, _) = read(b"no MCAP");
    assert!(other.expect_err("refused").to_string().contains("mcap recover"));
}

// Fails if the file of a writer that was killed is refused, because its last chunk is open, if a whole chunk of
// it is not read, or if what is left out is not counted.
#[test]
fn a_file_with_an_open_chunk_is_read_to_its_last_whole_chunk() {
    let (all, _) = read(&long());
    let all = all.expect("readable");
    for count in [3, 2500] {
        // As a kill: nothing is closed.
        let bytes = written_by(&samples(count), |writer| std::mem::forget(writer));
        let mut reader = TelemetryReader::new(&bytes).expect("MCAP");
        let periods: Vec<Period> = reader.by_ref().collect::<Result<_, _>>().expect("readable");
        let torn = reader.torn().expect("torn");
        assert_eq!(torn.periods, periods.len() as u64);
        assert!(torn.left_out > 0 && torn.left_out < bytes.len(), "{torn:?}");
        assert_eq!(periods, all[..periods.len()]);
        assert_eq!(periods.is_empty(), count == 3, "{} periods", periods.len());
    }
}

// Fails if a flipped bit of a whole file ends the program, takes all memory, or changes a
// period in silence.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_flipped_bit_is_an_error_and_no_panic() {
    let bytes = long();
    let whole = read(&bytes).0.expect("readable");
    let mut refused = 0;
    // Every bit of the lengths and headers at the beginning, and bits all over the file.
    let begin = 0..32 * 8;
    let over = (0..100).map(|k| bytes.len() * 8 / 100 * k + k % 8);
    for bit in begin.chain(over) {
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        match read(&damaged).0 {
            Ok(periods) => assert!(periods == whole, "bit {bit} changed a period in silence"),
            Err(_) => refused += 1,
        }
    }
    assert!(refused > 90, "only {refused} were seen");
}
