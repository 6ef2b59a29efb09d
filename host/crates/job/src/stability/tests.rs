//! Tests of how still a hold was.

use super::*;
use spherecal_shared::protocol::host::{Banner, PhaseChange, Recording, Sample, SignalStatistics};
use spherecal_shared::robot::{iiwa7, iiwa7_tool};

/// Ten seconds of white noise of 10 µrad, and `drift` (rad/s) in joint 4.
fn hold(drift: f64) -> Hold {
    let mean = vec![0.1, 0.6, -0.1, -1.5, 0.05, 1.0, 0.2];
    let mut state = 7u64;
    let mut noise = || {
        let mut sum = 0.0;
        for _ in 0..12 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            sum += (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5;
        }
        sum * 1e-5
    };
    let samples = (1..=10_000u64)
        .map(|k| {
            let mut q: Vec<f64> = mean.iter().map(|m| m + noise()).collect();
            q[3] += drift * k as f64 * 1e-3;
            (500 + k, q)
        })
        .collect();
    Hold {
        sphere: 2,
        pose: 5,
        count: 10_000,
        end_tick: 10_500,
        mean,
        samples,
        period_s: 1e-3,
    }
}

// Fails if the estimated noise is not the generated noise, if noise alone counts as drift, or
// if a drift is not found with its size.
#[test]
fn noise_and_drift_are_told_apart() {
    let chain = Chain::new(&iiwa7(), &iiwa7_tool()).expect("a chain");
    let still = analyse(&hold(0.0), &chain, 1.0).expect("ten windows");
    assert_eq!((still.windows, still.samples), (10, (10_000, 10_000)));
    for joint in &still.joints_urad {
        // 10 µrad over 1,000 samples.
        assert!((joint.noise / 0.316 - 1.0).abs() < 0.5, "{joint:?}");
    }
    assert!(
        still.within_noise && still.joints_within_noise,
        "{:?}",
        still.joints_urad
    );
    let drifting = analyse(&hold(1e-6), &chain, 1.0).expect("ten windows");
    let joint = &drifting.joints_urad[3];
    assert!((joint.drift_per_s - 1.0).abs() < 0.1, "{joint:?}");
    assert!((joint.first + 4.5).abs() < 1.0 && !joint.within());
    assert!(!drifting.joints_within_noise && !drifting.within_noise);
    // Joint 4 has the TCP some half a metre away.
    let tcp = drifting.tcp_um.drift_per_s;
    assert!((0.2..0.9).contains(&tcp), "{tcp} µm/s");
}

// Fails if a nest that moves within a hold is not told, or if its window enters the noise.
#[test]
fn a_nest_that_moves_is_told() {
    let chain = Chain::new(&iiwa7(), &iiwa7_tool()).expect("a chain");
    let still = analyse(&hold(0.0), &chain, 1.0).expect("ten windows");
    let mut moved = hold(0.0);
    // In the middle of window 7 (from 0), by some 100 µm.
    for (_, q) in moved.samples.iter_mut().skip(7_500) {
        q[3] += 2e-4;
    }
    let found = analyse(&moved, &chain, 1.0).expect("ten windows");
    assert!(
        (found.tcp_um.noise / still.tcp_um.noise - 1.0).abs() < 0.3,
        "{:?}",
        found.tcp_um
    );
    let jump = found.jump.expect("a step");
    assert!(
        (6.9..8.1).contains(&jump.at_s) && (20.0..120.0).contains(&jump.size_um),
        "{jump:?}"
    );
    assert!(still.is_still() && !found.is_still());
}

// Fails if windows assume a control period of 1 ms.
#[test]
fn windows_follow_the_period_of_the_drive() {
    let chain = Chain::new(&iiwa7(), &iiwa7_tool()).expect("a chain");
    let slow = Hold {
        period_s: 2e-3,
        ..hold(0.0)
    };
    let held = analyse(&slow, &chain, 1.0).expect("twenty windows");
    assert_eq!(held.windows, 20);
    let unknown = Hold {
        period_s: 0.0,
        ..hold(0.0)
    };
    assert!(analyse(&unknown, &chain, 1.0).is_err());
}

// Fails if lost telemetry counts as a window, or if an empty hold is accepted.
#[test]
fn windows_with_holes_are_left_out() {
    let chain = Chain::new(&iiwa7(), &iiwa7_tool()).expect("a chain");
    let mut holed = hold(0.0);
    holed.samples.retain(|(tick, _)| !(2_600..2_700).contains(tick));
    assert_eq!(analyse(&holed, &chain, 1.0).expect("nine windows").windows, 9);
    holed.samples.clear();
    let error = analyse(&holed, &chain, 1.0).expect_err("nothing was heard");
    assert!(error.to_string().contains("0 of 10000 samples"), "{error}");
}

// Fails if the pull at the nest after the last averaged sample, in the same phase, is part of the hold.
#[test]
fn the_pull_after_a_recording_is_no_part_of_the_hold() {
    let mut silent = spherecal_campaign::Silent;
    let mut keeper = SampleKeeper::new(&mut silent, 7);
    let mut hear = |body: Event| {
        let arrival = Arrival {
            session: Default::default(),
            event: 0,
            sent_us: 0,
            body,
        };
        keeper.event(0, &arrival);
    };
    let phase = |from, phase, tick| {
        Event::Phase(PhaseChange {
            phase,
            from,
            time_us: 1_000 * tick,
            tick,
        })
    };
    hear(Event::Banner(Banner {
        protocol: 1,
        schema: 0,
        version: heapless::String::new(),
        build: heapless::String::new(),
        joints: 7,
        period_us: 1000,
        first_event: 1,
    }));
    hear(phase(Phase::Turning, Phase::Recording, 1_000));
    // 2,000 averaged samples, then a pull of 150.
    let ticks: Vec<u64> = (1_001..=3_150).collect();
    for batch in ticks.chunks(8) {
        let samples = batch.iter().map(|tick| Sample {
            tick: *tick,
            phase: Phase::Recording,
            q: [if *tick > 3_000 { 1.0 } else { 0.5 }; 8],
            ..Sample::default()
        });
        hear(Event::Telemetry(samples.collect()));
    }
    hear(Event::Recording(Recording {
        sphere: 2,
        pose: 5,
        start_us: 1_001_000,
        end_us: 3_000_000,
        count: 2_000,
        gaps: 0,
        q: (0..7).map(|_| SignalStatistics::default()).collect(),
        tau: heapless::Vec::new(),
        tcp_spread_m: 0.0,
        force_n: [0.0; 3],
    }));
    hear(phase(Phase::Recording, Phase::Coupled, 3_150));
    let holds = keeper.finish();
    assert_eq!((holds.len(), holds[0].end_tick, holds[0].count), (1, 3_000, 2_000));
    let chain = Chain::new(&iiwa7(), &iiwa7_tool()).expect("a chain");
    let held = analyse(&holds[0], &chain, 1.0).expect("two windows");
    assert_eq!((held.windows, held.tcp_um.largest), (2, 0.0));
}
