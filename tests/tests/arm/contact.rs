//! Contact and coupling: the real controller on the simulated plant, from
//! beside the sphere to a seated nest that turns. The plant's truth is read
//! here only to judge.

use std::collections::VecDeque;

use nalgebra::{UnitQuaternion, Vector3};
use spherecal::sim::plant::PlantConfig;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::{Command, Contact, Coupled, Event, Fault, Phase, Recording};
use spherecal_shared::robot::{Arm, Robot, built_in, iiwa7, iiwa7_tool};
use spherecal_tests::rig::{Rig, SEED, down, nominal, solve};

/// Yaw of the tool at which the wrist is far from its limits over the plate.
const YAW: f64 = std::f64::consts::PI;

/// A plant with a perfect plate, so that the test knows where the sphere is.
fn plant() -> PlantConfig {
    PlantConfig::preset("ideal").expect("a preset")
}

/// A rig whose TCP stands `offset` (m) beside sphere 1's true place.
fn beside(config: &PlantConfig, offset: Vector3<f64>) -> Rig {
    let centre = Vector3::from(config.cell.first().origin_m);
    let q = solve(&nominal(), &(centre + offset), &down(YAW), &SEED);
    let mut rig = Rig::new(config, Procedure::default(), &q);
    rig.run(300);
    rig
}

fn faults(rig: &Rig) -> Vec<Fault> {
    rig.events
        .iter()
        .filter_map(|e| if let Event::Fault(f) = e { Some(f.fault) } else { None })
        .collect()
}

fn contact(rig: &Rig) -> Contact {
    rig.events
        .iter()
        .find_map(|e| if let Event::Contact(c) = e { Some(*c) } else { None })
        .expect("a contact")
}

fn coupled(rig: &Rig) -> Coupled {
    rig.events
        .iter()
        .find_map(|e| if let Event::Coupled(c) = e { Some(*c) } else { None })
        .expect("a coupling")
}

fn recordings(rig: &Rig) -> Vec<Recording> {
    rig.events
        .iter()
        .filter_map(|e| {
            if let Event::Recording(r) = e {
                Some(r.clone())
            } else {
                None
            }
        })
        .collect()
}

/// Fails if an approach from 20 mm above and 10 mm beside does not end in a
/// contact at 7.5 N held for the dwell, with the nest seated within 5 s.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_nest_centres_itself_from_every_side() {
    let config = plant();
    for k in 0..8 {
        let (s, c) = (f64::from(k) * std::f64::consts::FRAC_PI_4).sin_cos();
        let mut rig = beside(&config, Vector3::new(0.010 * c, 0.010 * s, 0.020));
        rig.approach(1).expect("an approach");
        assert!(
            rig.run_until(Phase::Coupling, 10_000),
            "direction {k}: {:?}",
            faults(&rig)
        );
        let contact = contact(&rig);
        assert!(
            contact.force_n >= 7.5 && contact.force_n < 8.5,
            "direction {k}: {contact:?}"
        );
        assert!(contact.latency_ticks >= 20, "the dwell is 20 ms");
        rig.run(5_000);
        let truth = rig.plant.truth();
        assert_eq!(truth.seated, Some(0), "direction {k}: gap {:?}", truth.gap_m);
        assert!(
            rig.run_until(Phase::Coupled, 2_000),
            "direction {k}: {:?}",
            faults(&rig)
        );
        let coupled = coupled(&rig);
        let truth = rig.plant.truth();
        assert!(
            coupled.test_m < 1e-4 && truth.gap_m[0] < 5e-5,
            "direction {k}: {coupled:?}, {truth:?}"
        );
    }
}

/// Fails if the nest leaves the sphere, the controller faults, or a recording
/// is not the mean of 200 consecutive samples of a seated nest, through
/// turns of 20 degrees about all axes and elbow turns of 20 degrees.
#[test]
fn a_seated_nest_stays_seated_through_the_turns() {
    let mut rig = beside(&plant(), Vector3::new(0.006, -0.006, 0.020));
    rig.approach(1).expect("an approach");
    assert!(rig.run_until(Phase::Coupled, 20_000), "{:?}", faults(&rig));
    let elbow = rig.elbow();
    let mut id = 0;
    let mut turn = |rig: &mut Rig, axis: Vector3<f64>, degrees: f64, elbow_degrees: f64| {
        let turn = UnitQuaternion::from_scaled_axis(axis * degrees.to_radians());
        let rotation = turn.to_rotation_matrix().into_inner() * down(YAW);
        let before = rig.tick;
        let elbow_rad = elbow + elbow_degrees.to_radians();
        assert!(rig.pose(id, &rotation, Some(elbow_rad)), "pose {id}: {:?}", faults(rig));
        // The nest must not have left in between: the plant is asked after every pose.
        let truth = rig.plant.truth();
        assert_eq!(truth.seated, Some(0), "pose {id}: gap {:?}", truth.gap_m);
        assert!(
            (rig.elbow() - elbow_rad).abs() < 0.02,
            "pose {id}: elbow off by {}",
            rig.elbow() - elbow_rad
        );
        assert!(rig.tick - before < 5_000, "pose {id} took {} ms", rig.tick - before);
        id += 1;
    };
    for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
        for degrees in [10.0, 20.0, 0.0, -20.0] {
            turn(&mut rig, axis, degrees, 0.0);
        }
    }
    for elbow_degrees in [10.0, 20.0, -20.0] {
        turn(&mut rig, Vector3::z(), 0.0, elbow_degrees);
    }
    let recordings = recordings(&rig);
    assert_eq!(recordings.len(), 15);
    for recording in &recordings {
        assert_eq!((recording.count, recording.gaps), (200, 0));
        assert!(recording.tcp_spread_m < 2e-5, "{recording:?}");
        assert!(
            recording
                .q
                .iter()
                .all(|q| q.std < 5e-4 && q.min <= q.mean && q.mean <= q.max)
        );
    }
    // And it lets go: 26.5 N are overcome, the arm backs off.
    rig.controller.command(Command::Decouple).expect("coupled");
    assert!(rig.run_until(Phase::Idle, 10_000), "{:?}", faults(&rig));
    assert!(rig.plant.truth().gap_m[0] > 0.030);
}

/// Fails if the controller declares a contact where there is nothing to touch.
#[test]
fn without_a_sphere_there_is_no_contact() {
    let config = PlantConfig {
        contact: false,
        ..plant()
    };
    let mut rig = beside(&config, Vector3::new(0.0, 0.0, 0.020));
    rig.approach(1).expect("an approach");
    assert!(!rig.run_until(Phase::Coupling, 20_000));
    assert_eq!(faults(&rig), [Fault::NoContact]);
    // The fault is a damped hold, and can be cleared.
    rig.run(1_000);
    assert!(rig.plant.sensed().dq.iter().all(|dq| dq.abs() < 1e-2));
    rig.controller.command(Command::ClearFault).expect("a fault to clear");
    assert_eq!(rig.controller.phase(), Phase::Idle);
}

/// Fails if a nest that is pulled off while coupled goes unnoticed, or if
/// anything is recorded afterwards.
#[test]
fn a_nest_that_comes_off_is_noticed() {
    let mut rig = beside(&plant(), Vector3::new(0.0, 0.0, 0.020));
    rig.approach(1).expect("an approach");
    assert!(rig.run_until(Phase::Coupled, 20_000), "{:?}", faults(&rig));
    rig.plant.set_magnet(false);
    rig.plant.set_hand_wrench([0.0, 0.0, 30.0], [0.0; 3]);
    let before = rig.tick;
    rig.run_until(Phase::Fault, 2_000);
    assert_eq!(faults(&rig), [Fault::ContactLost]);
    assert!(rig.tick - before < 100, "noticed after {} ms", rig.tick - before);
    rig.plant.set_hand_wrench([0.0; 3], [0.0; 3]);
    rig.run(2_000);
    assert!(recordings(&rig).is_empty());
    assert!(
        rig.plant.sensed().dq.iter().all(|dq| dq.abs() < 1e-2),
        "the hold is damped"
    );
}

/// Fails if the procedure works on an ideal arm only: the presets with wrong
/// geometry, compliance, noise and friction, waypoints 10 mm off.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_real_presets_couple_too() {
    for preset in ["typical", "harsh"] {
        for seed in 1..=3 {
            let config = PlantConfig {
                seed,
                ..PlantConfig::preset(preset).expect("a preset")
            };
            let mut rig = beside(&config, Vector3::new(-0.005, 0.005, 0.040));
            rig.approach(1).expect("an approach");
            assert!(
                rig.run_until(Phase::Coupled, 20_000),
                "{preset} {seed}: {:?}",
                rig.events
            );
            assert_eq!(rig.plant.truth().seated, Some(0), "{preset} {seed}");
            let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.2, 0.0, 0.1)).to_rotation_matrix();
            let elbow = rig.elbow() + 0.2;
            assert!(
                rig.pose(1, &(rotation.into_inner() * down(YAW)), Some(elbow)),
                "{preset} {seed}: {:?}",
                rig.events
            );
            assert_eq!(rig.plant.truth().seated, Some(0), "{preset} {seed}");
        }
    }
}

/// Largest mean force over 10 ms against a descent straight down: as the controller tells it, and what spheres, plate and magnet
/// together did to the tool (N).
fn peaks<const N: usize>(
    robot: &Robot,
    (seed, yaw): (&[f64; N], f64),
    preset: &str,
    speed_m_s: f64,
    offset: [f64; 3],
) -> [f64; 2] {
    let mut config = PlantConfig::preset(preset).expect("a preset");
    config.seed = 3;
    let mut procedure = Procedure::default();
    procedure.approach.speed_m_s = speed_m_s;
    let arm = Arm::new(robot, &iiwa7_tool()).expect("a built-in robot");
    let beside = Vector3::from(config.cell.first().origin_m) + Vector3::from(offset);
    let q = solve(&arm, &beside, &down(yaw), seed);
    let mut rig = Rig::of(robot, &config, procedure, &q);
    rig.run(300);
    rig.approach(1)
        .unwrap_or_else(|e| panic!("{e:?}: {q:?} {:?}", rig.events));
    let mut forces = VecDeque::from([0.0; 10]);
    let mut most = 0.0f64;
    for _ in 0..20_000 {
        rig.run(1);
        if let Some(contact) = rig
            .events
            .iter()
            .find_map(|e| if let Event::Contact(c) = e { Some(c) } else { None })
        {
            return [contact.peak_n, most];
        }
        let truth = rig.plant.truth();
        forces.pop_front();
        forces.push_back((truth.contact_n + truth.magnet_n).z);
        most = most.max(forces.iter().sum::<f64>() / 10.0);
    }
    panic!("{preset}, {speed_m_s} m/s: no contact: {:?}", rig.events);
}

// Fails if the largest force of a descent differs from the plant's by more than a fifth, or 4 N: the observer's own low-pass shows a
// third of it. A quarter, or 9 N, is what elastic joints make of it: their encoders are at the motor's side and show its swing.
#[test]
fn the_peak_force_is_the_one_of_ten_milliseconds() {
    let (fr3, ur5e) = (built_in("fr3").expect("known"), built_in("ur5e").expect("known"));
    let (bent, folded) = ([0.0, 0.0, 0.0, -2.2, 0.0, 2.2, 0.8], [0.0, -1.6, 1.9, -1.9, -1.6, 0.0]);
    for (preset, share, least_n) in [("typical", 0.2, 4.0_f64), ("as_measured", 0.25, 9.0)] {
        for (speed, offset) in [
            (0.010, [0.0, 0.0, 0.030]),
            (0.025, [0.006, -0.006, 0.030]),
            (0.040, [-0.004, 0.008, 0.030]),
        ] {
            let found = [
                ("iiwa7", peaks(&iiwa7(), (&SEED, YAW), preset, speed, offset)),
                ("fr3", peaks(&fr3, (&bent, 0.8), preset, speed, offset)),
                ("ur5e", peaks(&ur5e, (&folded, 0.0), preset, speed, offset)),
            ];
            for (arm, [told, of_plant]) in found {
                let words = format!("{arm}, {preset}, {speed} m/s: told {told:.1} N, plant {of_plant:.1} N");
                println!("{words}: {:.2}", told / of_plant);
                assert!((told - of_plant).abs() < least_n.max(share * of_plant), "{words}");
            }
        }
    }
}
