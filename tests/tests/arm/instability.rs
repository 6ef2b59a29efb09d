//! The instability guard on the simulated arm: a drive that suddenly answers 8 ms later.

use embassy_time::Instant;
use spherecal::sim::plant::PlantConfig;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::DriveStatus;
use spherecal_shared::protocol::host::{Command, Event, Fault, Phase};
use spherecal_tests::rig::{Rig, SEED};

/// Delay that comes suddenly, in s.
const STEP_S: f64 = 0.008;

/// What happened after the step.
#[derive(Debug, Default)]
struct Course {
    /// Time from the first fast swing (0.4 rad/s) of any joint to the brakes, in s.
    braked_s: Option<f64>,
    /// Fastest joint, in rad/s.
    fastest: f64,
    /// Most kinetic energy, in J.
    energy: f64,
}

/// Lets the rig run for 3 s with the late drive. Its brakes work.
fn late(rig: &mut Rig, config: &PlantConfig, state: bool) -> Course {
    let mut delays = config.drive;
    if state {
        delays.state_delay_s = STEP_S;
    } else {
        delays.command_delay_s = STEP_S;
    }
    rig.plant.set_delays(delays);
    let mut course = Course::default();
    let mut swings_s = None;
    let mut mean = rig.plant.truth().dq;
    for tick in 0..3000 {
        rig.tick += 1;
        let command = rig.controller.tick(Instant::from_millis(rig.tick), &rig.state());
        rig.controller.host_heard();
        while let Some(event) = rig.controller.next_event() {
            rig.events.push(event);
        }
        while rig.controller.next_sample().is_some() {}
        if command.enable {
            let tau: [f64; 7] = command.tau.as_slice().try_into().expect("seven torques");
            rig.plant.step(&tau);
        } else {
            rig.plant.step_braked();
            let since = swings_s.map_or(0.0, |since: f64| f64::from(tick) * 1e-3 - since);
            course.braked_s = course.braked_s.or(Some(since));
        }
        let truth = rig.plant.truth();
        for (dq, mean) in truth.dq.iter().zip(&mut mean) {
            *mean += 0.06 * (dq - *mean);
            course.fastest = course.fastest.max(dq.abs());
            if (dq - *mean).abs() > 0.4 && swings_s.is_none() {
                swings_s = Some(f64::from(tick) * 1e-3);
            }
        }
        course.energy = course.energy.max(truth.kinetic_j);
    }
    course
}

/// Checks the course, and that the fault says what happened.
fn check(name: &str, rig: &Rig, course: &Course, told: bool) {
    let faults: Vec<_> = rig
        .events
        .iter()
        .filter_map(|e| if let Event::Fault(f) = e { Some(f.fault) } else { None })
        .collect();
    println!("{name}: {course:?}, {faults:?}");
    let braked_s = course
        .braked_s
        .unwrap_or_else(|| panic!("{name}: no brakes, {course:?}"));
    assert!(braked_s <= 0.020, "{name}: brakes after {braked_s} s");
    assert!(course.fastest < 1.5, "{name}: {} rad/s", course.fastest);
    assert!(course.energy < 5.0, "{name}: {} J", course.energy);
    assert_eq!(rig.controller.phase(), Phase::Fault, "{name}");
    if told {
        assert_eq!(faults.last(), Some(&Fault::Unstable), "{name}: {faults:?}");
    }
}

// Fails if a drive that suddenly answers 8 ms later makes a joint faster than 1.5 rad/s or gives
// the arm 5 J, or if the brakes are not closed 20 ms after the first fast swing: in a hold, in a
// motion, after a fault, and on the sphere.
#[test]
fn the_brakes_close_on_a_drive_that_suddenly_answers_late() {
    for seed in 1..=3 {
        for state in [false, true] {
            let mut config = PlantConfig::typical();
            config.seed = seed;
            let holds = |config: &PlantConfig| {
                let mut rig = Rig::new(config, Procedure::default(), &SEED);
                rig.run(500);
                rig
            };
            let name = |what: &str| format!("{what}, seed {seed}, {}", if state { "state" } else { "command" });

            let mut rig = holds(&config);
            let course = late(&mut rig, &config, state);
            check(&name("hold"), &rig, &course, true);

            let mut rig = holds(&config);
            let mut target = SEED;
            target[0] += 1.2;
            target[2] += 0.4;
            let target = spherecal_shared::Joints::from_slice(&target).expect("seven of eight");
            rig.controller.command(Command::Move { target }).expect("idle");
            rig.run(700);
            assert_eq!(rig.controller.phase(), Phase::Moving);
            let course = late(&mut rig, &config, state);
            check(&name("motion"), &rig, &course, false);

            let mut rig = holds(&config);
            rig.drive = DriveStatus::EmergencyStop;
            rig.run(1);
            rig.drive = DriveStatus::Ready;
            rig.run(200);
            assert_eq!(rig.controller.phase(), Phase::Fault);
            let course = late(&mut rig, &config, state);
            check(&name("fault"), &rig, &course, false);

            let mut rig = holds(&config);
            rig.approach(1).expect("idle");
            assert!(rig.run_until(Phase::Approaching, 5_000));
            rig.run(500);
            let course = late(&mut rig, &config, state);
            check(&name("approach"), &rig, &course, false);
        }
    }
}
