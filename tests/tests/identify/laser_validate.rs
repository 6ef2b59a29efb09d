//! The laser path and the validation table: against Tables 3 and 4 of the
//! paper, exact geometry, and the stored figures of the synthetic worlds.

use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use spherecal::identify::Pose;
use spherecal::identify::arcs::{Measured, MeasuredArc, frames_from_arcs, split_arcs};
use spherecal::identify::validate::{Alignment, ErrorStatistics, Prediction, validate};
use spherecal::plan::laser::{Arc, Spread, TABLE_3, TABLE_4, plan};
use spherecal_shared::robot::{Arm, Robot, Tool, iiwa7, iiwa7_tool};

fn tcps(robot: &Robot, tool: &Tool, configurations: &[Vec<f64>]) -> Vec<Vector3<f64>> {
    let arm = Arm::<f64, 7>::new(robot, tool).expect("a good robot");
    configurations
        .iter()
        .map(|q| {
            let q: [f64; 7] = q.as_slice().try_into().expect("seven joints");
            arm.tcp_frame(&arm.frames(&q)).position
        })
        .collect()
}

// Fails if the sets are not spread as Tables 3 and 4, leave the limits, repeat
// each other, or differ between runs of one seed.
#[test]
fn configurations_are_spread_as_tables_3_and_4() {
    let (robot, tool) = (iiwa7(), iiwa7_tool());
    for seed in 0..5 {
        let made = plan(&robot, &tool, seed).expect("reachable");
        assert_eq!(made, plan(&robot, &tool, seed).expect("reachable"));
        assert_eq!((made.calibration.len(), made.validation.len()), (284, 125));
        for (configurations, table) in [(&made.calibration, TABLE_3), (&made.validation, TABLE_4)] {
            let spread = Spread::of(&tcps(&robot, &tool, configurations));
            for k in 0..3 {
                assert!((spread.mean_m[k] - table.mean_m[k]).abs() < 0.005, "{spread:?}");
                assert!((spread.std_m[k] / table.std_m[k] - 1.0).abs() < 0.02, "{spread:?}");
                assert!(spread.min_m[k] >= table.min_m[k] && spread.max_m[k] <= table.max_m[k]);
                let across = spread.max_m[k] - spread.min_m[k];
                assert!(across > 0.8 * (table.max_m[k] - table.min_m[k]), "{spread:?}");
            }
            for q in configurations {
                for (q, joint) in q.iter().zip(&robot.joints) {
                    assert!(q.abs() < 0.951 * joint.limits.max_rad);
                }
            }
        }
        assert!(made.validation.iter().all(|q| !made.calibration.contains(q)));
        let points = |arcs: &[Arc]| arcs.iter().map(|a| a.configurations.len()).sum::<usize>();
        assert_eq!((points(&made.base_arcs), points(&made.tool_arcs)), (150, 153));
        for arc in made.base_arcs.iter().chain(&made.tool_arcs) {
            let turn =
                arc.configurations[arc.configurations.len() - 1][arc.joint - 1] - arc.configurations[0][arc.joint - 1];
            assert!(turn > 1.5, "joint {} turns only {turn} rad", arc.joint);
        }
    }
}

fn measure(
    robot: &Robot,
    tool: &Tool,
    pose: &Pose,
    arcs: &[Arc],
    noise_m: f64,
    rng: &mut ChaCha8Rng,
) -> Vec<MeasuredArc> {
    let noise = Normal::new(0.0, noise_m).expect("finite");
    arcs.iter()
        .map(|arc| {
            let points = tcps(robot, tool, &arc.configurations);
            let measured = arc.configurations.iter().zip(points).map(|(q, p)| {
                let seen = pose.point(&p) + Vector3::from_fn(|_, _| noise.sample(rng));
                Measured {
                    q: q.clone(),
                    point_m: seen.into(),
                }
            });
            MeasuredArc {
                joint: arc.joint,
                measured: measured.collect(),
            }
        })
        .collect()
}

// Fails if exact arcs of the nominal robot do not give back base and tool, or
// if noise moves them by more, or less, than the stated sigmas say.
#[test]
fn arcs_give_base_and_tool_with_honest_sigmas() {
    let robot = iiwa7();
    let mut tool = iiwa7_tool();
    let made = plan(&robot, &tool, 3).expect("reachable");
    tool.tcp_m = [0.0513, -0.0021, 0.0987];
    let pose = Pose {
        rotation: *Rotation3::new(Vector3::new(0.3, -0.2, 2.0)).matrix(),
        position: Vector3::new(2.0, -1.0, 0.3),
    };
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let exact = frames_from_arcs(
        &robot,
        &measure(&robot, &tool, &pose, &made.base_arcs, 0.0, &mut rng),
        &measure(&robot, &tool, &pose, &made.tool_arcs, 0.0, &mut rng),
    )
    .expect("good arcs");
    assert!((exact.base.rotation - pose.rotation).norm() + (exact.base.position - pose.position).norm() < 1e-9);
    assert!((Vector3::from(exact.tool_m) - Vector3::from(tool.tcp_m)).norm() < 1e-9);

    let runs = 60;
    let mut chi_square = [0.0; 9];
    for _ in 0..runs {
        let found = frames_from_arcs(
            &robot,
            &measure(&robot, &tool, &pose, &made.base_arcs, 25e-6, &mut rng),
            &measure(&robot, &tool, &pose, &made.tool_arcs, 25e-6, &mut rng),
        )
        .expect("good arcs");
        let shift = found.base.position - pose.position;
        let turn = Rotation3::from_matrix_unchecked(found.base.rotation * pose.rotation.transpose()).scaled_axis();
        for k in 0..3 {
            chi_square[k] += (shift[k] / found.base_sigma_m[k]).powi(2) / f64::from(runs);
            chi_square[k + 3] += (turn[k] / found.base_sigma_rad[k]).powi(2) / f64::from(runs);
            chi_square[k + 6] += ((found.tool_m[k] - tool.tcp_m[k]) / found.tool_sigma_m[k]).powi(2) / f64::from(runs);
            assert!(
                found.base_sigma_m[k] < 60e-6 && found.tool_sigma_m[k] < 100e-6,
                "{found:?}"
            );
        }
    }
    assert!(chi_square.iter().all(|c| c.is_finite()));
    for (k, c) in chi_square.into_iter().enumerate() {
        assert!((0.5..1.8).contains(&c), "component {k}: mean square over sigma {c}");
    }
}

// Fails if a flat list of measurements is not cut where another joint starts to turn.
#[test]
fn flat_measurements_are_cut_into_arcs() {
    let (robot, tool) = (iiwa7(), iiwa7_tool());
    let made = plan(&robot, &tool, 1).expect("reachable");
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let arcs = measure(&robot, &tool, &Pose::default(), &made.tool_arcs, 1e-5, &mut rng);
    let flat: Vec<Measured> = arcs.iter().flat_map(|a| a.measured.clone()).collect();
    assert_eq!(split_arcs(&flat), arcs);
}

#[derive(serde::Deserialize)]
struct World {
    tool_measured: [f64; 3],
    #[serde(rename = "base_R_measured")]
    base_r: [[f64; 3]; 3],
    base_t_measured: [f64; 3],
    valid_q: Vec<[f64; 7]>,
    valid_p: Vec<[f64; 3]>,
    expected: std::collections::BTreeMap<String, serde_json::Value>,
}

// Fails if statistics, best fit or arc alignment differ from those that NumPy
// computed for the same models.
#[test]
fn validation_agrees_with_the_stored_worlds() {
    for name in [
        "world_W1_seed0.json",
        "world_W1_seed1.json",
        "world_W4_seed0.json",
        "world_W4_seed1.json",
    ] {
        let world: World = spherecal_tests::data(name);
        let metres = |p: &[f64; 3]| p.map(|x| x * 1e-3);
        let base_r = Matrix3::from_fn(|i, j| world.base_r[i][j]);
        let base = Pose {
            rotation: base_r,
            position: Vector3::from(metres(&world.base_t_measured)),
        };
        let measured: Vec<_> = world.valid_p.iter().map(metres).collect();
        let configurations: Vec<Vec<f64>> = world.valid_q.iter().map(|q| q.to_vec()).collect();
        let mut tool = iiwa7_tool();
        tool.tcp_m = metres(&world.tool_measured);
        for model in ["nominal", "laser_GN21", "sphere_GN_pairs_norm21"] {
            let mut robot = iiwa7();
            if let Some(table) = world.expected[model].get("p") {
                let p: Vec<f64> = serde_json::from_value(table.clone()).expect("numbers");
                for (joint, row) in robot.joints.iter_mut().zip(p.chunks(4)) {
                    joint.mdh.alpha = row[0];
                    joint.mdh.a = row[1] * 1e-3;
                    joint.mdh.theta = row[2];
                    joint.mdh.d = row[3] * 1e-3;
                }
            }
            let points_m = tcps(&robot, &tool, &configurations)
                .into_iter()
                .map(Into::into)
                .collect();
            let table = validate(
                &measured,
                &base,
                &[Prediction {
                    name: model.into(),
                    points_m,
                    own_base: None,
                }],
            )
            .expect("good data");
            let expected: Vec<f64> = serde_json::from_value(world.expected[model]["V"].clone()).expect("numbers");
            for (alignment, v) in Alignment::ALL.into_iter().zip(expected.chunks(4)) {
                let s: &ErrorStatistics = table.model(model).expect("given").statistics(alignment);
                for (ours, theirs) in [s.mean_mm, s.std_mm, s.min_mm, s.max_mm].into_iter().zip(v) {
                    assert!(
                        (ours - theirs).abs() < 1e-8,
                        "{name} {model} {alignment:?}: {ours} against {theirs}"
                    );
                }
            }
            assert!(table.to_string().contains(model));
        }
    }
}

#[test]
fn unusable_predictions_are_refused() {
    let base = Pose::default();
    let model = |points_m| Prediction {
        name: "m".into(),
        points_m,
        own_base: None,
    };
    assert!(validate(&[], &base, &[]).is_err());
    assert!(validate(&[[0.0; 3]], &base, &[model(vec![])]).is_err());
    assert!(validate(&[[0.0; 3]], &base, &[model(vec![[f64::NAN; 3]])]).is_err());
}
