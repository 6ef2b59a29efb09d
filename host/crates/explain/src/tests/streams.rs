//! Arms that were recorded while they moved.

use super::*;

/// Rows of an arm that moves by up to 0.4 rad/s, recorded 20 times a second, with measurements that are `late_s` late.
fn stream(model: &RobotModel, seed: u64, late_s: f64) -> Vec<Observation> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let real = Real::new(model, &mut rng);
    let joints = &model.robot.joints;
    let waves: Vec<[f64; 3]> = joints
        .iter()
        .map(|_| [rng.random(), rng.random(), rng.random()])
        .collect();
    let at = |time: f64| -> Vec<f64> {
        let one = |(joint, wave): (&spherecal_shared::robot::Joint, &[f64; 3])| {
            let l = joint.limits;
            let middle = 0.5 * (l.min_rad.max(-2.2) + l.max_rad.min(2.2));
            middle + (0.3 + 0.5 * wave[0]) * ((0.15 + 0.35 * wave[1]) * time + 6.0 * wave[2]).sin()
        };
        joints.iter().zip(&waves).map(one).collect()
    };
    let mut row = |k: i32| {
        let time = 0.05 * f64::from(k);
        real.row(&at(time), &at(time - late_s), false, &mut rng)
    };
    (0..1000).map(&mut row).collect()
}

// Fails if the delay of measurements of a moving arm (30 ms late or 80 ms early, rows of 50 ms) is not found to 2.5 ms without
// a search, if its option does not put the table right, or if one is found in a stream without a delay.
#[test]
fn the_delay_of_a_stream_is_named() {
    for (k, model) in arms().iter().enumerate() {
        for late_s in [0.03, -0.08, 0.0] {
            let rows = stream(model, 70 + k as u64, late_s);
            let mut model = model.clone();
            model.tool.tcp_m = TOOL;
            let found = crate::look(&Subject::new(&model, &rows, &[]));
            let said = format!("{}, {late_s} s: {:?}", model.robot.name, found.sentences());
            if late_s == 0.0 {
                assert!(found.found.is_empty(), "{said}");
                continue;
            }
            let [delay] = found.found.as_slice() else {
                panic!("{said}")
            };
            assert!((delay.adjust.shift - late_s / 0.05).abs() < 0.05, "{said}");
            assert!(delay.score_m < 2.5e-4, "{said}");
            assert!(
                said.contains("--shift-rows") && said.contains("moved while it was measured"),
                "{said}"
            );
        }
    }
}
