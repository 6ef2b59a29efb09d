//! Joint elasticity as a state, and the static relations between encoder,
//! motor and link.

use super::plant_rig::{Law, free};
use nalgebra::SVector;
use spherecal::sim::plant::{Plant, PlantConfig, StillArm};
use spherecal_shared::linalg::Cholesky;
use spherecal_shared::robot::{Dynamics, iiwa7, iiwa7_tool};

/// A plant with elastic joints and full rotors, else ideal, in empty space.
fn elastic(substep_s: f64) -> PlantConfig {
    let mut config = free();
    config.substep_s = substep_s;
    config.elasticity.enabled = true;
    config.elasticity.damping_nm_s = 0.0;
    config.inertia.rotors = true;
    config.inertia.rotor_sigma = 0.0;
    config.inertia.rotor_share = 1.0;
    config
}

/// At rest the encoders, on the motors, lead the links by gravity over stiffness.
#[test]
fn motors_lead_links_by_torque_over_stiffness() {
    let q = [0.3, 0.6, -0.2, -1.2, 0.4, 0.9, 0.1];
    let mut config = elastic(2.5e-4);
    config.elasticity.damping_nm_s = 20.0;
    let mut plant = Plant::<7>::new(&iiwa7(), &iiwa7_tool(), &config, &q).expect("a plant");
    let hold = plant.sensed().tau;
    for _ in 0..500 {
        plant.step(&hold);
    }
    let truth = plant.truth();
    let law = Law::new(&q);
    let gravity = law.arm.bodies(&law.arm.frames(&truth.q)).gravity();
    for i in 0..7 {
        let lead = plant.sensed().q[i] - truth.q[i];
        assert!((lead - gravity[i] / 16_000.0).abs() < 1e-6, "joint {i}: {lead}");
        assert!((plant.sensed().tau[i] - gravity[i]).abs() < 1e-2, "joint {i}");
    }
}

/// A single joint's resonance: `ω² = K (1/I + 1/B)` with the arm's own inertia
/// about that joint, seen by plucking joint 1 (no gravity acts on it). Fails if
/// motor and link are coupled wrongly or the integrator falsifies the mode.
#[test]
fn an_elastic_joint_rings_at_its_frequency() {
    let q = [0.0, 0.7, 0.0, -1.4, 0.0, 1.0, 0.0];
    // The other joints are made stiff by a large rotor, so that one mode is left.
    let mut config = elastic(5e-5);
    let motor = 1.836;
    config.inertia.rotor_kg_m2 = [motor, 99.0, 99.0, 99.0, 99.0, 99.0, 99.0, 0.0];
    let mut plant = Plant::<7>::new(&iiwa7(), &iiwa7_tool(), &config, &q).expect("a plant");
    let hold = plant.sensed().tau;
    let law = Law::new(&q);
    let mass = law.arm.bodies(&law.arm.frames(&q)).mass_matrix();
    // Springs of all joints in parallel with the links' coupled inertia: linear eigenproblem.
    let k = 16_000.0;
    let root = Cholesky::new(&mass).expect("a mass matrix");
    let inverse = nalgebra::SMatrix::<f64, 7, 7>::from_columns(&core::array::from_fn::<_, 7, _>(|i| {
        root.solve(&SVector::<f64, 7>::from_fn(|j, _| f64::from(u8::from(i == j))))
    }));
    let mut block = nalgebra::SMatrix::<f64, 14, 14>::zeros();
    for i in 0..7 {
        for j in 0..7 {
            block[(i, j)] = inverse[(i, j)] * k;
            block[(i, j + 7)] = -inverse[(i, j)] * k;
        }
        let b = if i == 0 { motor } else { 99.0 };
        block[(i + 7, i)] = -k / b;
        block[(i + 7, i + 7)] = k / b;
    }
    let modes: Vec<f64> = block
        .complex_eigenvalues()
        .iter()
        .map(|x| x.re.max(0.0).sqrt())
        .collect();
    let mut tau = hold;
    tau[0] += 20.0;
    plant.step(&tau);
    let mut crossings = 0;
    let (mut last, mut first_at, mut last_at) = (0.0, None, 0);
    for tick in 0..600 {
        plant.step(&hold);
        let truth = plant.truth();
        let twist = plant.sensed().q[0] - truth.q[0];
        if last < 0.0 && twist >= 0.0 {
            crossings += 1;
            first_at.get_or_insert(tick);
            last_at = tick;
        }
        last = twist;
    }
    let period = f64::from(last_at - first_at.expect("it rings")) * 1e-3 / f64::from(crossings - 1);
    let omega = core::f64::consts::TAU / period;
    let nearest = modes
        .iter()
        .copied()
        .min_by(|a, b| (a - omega).abs().total_cmp(&(b - omega).abs()))
        .expect("modes");
    println!("rings at {omega:.1} rad/s, mode {nearest:.1} rad/s, modes {modes:.0?}");
    assert!((omega / nearest - 1.0).abs() < 0.02, "{omega} against {modes:?}");
}

/// Elastic joints do not create energy, dry friction on the motors included.
#[test]
fn elastic_joints_create_no_energy() {
    for coulomb in [0.0, 0.5] {
        let mut config = elastic(2.5e-4);
        config.friction.enabled = true;
        config.friction.coulomb_nm = [coulomb; 2];
        config.friction.viscous_nm_s = [0.0; 2];
        let q = [0.3, 0.6, -0.2, -1.2, 0.4, 0.9, 0.1];
        let mut plant = Plant::<7>::new(&iiwa7(), &iiwa7_tool(), &config, &q).expect("a plant");
        let energy = |p: &Plant<7>| p.truth().kinetic_j + p.truth().potential_j;
        let start = energy(&plant);
        let mut most: f64 = 0.0;
        for _ in 0..300 {
            plant.step(&[0.0; 7]);
            most = most.max(energy(&plant) - start);
        }
        assert!(most < 1e-3, "gained {most} J");
    }
}

/// Encoder, motor and link angles are each other's inverses through every
/// static error source, and the study's couplings are on the sphere.
#[test]
fn static_relations_invert() {
    for name in ["typical", "as_measured", "w0", "w1", "w2", "w3", "w4"] {
        let mut config = PlantConfig::preset(name).expect("a preset");
        config.tracker.noise = false;
        config.nest.seating_error = false;
        let q = [0.3, 0.6, -0.2, -1.2, 0.4, 0.9, 0.1];
        let plant = Plant::<7>::new(&iiwa7(), &iiwa7_tool(), &config, &q).expect("a plant");
        for i in 0..7 {
            let noise = 6.0 * (config.sensors.angle_white_rad + config.sensors.angle_correlated_rad) + 2e-6;
            assert!((plant.sensed().q[i] - q[i]).abs() < noise, "{name}, joint {i}");
        }
        let motor = plant.world().motor_angles(&q);
        let back = plant.world().encoder_angles(&motor);
        for i in 0..7 {
            assert!((back[i] - q[i]).abs() < 1e-8, "{name}, joint {i}: {}", back[i] - q[i]);
        }
        let guess = [0.0, 0.55, 0.0, -1.70, 0.0, 0.9, 0.0];
        let sphere = plant.world().spheres[1].expect("a sphere");
        let on = StillArm::new(plant.world(), &config)
            .go_to_contact(&guess, &sphere)
            .expect("in reach");
        assert!((on.tcp.position - sphere).norm() < 1e-7, "{name}");
    }
}
