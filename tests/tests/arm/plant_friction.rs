//! Joint friction and rotor inertia of the plant against MuJoCo.
//!
//! `data/ref_friction.json` is made by `python/mujoco_oracle.py`: dry friction
//! as MuJoCo's `frictionloss`, viscous friction as `damping`, rotors as
//! `armature`, converged in the step to the difference that each case states.

use serde::Deserialize;
use spherecal::sim::plant::{Plant, PlantConfig};
use spherecal_shared::robot::{iiwa7, iiwa7_tool};
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
    coulomb: f64,
    viscous: f64,
    armature: [f64; 7],
    halving_moved_rad: f64,
    rec: Vec<Record>,
}

#[derive(Deserialize)]
struct Reference {
    traj: Vec<Trajectory>,
}

/// Largest joint error at 0.1 s of one case at a sub-step.
fn error(case: &Trajectory, substep_s: f64) -> f64 {
    let mut config = PlantConfig::ideal();
    config.contact = false;
    config.substep_s = substep_s;
    config.free_step_s = substep_s;
    config.friction.enabled = true;
    config.friction.coulomb_nm = [case.coulomb; 2];
    config.friction.viscous_nm_s = [case.viscous; 2];
    config.inertia.rotors = true;
    config.inertia.rotor_sigma = 0.0;
    config.inertia.rotor_share = 1.0;
    // The reference torques are not bounded. Of a stronger joint than 176 N m the plant makes the rotor larger in proportion.
    const BEYOND_NM: f64 = 1e4;
    for (rotor, armature) in config.inertia.rotor_kg_m2.iter_mut().zip(&case.armature) {
        *rotor = armature * 176.0 / BEYOND_NM;
    }
    let mut robot = iiwa7();
    for joint in &mut robot.joints {
        joint.limits.torque_nm = BEYOND_NM;
        joint.limits.min_rad = -100.0;
        joint.limits.max_rad = 100.0;
    }
    let mut plant = Plant::<7>::new(&robot, &iiwa7_tool(), &config, &case.q0).expect("a plant");
    for k in 0..100 {
        let t = f64::from(k) * 1e-3;
        plant.step(&core::array::from_fn(|i| case.amplitude[i] * (case.w[i] * t).sin()));
    }
    let record = case.rec.iter().find(|r| (r.t - 0.1).abs() < 1e-9).expect("0.1 s");
    let truth = plant.truth();
    (0..7).map(|i| (truth.q[i] - record.q[i]).abs()).fold(0.0, f64::max)
}

/// Fails if friction, its stick and slip, or the rotors are off.
#[test]
fn friction_and_rotors_agree_with_mujoco() {
    let reference: Reference = data("ref_friction.json");
    assert_eq!(reference.traj.len(), 6);
    for (k, case) in reference.traj.iter().enumerate() {
        assert!(
            case.halving_moved_rad < 5e-5,
            "the reference itself must have converged"
        );
        let (default, fine) = (error(case, 2.5e-4), error(case, 1e-5));
        println!("case {k}: 0.25 ms {default:.2e} rad, 10 us {fine:.2e} rad at 0.1 s");
        assert!(fine < 1e-4, "case {k}: {fine:.2e} rad");
    }
}
