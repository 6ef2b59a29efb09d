//! The simulated plant against MuJoCo, against conservation laws, and against
//! what its sensors, its configuration and its tracker are specified to do.

use super::plant_rig::{Law, at_sphere, free, run};
use nalgebra::{SVector, Vector3};
use serde::Deserialize;
use spherecal::model::TrackerSession;
use spherecal::sim::plant::{Plant, PlantConfig, PlantError};
use spherecal_shared::robot::{Dynamics, Inertia, Robot, Tool, iiwa7, iiwa7_tool};
use spherecal_tests::data;

#[derive(Deserialize)]
struct Record {
    t: f64,
    q: [f64; 7],
}

#[derive(Deserialize)]
struct Trajectory {
    q0: [f64; 7],
    #[serde(rename = "A")]
    amplitude: [f64; 7],
    w: [f64; 7],
    rec: Vec<Record>,
}

#[derive(Deserialize)]
struct Reference {
    traj: Vec<Trajectory>,
}

/// The tool of `ref_dyn.json`.
fn reference_tool() -> Tool {
    Tool {
        tcp_m: [0.05, 0.0, 0.07],
        body: Inertia {
            mass_kg: 1.5,
            com_m: [0.025, 0.0, 0.032],
            inertia_kg_m2: [0.0012, 0.0022, 0.0022, 0.0, 0.0, 0.0],
        },
    }
}

/// Largest joint error against MuJoCo at 0.1 s over the trajectories.
fn trajectory_error(config: &PlantConfig) -> f64 {
    let reference: Reference = data("ref_dyn.json");
    assert_eq!(reference.traj.len(), 2);
    let mut worst: f64 = 0.0;
    for case in &reference.traj {
        let mut plant = Plant::<7>::new(&iiwa7(), &reference_tool(), config, &case.q0).expect("a plant");
        for k in 0..100 {
            let t = f64::from(k) * 1e-3;
            let tau = core::array::from_fn(|i| case.amplitude[i] * (case.w[i] * t).sin());
            plant.step(&tau);
        }
        let record = case.rec.iter().find(|r| (r.t - 0.1).abs() < 1e-9).expect("0.1 s");
        let truth = plant.truth();
        for i in 0..7 {
            worst = worst.max((truth.q[i] - record.q[i]).abs());
        }
    }
    worst
}

/// Fails if dynamics, integrator, torque hold or the order of joints is off.
#[test]
fn free_trajectories_agree_with_mujoco() {
    let default = trajectory_error(&free());
    let fine = trajectory_error(&PlantConfig {
        free_step_s: 1e-4,
        ..free()
    });
    println!("error at 0.1 s: default step {default:.3e} rad, 0.1 ms {fine:.3e} rad");
    assert!(default < 1e-6 && fine < 1e-6, "{default:.3e} {fine:.3e}");
}

/// The stiff integrator on the same trajectories: the error at
/// its default sub-step is stated, and shrinks with the sub-step.
#[test]
fn the_stiff_integrator_converges_to_the_same_trajectories() {
    let with = |substep_s: f64| {
        let mut config = free();
        config.substep_s = substep_s;
        // A friction that does nothing, but asks for the stiff integrator.
        config.friction.enabled = true;
        config.friction.coulomb_nm = [1e-12, 1e-12];
        config.friction.viscous_nm_s = [0.0, 0.0];
        trajectory_error(&config)
    };
    let (default, fine) = (with(2.5e-4), with(1e-5));
    println!("stiff integrator, error at 0.1 s: 0.25 ms {default:.3e} rad, 10 us {fine:.3e} rad");
    assert!(
        default < 3e-3 && fine < 1e-4 && fine < default / 10.0,
        "{default:.3e} {fine:.3e}"
    );
}

/// Fails if the free integrator makes or loses energy.
#[test]
fn free_motion_conserves_energy() {
    let reference: Reference = data("ref_dyn.json");
    // No end stops: they are springs with dampers.
    let mut robot = iiwa7();
    for joint in &mut robot.joints {
        joint.limits.min_rad = -100.0;
        joint.limits.max_rad = 100.0;
    }
    for case in &reference.traj {
        let mut plant = Plant::<7>::new(&robot, &iiwa7_tool(), &free(), &case.q0).expect("a plant");
        let energy = |p: &Plant<7>| p.truth().kinetic_j + p.truth().potential_j;
        let start = energy(&plant);
        let mut kinetic: f64 = 0.0;
        let mut worst: f64 = 0.0;
        for _ in 0..1000 {
            plant.step(&[0.0; 7]);
            kinetic = kinetic.max(plant.truth().kinetic_j);
            worst = worst.max((energy(&plant) - start).abs());
        }
        println!("energy: drift {:.2e} of {kinetic:.1} J kinetic", worst / kinetic);
        assert!(worst < 1e-6 * kinetic, "{worst} J of {kinetic} J");
    }
}

/// The stated sign: at rest `tau = gravity − Jᵀ F`, `F` the force of the environment on the tool.
#[test]
fn measured_torque_at_rest_is_gravity_less_the_outer_force() {
    let q = [0.3, 0.6, -0.2, -1.2, 0.4, 0.9, 0.1];
    let mut plant = Plant::<7>::new(&iiwa7(), &iiwa7_tool(), &free(), &q).expect("a plant");
    let law = Law::new(&q);
    let arm = &law.arm;
    let hold = arm.tcp_frame(&arm.frames(&q));
    let force = [4.0, -7.0, 9.0];
    plant.set_hand_wrench(force, [0.0; 3]);
    run(&mut plant, &law, &hold, 500.0, 8000);
    let truth = plant.truth();
    let frames = arm.frames(&truth.q);
    let jacobian = arm.jacobian(&frames, &truth.tcp.position);
    let f = SVector::<f64, 6>::from_column_slice(&[4.0, -7.0, 9.0, 0.0, 0.0, 0.0]);
    let expected = arm.bodies(&frames).gravity() - jacobian.transpose() * f;
    for i in 0..7 {
        assert!((plant.sensed().tau[i] - expected[i]).abs() < 0.05, "joint {i}");
    }
}

/// Same seed, same bits; another seed, another world. A clone goes on alike.
#[test]
fn the_plant_is_deterministic() {
    let trace = |seed: u64, split: bool| {
        let config = PlantConfig {
            seed,
            ..PlantConfig::typical()
        };
        let (mut plant, law, seat) = at_sphere(&config, Vector3::z() * 0.012);
        let mut bits = Vec::new();
        for k in 0..600 {
            if split && k == 300 {
                plant = plant.clone();
            }
            run(&mut plant, &law, &seat, 300.0, 1);
            bits.extend(plant.sensed().q.map(f64::to_bits));
            bits.extend(plant.sensed().tau.map(f64::to_bits));
        }
        bits
    };
    let once = trace(7, false);
    assert!(once == trace(7, true));
    assert!(once != trace(8, false));
}

/// A refused torque (NaN) keeps the last good one; one beyond the limit is cut.
#[test]
fn bad_torques_are_refused_or_cut() {
    let q = [0.0, 0.5, 0.0, -1.0, 0.0, 0.8, 0.0];
    let mut plant = Plant::<7>::new(&iiwa7(), &iiwa7_tool(), &free(), &q).expect("a plant");
    let mut tau = plant.sensed().tau;
    tau[3] = f64::NAN;
    let sensed = plant.step(&tau);
    assert!(sensed.refused && !sensed.saturated);
    assert!(sensed.q.iter().zip(&q).all(|(a, b)| (a - b).abs() < 1e-6));
    let sensed = plant.step(&[0.0, 1e6, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert!(sensed.saturated && (sensed.tau[1] - 176.0).abs() < 1e-9);
}

/// Each bad field is named with value and remedy.
#[test]
fn a_bad_configuration_is_refused_by_name() {
    let refuse = |text: &str| PlantConfig::from_toml(text).expect_err("must be refused").to_string();
    assert!(refuse("substep_s = 0.0003").contains("substep_s is 0.0003"));
    assert!(refuse("[nest]\nstiffness_n_m = -1.0").contains("nest.stiffness_n_m is -1"));
    assert!(refuse("[sensors]\nangle_white_rad = nan").contains("sensors.angle_white_rad is NaN"));
    assert!(refuse("[plate]\nplacement_sigma_m = -1").contains("plate.placement_sigma_m is -1"));
    assert!(refuse("[plate]\nspheres_m = []").contains("spheres_m"));
    assert!(matches!(PlantConfig::preset("perfect"), Err(PlantError::Preset { .. })));
    let typical = PlantConfig::typical();
    let round = PlantConfig::from_toml(&typical.to_toml().expect("TOML")).expect("its own text");
    assert_eq!(round, typical);
    // Another number of joints than the plant was built for.
    assert!(Plant::<6>::new(&iiwa7(), &iiwa7_tool(), &typical, &[0.0; 6]).is_err());
}

/// A six-joint arm goes through the same plant.
#[test]
fn six_joints_work_alike() {
    let mut six: Robot = iiwa7();
    let removed = six.joints.remove(2);
    six.joints[2].mdh.d += removed.mdh.d;
    let config = PlantConfig::typical();
    let q = [0.1, 0.4, -0.9, 0.2, 0.7, 0.0];
    let mut plant = Plant::<6>::new(&six, &iiwa7_tool(), &config, &q).expect("a plant");
    for _ in 0..200 {
        let tau = plant.sensed().tau;
        plant.step(&tau);
    }
    assert!(plant.sensed().q.iter().all(|x| x.is_finite()));
}

/// The tracker sees the true geometry through its noise, and the encoders read
/// what was commanded.
#[test]
fn tracker_shots_show_the_true_point() {
    let mut config = PlantConfig::typical();
    config.tracker.remount_m = 0.6e-3;
    let mut plant = Plant::<7>::new(&iiwa7(), &iiwa7_tool(), &config, &[0.0; 7]).expect("a plant");
    let q = [0.4, 0.8, -0.3, -1.1, 0.6, 0.9, -0.5];
    let frame = plant.tracker_frame();
    let link = plant.world().link_angles_at_rest(&q);
    let true_point = plant.world().tcp(&link).position;
    let count = 400;
    let mut square = 0.0;
    for _ in 0..count {
        let shot = plant.tracker_shot(&q);
        for i in 0..7 {
            assert!((shot.q_encoder[i] - q[i]).abs() < 1.2e-5);
        }
        let error = frame.point(&Vector3::from(shot.point_m)) - true_point;
        square += error.norm_squared();
    }
    let sigma = (square / f64::from(3 * count)).sqrt();
    assert!((sigma * 1.96 - 49e-6).abs() < 4e-6, "95 % at {sigma}");
    // A remounted reflector stands elsewhere by what was configured.
    plant.tracker_session(TrackerSession::ToolArcs);
    let mut mean = Vector3::zeros();
    for _ in 0..count {
        mean += frame.point(&Vector3::from(plant.tracker_shot(&q).point_m)) / f64::from(count);
    }
    assert!(((mean - true_point).norm() - config.tracker.remount_m).abs() < 1e-5);
}
