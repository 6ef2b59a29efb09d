//! Several targets on the tool and measured poses, on arms that are drawn here: geometry, compliance by a gravity of this
//! file's own, one joint deviation for all targets of a row, and each target's own noise.

mod drawn;
mod judged;

use drawn::{Drawn, Noise, POINTS, beyond_two_sigmas, tcp_error_mm};
use spherecal_identify::{Calibration, Experiment, IdentifyError, Method, Options, Target, identify};

fn fitted(experiment: &Experiment) -> Calibration {
    identify(experiment, &Options::default()).expect("sound data")
}

/// The same rows with only their first target.
fn first_only(experiment: &Experiment) -> Experiment {
    let mut one = experiment.clone();
    for o in &mut one.observations {
        o.target = match &o.target {
            Target::Points(p) => Target::Point(p[0].expect("seen")),
            Target::Frame(pose) => Target::Point(pose.position.into()),
            other => other.clone(),
        };
    }
    one
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

// Fails if three targets do not predict the TCP of new poses better than one on the mean of six arms, if more than a
// tenth of the stated sigmas of geometry and targets is exceeded twofold, or if the noise of a target is off by a third.
#[test]
fn three_targets_are_better_than_one() {
    let (mut one, mut three) = (Vec::new(), Vec::new());
    let (mut beyond, mut all) = (0.0, 0.0);
    for seed in 1..=6 {
        let mut drawn = Drawn::new(seed);
        let experiment = drawn.points(60, &[Noise::of(0.05); 3]);
        let single = fitted(&first_only(&experiment));
        let found = fitted(&experiment);
        one.push(tcp_error_mm(&drawn, &single));
        three.push(tcp_error_mm(&drawn, &found));
        let (more, of) = beyond_two_sigmas(&drawn, &found);
        beyond += more;
        all += of;
        assert_eq!(found.targets.len(), 3);
        for (k, target) in found.targets.iter().enumerate() {
            assert_eq!((target.number, target.rows), (k + 1, 60));
            assert!((target.noise_mm / 0.05).ln().abs() < 0.29, "seed {seed}: {target:?}");
        }
    }
    println!(
        "TCP error of new poses: one target {:.4} mm, three {:.4} mm",
        mean(&one),
        mean(&three)
    );
    println!("beyond two sigmas: {beyond} of {all}");
    assert!(mean(&three) < 0.9 * mean(&one), "{one:?} {three:?}");
    assert!(beyond < 0.1 * all, "{beyond} of {all}");
}

// Fails if a tool that no joint turns spoils three targets that are measured well: on the mean of six arms they must predict the TCP of
// new poses better than the first one alone (0.09 mm; 0.27 mm where the joints had to make the turns), and their noise must be that of
// the instrument to a half.
#[test]
fn a_tool_that_turns_spoils_no_targets() {
    let (mut one, mut three) = (Vec::new(), Vec::new());
    for seed in 51..=56 {
        let mut drawn = Drawn::new(seed);
        let experiment = drawn.turning(60, Noise::of(0.005), 1.0);
        let found = fitted(&experiment);
        one.push(tcp_error_mm(&drawn, &fitted(&first_only(&experiment))));
        three.push(tcp_error_mm(&drawn, &found));
        for target in &found.targets {
            assert!((target.noise_mm / 0.005).ln().abs() < 0.4, "seed {seed}: {target:?}");
        }
    }
    println!("one target {:.4} mm, three {:.4} mm", mean(&one), mean(&three));
    assert!(mean(&three) < mean(&one), "{one:?} {three:?}");
}

// Fails if a table with one numbered target gives other bits than one with a plain point.
#[test]
fn one_target_is_a_point_to_the_last_bit() {
    let experiment = Drawn::new(2).points(40, &[Noise::of(0.05)]);
    let (several, point) = (fitted(&experiment), fitted(&first_only(&experiment)));
    let bits = |c: &Calibration| -> Vec<u64> {
        let own = c
            .parameters
            .iter()
            .flat_map(|p| [p.estimate.to_bits(), p.sigma.to_bits()]);
        own.chain([c.log_evidence.to_bits(), c.noise.joint_rad.to_bits()])
            .collect()
    };
    assert_eq!(bits(&several), bits(&point));
    assert!(several.targets.is_empty() && point.targets.is_empty());
}

// Fails if rows without one of the targets (the TCP too) cannot be used, or are worse than leaving them out.
#[test]
fn targets_may_be_hidden() {
    let (mut hidden, mut without) = (Vec::new(), Vec::new());
    for seed in 11..=14 {
        let mut drawn = Drawn::new(seed);
        let mut experiment = drawn.points(60, &[Noise::of(0.05); 3]);
        for (k, o) in experiment.observations.iter_mut().enumerate() {
            if let Target::Points(points) = &mut o.target
                && k % 2 == 1
            {
                points[k / 2 % 3] = None;
            }
        }
        let found = fitted(&experiment);
        assert_eq!(found.targets.iter().map(|t| t.rows).collect::<Vec<_>>(), [50; 3]);
        hidden.push(tcp_error_mm(&drawn, &found));
        let mut k = 0;
        experiment.observations.retain(|_| {
            k += 1;
            k % 2 == 1
        });
        without.push(tcp_error_mm(&drawn, &fitted(&experiment)));
    }
    assert!(mean(&hidden) < mean(&without), "{hidden:?} {without:?}");
}

// Fails if a target with five times the others' noise is not found out: each noise within 30 %.
#[test]
fn the_noise_of_each_target_is_found() {
    for (seed, noisy) in [(21, 1), (22, 0), (23, 2)] {
        let mut noise = [Noise::of(0.04); 3];
        noise[noisy] = Noise::of(0.2);
        let found = fitted(&Drawn::new(seed).points(60, &noise));
        for (target, noise) in found.targets.iter().zip(&noise) {
            let ratio = target.noise_mm / noise.mm;
            assert!((0.7..1.3).contains(&ratio), "seed {seed}: {target:?}");
        }
    }
}

// Fails if the orientations of a camera (0.5 mm, 2 mrad) do not make its positions better on the mean of twelve arms, or if
// a noise is off by 30 %.
#[test]
fn poses_are_better_than_positions() {
    let (mut position, mut pose) = (Vec::new(), Vec::new());
    for seed in 31..=42 {
        let mut drawn = Drawn::new(seed);
        let experiment = drawn.poses(60, 0.5, 2.0);
        let found = fitted(&experiment);
        position.push(tcp_error_mm(&drawn, &fitted(&first_only(&experiment))));
        pose.push(tcp_error_mm(&drawn, &found));
        let (point, turn) = (
            found.targets[0].noise_mm,
            found.orientation.expect("has one").noise_mrad,
        );
        assert!((0.7..1.3).contains(&(point / 0.5)), "seed {seed}: {point} mm");
        assert!((0.7..1.3).contains(&(turn / 2.0)), "seed {seed}: {turn} mrad");
    }
    println!(
        "TCP error: positions {:.4} mm, poses {:.4} mm",
        mean(&position),
        mean(&pose)
    );
    assert!(mean(&pose) < 0.97 * mean(&position), "{position:?} {pose:?}");
}

// Fails if the places of the targets, of which nothing was said, are not found to three sigmas or a millimetre.
#[test]
fn targets_are_placed_on_the_tool() {
    let found = fitted(&Drawn::new(41).points(60, &[Noise::of(0.05); 3]));
    for (target, place) in found.targets.iter().zip(POINTS) {
        for axis in 0..3 {
            assert!((target.place_m[axis] - place[axis]).abs() < 1e-3, "{target:?}");
        }
    }
    let names: Vec<_> = found.parameters.iter().map(|p| p.name.as_str()).collect();
    assert!(
        names.contains(&"target2_x") && names.contains(&"target3_z"),
        "{names:?}"
    );
}

// Fails if two targets at one place are refused or confused.
#[test]
fn targets_may_coincide() {
    let mut drawn = Drawn::new(42);
    let mut experiment = drawn.points(40, &[Noise::of(0.05); 3]);
    for o in &mut experiment.observations {
        if let Target::Points(points) = &mut o.target {
            points[2] = points[1].map(|p| p.map(|x| x + 1e-6));
        }
    }
    let found = fitted(&experiment);
    assert!(tcp_error_mm(&drawn, &found) < 0.4);
}

// Fails if a target that hardly any row saw, or a method that takes points only, is not refused by name.
#[test]
fn what_cannot_be_used_is_refused() {
    let mut experiment = Drawn::new(43).points(30, &[Noise::of(0.05); 3]);
    let paper = Options {
        method: Method::Lm,
        ..Options::default()
    };
    let refused = identify(&experiment, &paper).unwrap_err();
    assert!(matches!(refused, IdentifyError::Method { .. }) && refused.to_string().contains("full or geometry"));
    for o in experiment.observations.iter_mut().skip(2) {
        if let Target::Points(points) = &mut o.target {
            points[2] = None;
        }
    }
    let refused = identify(&experiment, &Options::default()).unwrap_err();
    let words = refused.to_string();
    assert!(
        words.contains("target 3 is in 2 rows") && words.contains("--ignore-columns"),
        "{words}"
    );
    for o in &mut experiment.observations {
        if let Target::Points(points) = &mut o.target {
            points[0] = None;
        }
    }
    let words = identify(&experiment, &Options::default()).unwrap_err().to_string();
    assert!(words.contains("target 1 is in 0 rows"), "{words}");
}

// Fails if a camera's noise along its line of sight, ten times that across it, is not found within 30 %, if more than a tenth of
// the stated sigmas is exceeded twofold, or if such depths make the arm worse than half of what the same noise in all
// directions makes it.
#[test]
fn a_cameras_depth_has_a_noise_of_its_own() {
    let (mut depth, mut alike) = (Vec::new(), Vec::new());
    let (mut beyond, mut all) = (0.0, 0.0);
    for seed in 51..=58 {
        let mut drawn = Drawn::new(seed);
        let found = fitted(&drawn.seen_poses(60, 0.3, 3.0, 2.0));
        let (more, of) = beyond_two_sigmas(&drawn, &found);
        beyond += more;
        all += of;
        depth.push(tcp_error_mm(&drawn, &found));
        let target = found.targets[0];
        assert!((0.7..1.3).contains(&(target.noise_mm / 0.3)), "seed {seed}: {target:?}");
        let along = target.depth_noise_mm.expect("has one");
        assert!((0.7..1.3).contains(&(along / 3.0)), "seed {seed}: {target:?}");
        let found = fitted(&drawn.poses(60, 3.0, 2.0));
        alike.push(tcp_error_mm(&drawn, &found));
    }
    println!(
        "TCP error: depth {:.4} mm, alike {:.4} mm; beyond two sigmas: {beyond} of {all}",
        mean(&depth),
        mean(&alike)
    );
    assert!(beyond < 0.1 * all, "{beyond} of {all}");
    assert!(mean(&depth) < 0.5 * mean(&alike), "{depth:?} {alike:?}");
}
