use nalgebra::{Matrix3, Rotation3, Vector3};
use proptest::prelude::*;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};

use super::learn::{CENTRES, MapSample};
use super::*;
use crate::{Experiment, Observation, Options, Set, Target, halton_configurations, identify};
use spherecal_model::chain::Chain;
use spherecal_shared::robot::{iiwa7, iiwa7_tool};

fn vector(random: &mut ChaCha8Rng, sigma: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| {
        let z: f64 = StandardNormal.sample(random);
        sigma * z
    })
}

fn turn(random: &mut ChaCha8Rng, sigma: f64) -> Matrix3<f64> {
    Rotation3::new(vector(random, sigma)).into_inner()
}

/// What the tool's orientation does: a displacement in the tool's axes, in m.
fn sag(rotation: &Matrix3<f64>) -> Vector3<f64> {
    let u = rotation.row(2).transpose();
    Vector3::new(2.0 * u.x * u.z, u.y + u.x * u.x, u.y * u.z - u.x) * 1.5e-4
}

/// Residuals of tools that are turned by about `spread` (rad) and sag, with noise.
fn sagging(seed: u64, count: usize, spread: f64, noise_m: f64) -> Samples {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let sample = |_| {
        let rotation = turn(&mut random, spread);
        MapSample {
            rotation,
            q: vector(&mut random, 1.0).as_slice().to_vec(),
            residual: vector(&mut random, noise_m) - rotation * sag(&rotation),
            noise: 1.0,
        }
    };
    Samples((0..count).map(sample).collect())
}

proptest! {
    // Fails if the correction anywhere is longer than the bound, if its uncertainty is more than that of no
    // data at all, or if one of them is no number.
    #[test]
    fn the_map_is_bounded(seed in 0..20_u64, x in -9.0..9.0_f64, y in -9.0..9.0_f64, z in -9.0..9.0_f64) {
        let map = learn(MapInput::Orientation, &sagging(seed, 40, 0.4, 1e-5)).unwrap();
        let rotation = Rotation3::new(Vector3::new(x, y, z)).into_inner();
        let found = map.at(&rotation, &[]);
        prop_assert!(found.shift_m.norm() <= map.data().bound_m * (1.0 + 1e-12));
        prop_assert!((0.0..=map.data().amplitude_m).contains(&found.sigma_m));
    }
}

// Fails if a map corrects where it has no data, or says there that it knows.
#[test]
fn far_from_its_centres_the_map_corrects_nothing() {
    let mut samples = sagging(1, 150, 1.0, 2e-5);
    for sample in &mut samples.0 {
        let q = &sample.q;
        sample.residual = Vector3::new(q[0].sin(), q[1].sin(), q[2].cos()) * 1e-4;
    }
    let map = learn(MapInput::Joints, &samples).unwrap();
    let near = map.at(&Matrix3::identity(), &[0.5, 0.1, 0.1]);
    assert!(near.shift_m.norm() > 5e-5, "{near:?}");
    let far = map.at(&Matrix3::identity(), &[60.0, 60.0, 60.0]);
    assert!(far.shift_m.norm() < 1e-12, "{far:?}");
    assert!((far.sigma_m / map.data().amplitude_m - 1.0).abs() < 1e-9, "{far:?}");
}

// Fails if the map does not find a displacement in the tool's axes, or if its uncertainty does not hold the error that
// it leaves: 68 % of a normal variable lie within one sigma, and 95 % within two.
#[test]
fn the_uncertainty_covers_what_the_map_leaves() {
    let (mut one, mut two, mut left, mut count) = (0, 0, 0.0, 0);
    for seed in 0..8 {
        let map = learn(MapInput::Orientation, &sagging(seed, 120, 1.0, 4e-5)).unwrap();
        assert_eq!(map.data().frame, MapFrame::Tool);
        let mut random = ChaCha8Rng::seed_from_u64(100 + seed);
        for _ in 0..200 {
            let rotation = turn(&mut random, 1.0);
            let found = map.at(&rotation, &[]);
            for error in (found.shift_m - rotation * sag(&rotation)).iter() {
                one += usize::from(error.abs() < found.sigma_m);
                two += usize::from(error.abs() < 2.0 * found.sigma_m);
                left += error.powi(2);
                count += 1;
            }
        }
    }
    let share = |n: usize| n as f64 / f64::from(count);
    assert!((left / f64::from(count)).sqrt() < 4e-5, "{left} {count}");
    assert!(
        (0.6..0.95).contains(&share(one)) && share(two) > 0.9,
        "{} {}",
        share(one),
        share(two)
    );
}

// Fails if white residuals give a map often: 200 samples of 20 robots, over each input.
#[test]
fn white_residuals_give_no_map() {
    let white = |seed| {
        let mut samples = sagging(seed, 200, 1.0, 0.0);
        let mut random = ChaCha8Rng::seed_from_u64(7 * seed + 1);
        samples
            .0
            .iter_mut()
            .for_each(|s| s.residual = vector(&mut random, 5e-5));
        samples
    };
    let found = (0..20)
        .map(white)
        .map(|s| MapInput::ALL.map(|input| learn(input, &s).is_some()));
    let count = found.flatten().filter(|some| *some).count();
    assert!(count <= 1, "{count} of 40");
}

// Fails if a map that was written and read again corrects otherwise, in the last bit.
#[test]
fn a_map_survives_json() {
    let map = learn(MapInput::Orientation, &sagging(3, 60, 1.0, 3e-5)).unwrap();
    let text = serde_json::to_string(&map).unwrap();
    let again: ResidualMap = serde_json::from_str(&text).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(5);
    for _ in 0..50 {
        let rotation = turn(&mut random, 2.0);
        assert_eq!(map.at(&rotation, &[]), again.at(&rotation, &[]));
    }
}

// Fails if numbers that are no map are taken for one.
#[test]
fn numbers_that_are_no_map_are_refused() {
    let good = learn(MapInput::Orientation, &sagging(2, 40, 1.0, 1e-5)).unwrap();
    let with = |change: &dyn Fn(&mut MapData)| {
        let mut data = good.data().clone();
        change(&mut data);
        ResidualMap::try_from(data).unwrap_err()
    };
    assert!(matches!(
        with(&|d| d.length = 0.0),
        MapError::Number { field: "length", .. }
    ));
    assert!(matches!(
        with(&|d| d.bound_m = f64::NAN),
        MapError::Number { field: "bound_m", .. }
    ));
    assert!(matches!(
        with(&|d| d.centres[3].at[0] = f64::NAN),
        MapError::Number { .. }
    ));
    assert!(matches!(
        with(&|d| d.centres[3].at.truncate(2)),
        MapError::Centre {
            index: 3,
            found: 2,
            expected: 9
        }
    ));
    assert!(matches!(with(&|d| d.centres.clear()), MapError::Count { found: 0 }));
    assert!(matches!(
        with(&|d| d.centres = vec![d.centres[0].clone(); MOST_CENTRES + 1]),
        MapError::Count { .. }
    ));
}

// Fails if a map of 600 rows has more centres than its cost allows (the time of a fit grows with their cube, times
// 36 pairs of length and amplitude), if a row that is an outlier teaches it, or if the residual of a calibration enters with the wrong sign or in the wrong axes: the
// corrected TCP must be nearer to the truth.
#[test]
fn a_map_of_a_calibration_brings_its_tcp_nearer() {
    let (robot, tool) = (iiwa7(), iiwa7_tool());
    let chain = Chain::unchecked(&robot, &tool);
    // The tracker stands anywhere.
    let stand = Rotation3::new(Vector3::new(0.2, -0.4, 1.9));
    let truth = |q: &[f64]| {
        let pose = chain.pose(q);
        let rotation = *pose.rotation.matrix();
        pose.position + rotation * sag(&rotation)
    };
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let configurations = halton_configurations(&robot, 700);
    let (seen, judging) = configurations.split_at(600);
    let observations = seen.iter().enumerate().map(|(k, q)| {
        let gross = if k % 50 == 7 { 5e-3 } else { 0.0 };
        let off = vector(&mut random, 2e-5) + vector(&mut random, 1.0).normalize() * gross;
        Observation {
            seat: None,
            q: q.clone(),
            tau: None,
            target: Target::Point((stand * truth(q) + off + Vector3::new(2.0, -1.0, 0.5)).into()),
            set: Set::Calibrate,
        }
    });
    let experiment = Experiment {
        observations: observations.collect(),
        robot,
        tool,
        spheres: Vec::new(),
    };
    let calibration = identify(&experiment, &Options::default()).unwrap();
    let samples = Samples::of(&calibration, &experiment);
    assert!(samples.0.iter().all(|s| s.residual.norm() < 3e-3));
    let map = learn(MapInput::Orientation, &samples).unwrap();
    assert!(map.data().centres.len() <= CENTRES);
    let error_mm = |tcp: &dyn Fn(&[f64]) -> Vector3<f64>| {
        let own: Vec<_> = judging.iter().map(|q| tcp(q)).collect();
        let truth: Vec<_> = judging.iter().map(|q| truth(q)).collect();
        let base = spherecal_model::fit_pose(&own, &truth).unwrap();
        let lengths = own.iter().zip(&truth).map(|(a, b)| (base.point(a) - b).norm());
        1e3 * lengths.sum::<f64>() / judging.len() as f64
    };
    let without = error_mm(&|q| calibration.tcp_m(q, None));
    let with = error_mm(&|q| map.corrected_m(&calibration, q, None));
    assert!(with < 0.6 * without, "{with} mm with the map, {without} mm without");
    let q = &judging[0];
    let correction = map.correction(&calibration, q);
    let off = map.corrected_m(&calibration, q, None) - calibration.tcp_m(q, None) - correction.shift_m;
    assert!(off.norm() < 1e-15);
}
