//! The simulated plant against MuJoCo, against conservation laws, and against
//! what the nest, the magnet and the sensors are specified to do.
//!
//! A small impedance law of the tests' own moves the arm, so that nothing of
//! the controller is trusted here; plant truth is read by the tests only.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use serde::Deserialize;
use spherecal::plant::{Plant, PlantConfig, PlantError, Sensed, TrackerSession};
use spherecal_shared::robot::{Arm, Dynamics, Frame, Inertia, Robot, Tool, iiwa7, iiwa7_tool};
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

/// An ideal plant in empty space.
fn free() -> PlantConfig {
    PlantConfig {
        contact: false,
        ..PlantConfig::ideal()
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

/// A Cartesian impedance law on truth-free data, with the plant's own ideal model.
struct Law {
    arm: Arm<f64, 7>,
    rest: [f64; 7],
}

impl Law {
    fn new(q: &[f64; 7]) -> Self {
        Self {
            arm: Arm::new(&iiwa7(), &iiwa7_tool()).expect("a robot"),
            rest: *q,
        }
    }

    fn torque(&self, s: &Sensed<7>, target: &Frame<f64>, k: f64, kr: f64) -> [f64; 7] {
        let frames = self.arm.frames(&s.q);
        let bodies = self.arm.bodies(&frames);
        let tcp = self.arm.tcp_frame(&frames);
        let jacobian = self.arm.jacobian(&frames, &tcp.origin);
        let dq = SVector::<f64, 7>::from(s.dq);
        let v = jacobian * dq;
        let e = target.origin - tcp.origin;
        let turn = nalgebra::Rotation3::from_matrix(&(target.rotation * tcp.rotation.transpose())).scaled_axis();
        let mut f = SVector::<f64, 6>::zeros();
        for i in 0..3 {
            f[i] = k * e[i] - 25.0 * v[i];
            f[i + 3] = kr * turn[i] - 4.0 * v[i + 3];
        }
        // A weak posture spring holds the elbow, in the null space of the force.
        let posture = (SVector::from(self.rest) - SVector::from(s.q)) * 2.0 - dq * 0.5;
        let square = jacobian * jacobian.transpose() + SMatrix::<f64, 6, 6>::identity() * 1e-6;
        let task = square.try_inverse().expect("regular") * (jacobian * posture);
        (jacobian.transpose() * (f - task) + posture + bodies.gravity()).into()
    }
}

/// Nose-down orientation with a turn about z.
fn down(yaw: f64) -> Matrix3<f64> {
    let (s, c) = yaw.sin_cos();
    Matrix3::new(c, s, 0.0, s, -c, 0.0, 0.0, 0.0, -1.0)
}

/// Joint angles for a TCP frame, by damped least squares.
fn reach(target: &Frame<f64>) -> [f64; 7] {
    let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("a robot");
    let mut q = [0.0, 0.7, 0.0, -1.4, 0.0, 1.0, 0.0];
    for _ in 0..300 {
        let frames = arm.frames(&q);
        let tcp = arm.tcp_frame(&frames);
        let e = target.origin - tcp.origin;
        let turn = nalgebra::Rotation3::from_matrix(&(target.rotation * tcp.rotation.transpose())).scaled_axis();
        let error = SVector::<f64, 6>::from_iterator(e.iter().chain(turn.iter()).copied());
        let j = arm.jacobian(&frames, &tcp.origin);
        let damped = j * j.transpose() + SMatrix::<f64, 6, 6>::identity() * 1e-6;
        let step = j.transpose() * damped.try_inverse().expect("regular") * error;
        for i in 0..7 {
            q[i] += step[i].clamp(-0.2, 0.2);
        }
    }
    let tcp = arm.tcp_frame(&arm.frames(&q));
    assert!((tcp.origin - target.origin).norm() < 1e-9, "out of reach");
    q
}

/// An ideal plant whose nest is `offset` (m, F0) away from its seat on sphere 2.
fn at_sphere(config: &PlantConfig, offset: Vector3<f64>) -> (Plant<7>, Law, Frame<f64>) {
    let sphere = Plant::<7>::new(&iiwa7(), &iiwa7_tool(), config, &[0.0; 7])
        .expect("a plant")
        .world()
        .spheres[1]
        .expect("a sphere");
    let seat = Frame {
        rotation: down(core::f64::consts::PI),
        origin: sphere,
    };
    let q = reach(&Frame {
        origin: sphere + offset,
        ..seat
    });
    let plant = Plant::new(&iiwa7(), &iiwa7_tool(), config, &q).expect("a plant");
    (plant, Law::new(&q), seat)
}

/// Runs `ms` ticks towards a target.
fn run(plant: &mut Plant<7>, law: &Law, target: &Frame<f64>, k: f64, ms: u32) {
    for _ in 0..ms {
        let tau = law.torque(plant.sensed(), target, k, 200.0);
        plant.step(&tau);
    }
}

/// Fails if pads, friction or magnet do not hold a seated nest through turns,
/// or if the static balance of forces is off.
#[test]
fn a_seated_nest_holds_and_turns() {
    let (mut plant, law, seat) = at_sphere(&PlantConfig::ideal(), Vector3::new(0.0, 0.0, 2e-4));
    run(&mut plant, &law, &seat, 5.0, 1000);
    let truth = plant.truth();
    assert_eq!(truth.seated, Some(1), "{truth:?}");
    // The three pads carry the magnet's pull: F0 / (3 cos 54.7°) each but for the spring and friction.
    let sum: f64 = truth.pad_n.iter().sum();
    assert!((sum - 26.5 * 3.0_f64.sqrt()).abs() < 4.0, "pads {:?}", truth.pad_n);
    assert!((truth.contact_n + truth.magnet_n).norm() < 3.0);
    // 10 degrees a second about each axis, both ways.
    let step = 0.1_f64.to_radians();
    let mut turn = nalgebra::Rotation3::identity();
    for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
        for part in [20.0_f64, -20.0, 0.0] {
            let goal = nalgebra::Rotation3::new(axis * part.to_radians());
            for _ in 0..450 {
                let left = turn.angle_to(&goal);
                if left > 1e-9 {
                    turn = turn.slerp(&goal, (step / left).min(1.0));
                }
                let target = Frame {
                    rotation: turn.into_inner() * seat.rotation,
                    ..seat
                };
                run(&mut plant, &law, &target, 20.0, 10);
                assert_eq!(
                    plant.truth().seated,
                    Some(1),
                    "lost at {part} degrees: {:?}",
                    plant.truth()
                );
            }
            let tilt = nalgebra::Rotation3::from_matrix(&(plant.truth().tcp.rotation * seat.rotation.transpose()));
            assert!(
                tilt.angle_to(&goal) < 1.0_f64.to_radians(),
                "did not turn to {part} degrees"
            );
        }
    }
    assert!((plant.truth().tcp.origin - seat.origin).norm() < 3e-5);
}

/// Fails if the pull-off force is not the magnet's: 20 N hold, 35 N do not.
#[test]
fn the_nest_comes_off_when_pulled_beyond_the_magnet() {
    let (mut plant, law, seat) = at_sphere(&PlantConfig::ideal(), Vector3::new(0.0, 0.0, 1e-4));
    run(&mut plant, &law, &seat, 5.0, 500);
    plant.set_hand_wrench([0.0, 0.0, 22.0], [0.0; 3]);
    run(&mut plant, &law, &seat, 5.0, 1000);
    assert_eq!(plant.truth().seated, Some(1));
    plant.set_hand_wrench([0.0, 0.0, 32.0], [0.0; 3]);
    run(&mut plant, &law, &seat, 5.0, 500);
    assert_eq!(plant.truth().seated, None);
    assert!(plant.truth().gap_m[1] > 0.005, "{:?}", plant.truth().gap_m);
}

/// The nest comes down 40 mm beside its place by `aside`, presses, and is let go soft.
fn press_and_release(aside: Vector3<f64>) -> Plant<7> {
    let (mut plant, law, seat) = at_sphere(&PlantConfig::ideal(), aside + Vector3::z() * 0.040);
    for ms in 0..2500 {
        let fall = f64::from(ms).min(2200.0) * 1e-3 * 0.05;
        let target = Frame {
            origin: seat.origin + aside + Vector3::z() * (0.040 - fall),
            ..seat
        };
        run(&mut plant, &law, &target, 150.0, 1);
    }
    let hold = Frame {
        origin: plant.truth().tcp.origin,
        ..seat
    };
    run(&mut plant, &law, &hold, 5.0, 3000);
    plant
}

/// Up to 12 mm of lateral offset the nest slides home; from 36 mm over a pad's
/// land it stays on the rim, and nothing centres it.
#[test]
fn lateral_offsets_centre_but_a_rim_hit_does_not() {
    for millimetres in [2.0, 8.0, 12.0] {
        for k in 0..8 {
            let (s, c) = (f64::from(k) * core::f64::consts::FRAC_PI_4).sin_cos();
            let plant = press_and_release(Vector3::new(c, s, 0.0) * millimetres * 1e-3);
            assert_eq!(plant.truth().seated, Some(1), "{millimetres} mm, direction {k}");
        }
    }
    for k in 0..3 {
        // The sphere meets the land of pad k: the nest is off to the other side.
        let (s, c) = (f64::from(k) * core::f64::consts::TAU / 3.0).sin_cos();
        let truth = press_and_release(down(core::f64::consts::PI) * Vector3::new(-c, -s, 0.0) * 0.036).truth();
        assert_eq!(truth.seated, None, "land {k}");
        assert!(truth.gap_m[1] > 0.03, "land {k}: {truth:?}");
    }
}

/// Fails if contact is not switched off with its switch.
#[test]
fn without_contact_the_arm_falls_through_the_sphere() {
    let config = free();
    let (mut plant, law, seat) = at_sphere(&config, Vector3::z() * 0.010);
    let through = Frame {
        origin: seat.origin - Vector3::z() * 0.03,
        ..seat
    };
    run(&mut plant, &law, &through, 200.0, 3000);
    let truth = plant.truth();
    assert!((truth.tcp.origin - through.origin).norm() < 1e-3);
    assert_eq!(truth.contact_n, Vector3::zeros());
    // And no force reads at the joints: the arm's own gravity only.
    let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("a robot");
    let gravity = arm.bodies(&arm.frames(&truth.q)).gravity();
    let sensed = plant.sensed();
    for i in 0..7 {
        assert!((sensed.tau[i] - gravity[i]).abs() < 0.5, "joint {i}");
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
    let jacobian = arm.jacobian(&frames, &truth.tcp.origin);
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
    assert!(refuse("[plate]\nspheres_m = []").contains("plate.spheres_m is 0"));
    assert!(refuse("[plate]\nsphere_radius_mm = 25.4").contains("sphere_radius_mm"));
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
    let config = PlantConfig::typical();
    let mut plant = Plant::<7>::new(&iiwa7(), &iiwa7_tool(), &config, &[0.0; 7]).expect("a plant");
    let q = [0.4, 0.8, -0.3, -1.1, 0.6, 0.9, -0.5];
    let frame = plant.tracker_frame();
    let link = plant.world().link_angles_at_rest(&q);
    let true_point = plant.world().tcp(&link).origin;
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
