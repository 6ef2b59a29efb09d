//! Checks of arms whose errors are known to the test alone.

use nalgebra::{Rotation3, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use spherecal_model::chain::TcpPose;
use spherecal_model::{Observation, Set, paper_plate};
use spherecal_shared::robot::{Robot, Tool, built_in};

use super::*;

const START: [f64; 7] = [0.0, -0.3, 0.0, -2.2, 0.0, 1.9, 0.7];

fn tool() -> Tool {
    Tool {
        tcp_m: [0.01, 0.005, 0.22],
        ..Tool::default()
    }
}

/// The arm with joint offsets of `offset` (rad), lengths of `length` (m) and twists of `twist` (rad), at most.
fn wrong(robot: &Robot, [offset, length, twist]: [f64; 3], random: &mut ChaCha8Rng) -> Robot {
    let mut robot = robot.clone();
    for joint in &mut robot.joints {
        let mut draw = |most: f64| random.random_range(-most..=most);
        joint.mdh.theta += draw(offset);
        joint.mdh.a += draw(length);
        joint.mdh.d += draw(length);
        joint.mdh.alpha += draw(twist);
    }
    robot
}

/// What an encoder reads beyond the joint angle, in rad: eccentricity of the size `waves`.
fn encoder(waves: f64, q: f64) -> f64 {
    waves * (q.cos() + 0.5 * (2.0 * q).sin())
}

/// Twelve contacts of the true arm with the plate in one placement, as the encoders read them.
fn contacts(nominal: &Robot, truth: &Robot, waves: f64, random: &mut ChaCha8Rng) -> Experiment {
    let (chain, spheres) = (Chain::unchecked(truth, &tool()), paper_plate());
    let down = chain.pose(&START);
    let mut observations = Vec::new();
    for k in 0..12 {
        let sphere = &spheres[k / 4];
        let q = (0..2000).find_map(|_| {
            let mut draw = |most: f64| random.random_range(-most..=most);
            let rotation = down.rotation * Rotation3::from_euler_angles(draw(0.6), draw(0.6), draw(1.5));
            let elbow = down.elbow.map(|e| e + draw(0.8));
            let position = Vector3::new(0.45, 0.1, 0.2) + Vector3::from(sphere.position_m);
            let q = chain.solve_from(
                &TcpPose {
                    position,
                    rotation,
                    elbow,
                },
                &START,
            )?;
            let reached = (chain.pose(&q).position - position).norm() < 1e-7;
            (reached && chain.limit_margin(&q) > 0.05).then_some(q)
        });
        let mut normal = |sigma: f64| {
            let z: f64 = StandardNormal.sample(random);
            sigma * z
        };
        // 20 um of seating and hand: as much as 25 urad of each joint.
        let q = q
            .expect("a pose")
            .iter()
            .map(|q| q + encoder(waves, *q) + normal(2.5e-5))
            .collect();
        observations.push(Observation {
            seat: None,
            q,
            tau: None,
            target: Target::Sphere {
                sphere: sphere.id,
                place: 0,
            },
            set: Set::Calibrate,
        });
    }
    Experiment {
        robot: nominal.clone(),
        tool: tool(),
        spheres,
        observations,
    }
}

/// Mean distance of the nominal TCP from the true one over the workspace after the best rigid motion, in mm.
fn error_mm(nominal: &Robot, truth: &Robot, waves: f64) -> f64 {
    let tool = tool();
    let (computed, real) = (Chain::unchecked(nominal, &tool), Chain::unchecked(truth, &tool));
    let readings = workspace(nominal, &tool);
    let from: Vec<_> = readings.iter().map(|q| computed.pose(q).position).collect();
    let onto = readings.iter().map(|q| {
        let angles: Vec<f64> = q.iter().map(|q| q - encoder(waves, *q)).collect();
        real.pose(&angles).position
    });
    let onto: Vec<_> = onto.collect();
    let pose = spherecal_model::fit_pose(&from, &onto).expect("a pose");
    let sum: f64 = from.iter().zip(&onto).map(|(f, o)| (pose.point(f) - o).norm()).sum();
    sum / from.len() as f64 * 1e3
}

/// What `check` states of an arm whose errors are at most `size`, with its second joint `moved` (rad) and encoders with
/// `waves` (rad), and the true error, in mm.
fn stated(size: [f64; 3], [moved, waves]: [f64; 2], seed: u64) -> (Checked, f64) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let nominal = built_in("panda").expect("built in");
    let mut truth = wrong(&nominal, size, &mut random);
    truth.joints[1].mdh.theta += moved;
    let found = check(&contacts(&nominal, &truth, waves, &mut random), &Options::default()).expect("a result");
    let real = error_mm(&nominal, &truth, waves);
    println!(
        "{size:?} {seed}: true {real:.3}, stated {:.3} {:.3?}, {:?} {:.2?}, scatter {:.3}",
        found.error_mm.mean, found.error_mm.interval, found.expectation, found.shares, found.scatter_mm
    );
    (found, real)
}

// Fails if the error of an arm that is wrong by 0.4 to 10 mm is not stated within 20 %, or the intervals miss it.
#[test]
#[ignore = "long: 12 arms"]
fn long_the_error_is_stated_within_a_fifth() {
    let mut inside = 0;
    for (size, waves) in [
        ([20e-3, 1e-3, 3e-3], 2e-4),
        ([5e-3, 0.5e-3, 0.5e-3], 2e-4),
        ([1.5e-3, 0.5e-3, 0.5e-3], 1e-4),
        ([0.4e-3, 0.2e-3, 0.2e-3], 0.0),
    ] {
        for seed in 20..23 {
            let (found, real) = stated(size, [0.0, waves], seed);
            let error = found.error_mm;
            let ratio = error.mean / real;
            assert!((0.8..1.2).contains(&ratio), "{real} mm, stated {error:?}");
            inside += usize::from((error.interval[0]..error.interval[1]).contains(&real));
        }
    }
    assert!(inside >= 11, "{inside} of 12 intervals hold the true error");
}

// Fails if a calibration that is right to 0.1 mm is said not to hold within 0.5 mm, or one is said to hold although a joint
// has moved by 3 mrad since.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_calibration_holds_until_a_joint_moves() {
    let calibrated = [0.1e-3, 0.05e-3, 0.05e-3];
    for seed in 30..32 {
        let (found, real) = stated(calibrated, [0.0, 0.0], seed);
        assert!(
            found.error_mm.interval[1] < 0.5 && found.error_mm.interval[1] > real,
            "{found:?}"
        );
        let (found, real) = stated(calibrated, [3e-3, 0.0], seed);
        assert!(real > 0.8 && found.error_mm.interval[0] > 0.5, "{real} mm, {found:?}");
    }
}

// Fails if contacts that leave nothing over beside the plate's position get an answer.
#[test]
fn seven_contacts_are_too_few() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let nominal = built_in("panda").expect("built in");
    let mut experiment = contacts(&nominal, &nominal, 0.0, &mut random);
    experiment.observations.truncate(7);
    assert_eq!(
        check(&experiment, &Options::default()).err(),
        Some(IdentifyError::TooFewObservations { found: 7, needed: 8 })
    );
}
