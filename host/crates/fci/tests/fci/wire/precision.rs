//! What version 10 loses by 32-bit floats.

use spherecal_fci::wire::*;

// Fails if an angle of version 10 is further from the true one than half a step of a 32-bit float. Says what the
// documentation says: 2.4e-7 rad at 3 rad.
#[test]
fn angles_of_version_10_have_the_documented_step() {
    let mut state = RobotState::default();
    let mut worst: f64 = 0.0;
    for k in 0..1000 {
        let angle = 2.9 + 1e-4 * f64::from(k) + 1.234_567_89e-8;
        state.q = [angle; 7];
        let mut bytes = [0; MAX_STATE_SIZE];
        let size = state.encode(Version::V10, &mut bytes);
        let back = RobotState::decode(Version::V10, &bytes[..size]).expect("a state");
        worst = worst.max((back.q[0] - angle).abs());
        let size = state.encode(Version::V5, &mut bytes);
        assert_eq!(
            RobotState::decode(Version::V5, &bytes[..size]).expect("a state").q,
            state.q
        );
    }
    let step = 2.0_f64.powi(-22);
    assert!((step - 2.4e-7).abs() < 1e-8);
    assert!(worst <= step / 2.0, "{worst:e}");
    assert!(worst > step / 8.0, "{worst:e}");
}

// Fails if the rounding of version 10 changes the mean of a noisy recording of 1 s by more than 1e-8 rad.
#[test]
fn a_noisy_recording_averages_the_step_of_version_10_away() {
    let mut seed = 1_u64;
    // Twelve uniform numbers make a nearly normal one.
    let mut normal = || {
        let mut sum = -6.0;
        for _ in 0..12 {
            seed = seed
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            sum += (seed >> 11) as f64 / (1_u64 << 53) as f64;
        }
        sum
    };
    for angle in [0.1, 1.0, 2.9, -3.01] {
        let mut error = 0.0;
        for _ in 0..1000 {
            let mut state = RobotState {
                q: [angle + 1e-5 * normal(); 7],
                ..RobotState::default()
            };
            let exact = state.q[0];
            let mut bytes = [0; MAX_STATE_SIZE];
            let size = state.encode(Version::V10, &mut bytes);
            state = RobotState::decode(Version::V10, &bytes[..size]).expect("a state");
            error += (state.q[0] - exact) / 1000.0;
        }
        assert!(error.abs() < 1e-8, "{angle}: {error:e}");
    }
}
