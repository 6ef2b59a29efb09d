//! The estimators against experiments and results made outside this project
//! (`world_*.json`, an independent NumPy implementation).

use nalgebra::{Matrix3, Vector3};
use spherecal::identify::{Calibration, DistanceProblem, Method, Options, Pairs, Pose, identify};
use spherecal_tests::worlds::World;

const WORLDS: [&str; 4] = ["world_W1_seed0", "world_W1_seed1", "world_W4_seed0", "world_W4_seed1"];

/// Mean errors with the measured and with the best base that were found, and 3 %, in mm.
const MOST_MM: [[f64; 2]; 4] = [[0.285, 0.137], [0.198, 0.184], [0.264, 0.251], [0.259, 0.214]];

/// Fails if the default estimator is worse than it was on the four experiments. The stored structured one, whose priors were
/// chosen on such experiments, has 0.153, 0.227, 0.230 and 0.257 mm with the measured base: better on two of them. The links of
/// these four arms do not bend. That the prior expects bending costs 3 % here in the mean, and gains 1.8 % on real tables.
#[test]
fn the_default_estimator_is_as_good_as_it_was() {
    let mut beyond = Vec::new();
    for (name, most) in WORLDS.into_iter().zip(MOST_MM) {
        let world = World::load(name);
        let c = identify(&world.spheres(), &Options::default()).expect("good data");
        let found = world.validate(|q| c.tcp_m(q, None)).map(|errors| errors.mean);
        println!("{name}: {found:.3?} mm");
        beyond.extend((found[0] >= most[0] || found[1] >= most[1]).then_some(name));
    }
    assert!(beyond.is_empty(), "{beyond:?}");
}

/// Largest difference of the calibrated table from a stored one, mm and rad alike.
fn table_difference(c: &Calibration, p: &[f64]) -> f64 {
    let rows = c.robot.joints.iter().zip(p.chunks(4));
    rows.flat_map(|(joint, row)| {
        let m = joint.mdh;
        [
            m.alpha - row[0],
            m.a * 1e3 - row[1],
            m.theta - row[2],
            m.d * 1e3 - row[3],
        ]
    })
    .fold(0.0, |largest, d| f64::max(largest, d.abs()))
}

fn close(found: &[f64; 4], stored: &[f64]) -> bool {
    found.iter().zip(stored).all(|(a, b)| (a - b).abs() < 1e-4)
}

/// Fails if residuals, Jacobian or the choice of 21 parameters differ from the
/// reference's, for contacts or for laser points, or if such a fit cannot state the error of a position.
#[test]
fn gauss_newton_and_laser_reproduce_the_stored_figures() {
    for name in WORLDS {
        let world = World::load(name);
        for method in [Method::GaussNewton, Method::Lm] {
            let mut spheres = world.spheres();
            spheres.tool = world.measured_tool();
            let options = Options {
                method,
                subset: Some(world.subset300.clone()),
                ..Options::default()
            };
            let c = identify(&spheres, &options).expect("good data");
            let stored = &world.expected["sphere_GN_pairs_norm21"];
            assert!(table_difference(&c, &stored.p) < 1e-4, "{name} {method}");
            assert!(c.tcp_covariance(&[0.1; 7]).trace() > 0.0, "{name} {method}");
            let [v1, v2] = world.validate(|q| c.tcp_m(q, None));
            assert!(
                close(&v1.array(), &stored.v[..4]) && close(&v2.array(), &stored.v[4..8]),
                "{name} {method}"
            );

            let mut laser = world.laser();
            laser.tool = world.measured_tool();
            let options = Options {
                method,
                base: Some(world.base()),
                ..Options::default()
            };
            let c = identify(&laser, &options).expect("good data");
            let stored = &world.expected["laser_GN21"];
            assert!(table_difference(&c, &stored.p) < 1e-4, "{name} {method}");
            let [v1, v2] = world.validate(|q| c.tcp_m(q, None));
            assert!(
                close(&v1.array(), &stored.v[..4]) && close(&v2.array(), &stored.v[4..8]),
                "{name} {method}"
            );
        }
    }
}

/// Fails if the vector objective is not the sum over all pairs of Equation 11, or
/// not the stored value at the stored simplex's parameters.
#[test]
fn collapsed_objective_is_the_sum_over_pairs() {
    let world = World::load("world_W1_seed0");
    let mut spheres = world.spheres();
    spheres.tool = world.measured_tool();
    let rotation = Matrix3::from_fn(|r, c| world.nominal_rotation[r][c]);
    let options = Options {
        method: Method::GaussNewton,
        pairs: Pairs::Vector,
        subset: Some(world.subset300.clone()),
        base: Some(Pose {
            rotation,
            position: Vector3::zeros(),
        }),
        ..Options::default()
    };
    let problem = DistanceProblem::new(&spheres, &options).expect("good data");
    assert_eq!(
        (problem.poses(), problem.pairs(), problem.names().len()),
        (300, 44_850, 21)
    );
    let stored = &world.expected["sphere_NM_vec_120fev"];
    let all: Vec<_> = (0..300).flat_map(|i| (i + 1..300).map(move |j| (i, j))).collect();
    let (collapsed, summed) = (problem.objective_mm2(&stored.x), problem.batch_mm2(&stored.x, &all));
    assert!((collapsed / summed - 1.0).abs() < 1e-9, "{collapsed} {summed}");
    assert!((collapsed / stored.f - 1.0).abs() < 1e-6, "{collapsed} {}", stored.f);
}
