//! Jobs over the interfaces of Universal Robots, with faults in the middle.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};

use spherecal::job::{Config, Link};
use spherecal::model::robots::UR_MOTOR_KG_M2;
use spherecal::sim::UrArm;
use spherecal::{job, simulated};
use spherecal_cyclic::Machine as _;
use spherecal_cyclic::testing::{LOCAL, World};
use spherecal_shared::protocol::host::Fault;
use spherecal_ur::robot::{ArmCommand, ArmHardware, ArmState, RobotConfig, RobotSide, RobotStatistics, start_robot};
use spherecal_ur::wire::{ControllerVersion, KinematicsInfo, Load, SafetyMode, Series};

use super::job::{Job, short};
use super::robots::{Counts, Robot};
use super::{STOPPED, cable_out, restart, stop, stops_in_each_phase, survives};

/// How the robot ends its program by itself.
#[derive(Clone, Copy, Debug)]
enum Trip {
    /// By a protective stop.
    Protective,
    /// A person or another program stops it.
    Program,
}

/// A robot of Universal Robots.
struct Ur {
    trip: Trip,
    world: World,
    config: RobotConfig,
    arm: Arc<Mutex<UrArm>>,
    side: Mutex<Option<RobotSide>>,
}

/// The arm that stays when its robot is switched off.
struct Kept(Arc<Mutex<UrArm>>);

impl ArmHardware for Kept {
    fn state(&self) -> ArmState {
        self.0.lock().expect("a lock").state()
    }

    fn step(&mut self, command: ArmCommand, step_s: f64) -> ArmState {
        self.0.lock().expect("a lock").step(command, step_s)
    }

    fn set_load(&mut self, load: &Load) {
        self.0.lock().expect("a lock").set_load(load);
    }
}

impl Ur {
    /// The arm of `config`, whose program ends in this way, with this software if not that of an e-Series robot.
    fn start(config: &Config, trip: Trip, software: Option<ControllerVersion>) -> Arc<Self> {
        let world = World::new(1);
        let arm = simulated::ur_robot(config).expect("an arm");
        let model = job::loaded_model(config).expect("a robot");
        let probe = world.listen(LOCAL).expect("a free port");
        let address = probe.address().expect("an address");
        drop(probe);
        let robot = RobotConfig::new(Series::ESeries, KinematicsInfo::default());
        let config = RobotConfig {
            machine: world.machine(),
            address,
            version: software.unwrap_or(robot.version),
            limits: std::array::from_fn(|j| {
                let limits = &model.robot.joints[j].limits;
                (limits.velocity_rad_s, limits.torque_nm)
            }),
            ..robot
        };
        let this = Arc::new(Self {
            trip,
            world,
            config,
            arm: Arc::new(Mutex::new(arm)),
            side: Mutex::default(),
        });
        this.switch(true);
        this
    }

    /// What the robot side counted since it was switched on.
    fn statistics(&self) -> RobotStatistics {
        let side = self.side.lock().expect("a lock");
        side.as_ref().map(RobotSide::statistics).unwrap_or_default()
    }

    fn safety(&self, mode: SafetyMode) {
        if let Some(side) = self.side.lock().expect("a lock").as_ref() {
            side.controls().safety_mode.store(mode.number(), Ordering::Relaxed);
        }
    }
}

impl Robot for Ur {
    fn link(&self) -> Link {
        Link::Ur {
            host: self.config.address.ip().to_string(),
            port: self.config.address.port(),
        }
    }

    fn world(&self) -> &World {
        &self.world
    }

    fn is_moving(&self) -> bool {
        self.statistics().runs
    }

    fn trip(&self) {
        match self.trip {
            Trip::Protective => self.safety(SafetyMode::ProtectiveStop),
            Trip::Program => {
                if let Some(side) = self.side.lock().expect("a lock").as_ref() {
                    side.controls().stop_program.store(true, Ordering::Relaxed);
                }
            }
        }
    }

    fn stop(&self, pressed: bool) {
        self.safety(if pressed {
            SafetyMode::SafeguardStop
        } else {
            SafetyMode::Normal
        });
    }

    fn switch(&self, on: bool) {
        let mut side = self.side.lock().expect("a lock");
        *side = None;
        let arm = Kept(Arc::clone(&self.arm));
        *side = on.then(|| start_robot(self.config.clone(), Box::new(arm)).expect("a robot"));
    }

    fn counts(&self) -> Counts {
        let statistics = self.statistics();
        Counts {
            after_stop: statistics.after_stop,
            missing: statistics.silent,
        }
    }
}

/// A job on this robot, and the robot. The motors show in both worlds.
fn robot(name: &str, poses: usize, trip: Trip) -> (Job, Arc<Ur>) {
    robot_with(None, name, poses, trip)
}

/// The same with this software.
fn robot_with(software: Option<ControllerVersion>, name: &str, poses: usize, trip: Trip) -> (Job, Arc<Ur>) {
    let config = motors(short(name, poses));
    let robot = Ur::start(&config, trip, software);
    (Job::new(&config, robot.as_ref()), robot)
}

/// The plant of `config` with the motors of such a robot, so that `sim` has the same arm.
fn motors(mut config: Config) -> Config {
    let inertia = format!(
        "rotors = true\nrotor_kg_m2 = {:?}\nrotor_share = 1.0",
        [UR_MOTOR_KG_M2; 8]
    );
    let inertia: toml::Table = inertia.parse().expect("a table");
    config.plant.insert("inertia".to_owned(), inertia.into());
    config
}

/// A job without a fault, in which the robot never waited for a torque; its result is as good as that of the same job in `sim`,
/// where the controller has neither a wire nor a delay.
fn as_good_as_simulated(name: &str) {
    let (job, ur) = robot(name, 30, Trip::Protective);
    let session = job.measure(false, &mut |_| ());
    session.well();
    job.finished(&[&session], &[]);
    let statistics = ur.statistics();
    assert_eq!(
        (
            statistics.programs,
            statistics.silent,
            statistics.limits,
            statistics.after_stop
        ),
        (1, 0, 0, 0)
    );
    session.told("the robot accepts torques");
    let alone = Job::over(&motors(short(name, 30)), Link::Sim);
    let simulated = alone.measure(false, &mut |_| ());
    simulated.well();
    alone.finished(&[&simulated], &[]);
    let of = |job: &Job| serde_json::to_value(job.calibrated().0).expect("JSON");
    let (over_wire, in_simulation) = (of(&job), of(&alone));
    for figure in ["/certificate/expected_error_mm/mean", "/residual/rms_mm"] {
        let of = |summary: &serde_json::Value| summary.pointer(figure).and_then(serde_json::Value::as_f64);
        let (over_wire, in_simulation) = (of(&over_wire).expect("a figure"), of(&in_simulation).expect("a figure"));
        eprintln!("  {name}, {figure}: {over_wire:.4} mm over the wire, {in_simulation:.4} mm in sim");
        assert!(over_wire > 0.0 && over_wire <= 1.2 * in_simulation);
    }
}

// Fails if a job on a UR5e over its own interfaces loses a pose, meets a fault or a stop, lets the robot wait for torques, or
// has a result that is worse than that of `sim` by a fifth.
#[test]
#[ignore = "long: two jobs and their results"]
fn long_thirty_poses_of_a_ur5e_are_as_good_as_simulated_ones() {
    as_good_as_simulated("ur5e");
}

// Fails if that of a UR10e does.
#[test]
#[ignore = "long: another arm"]
fn long_thirty_poses_of_a_ur10e_are_as_good_as_simulated_ones() {
    as_good_as_simulated("ur10e");
}

// Fails if elastic joints ring under torques that act 4 ms late, if friction of 0.5 to 1 N m that the robot does not compensate
// keeps an arm from a pose, or if either costs a pose. Without the low-pass of late torques the arm did not get to its first sphere.
// Without a setpoint that leads a held pose a UR10e with this friction ended turns with `motion_timeout`.
#[test]
#[ignore = "long: 30 poses each of two elastic arms, with and without friction"]
fn long_elastic_arms_neither_ring_nor_stick() {
    for name in ["ur5e", "ur10e"] {
        for coulomb_nm in [None, Some([0.5, 1.0])] {
            let mut config = motors(short(name, 30).on_preset("as_measured"));
            if let Some(limits) = coulomb_nm {
                let friction: toml::Table = format!("coulomb_nm = {limits:?}").parse().expect("a table");
                config.plant.insert("friction".to_owned(), friction.into());
            }
            let ur = Ur::start(&config, Trip::Protective, None);
            let job = Job::new(&config, ur.as_ref());
            let session = job.measure(false, &mut |_| ());
            session.well();
            // Friction that no sensor sees makes the force of the magnet look larger.
            let permitted: &[Fault] = if coulomb_nm.is_some() { &[Fault::Pressing] } else { &[] };
            job.finished(&[&session], permitted);
        }
    }
}

// Fails if a protective stop in some phase of the procedure is not the fault `drive`, is not told in the robot's words, is not
// ended by the dashboard, or the Robot API of PolyScope X, after its five seconds, or costs a pose.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_protective_stop_in_each_phase_is_recovered_from() {
    for software in [None, Some(ControllerVersion::POLYSCOPE_X)] {
        let (job, ur) = robot_with(software, "ur5e", 12, Trip::Protective);
        let session = stops_in_each_phase(&job, &as_robot(&ur), "the robot is stopped (PROTECTIVE_STOP)");
        session.told("asking the robot to end the protective stop");
        assert_eq!(ur.statistics().limits, 0);
    }
}

// Fails if a program that a person stops in some phase is not started again, or costs a pose.
#[test]
#[ignore = "long: all phases"]
fn long_a_stopped_program_is_started_again() {
    let (job, ur) = robot("ur5e", 12, Trip::Program);
    stops_in_each_phase(&job, &as_robot(&ur), "the robot's program has ended");
    assert!(ur.statistics().programs > 9, "{:?}", ur.statistics());
}

// Fails if a safeguard that stops the robot for 2 s ends the job or costs a pose.
#[test]
#[ignore = "long: all phases"]
fn long_a_safeguard_stop_is_waited_for() {
    let (job, ur) = robot("ur5e", 12, Trip::Protective);
    survives(&job, &as_robot(&ur), stop).told("the robot is stopped (SAFEGUARD_STOP)");
}

// Fails if a cable that is out for 3 s ends the job or costs a pose: the program on the robot ends by itself meanwhile.
#[test]
#[ignore = "long: all phases"]
fn long_a_cable_that_is_out_is_waited_for() {
    let (job, ur) = robot("ur5e", 12, Trip::Protective);
    let session = survives(&job, &as_robot(&ur), cable_out);
    session.told("no state from the robot");
    session.told("the robot's program has ended");
    assert!(ur.statistics().silent >= 9, "{:?}", ur.statistics());
}

// Fails if a robot that is switched off for 1 s ends the job or costs a pose.
#[test]
#[ignore = "long: all phases"]
fn long_a_restarted_robot_is_connected_again() {
    let (job, ur) = robot("ur5e", 12, Trip::Protective);
    let session = survives(&job, &as_robot(&ur), restart);
    session.told("the connection to the robot was lost and made again");
}

// Fails if packets that come late, one of twenty in each direction by 2.5 ms, cost more than an attempt now and then, or a pose.
#[test]
#[ignore = "long: a bad network"]
fn long_late_packets_cost_no_pose() {
    let (job, ur) = robot("ur5e", 30, Trip::Protective);
    let faults = ur.world().faults();
    faults.late_us.store(2500, Ordering::Relaxed);
    faults.late.store(500, Ordering::Relaxed);
    let session = job.measure(false, &mut |_| ());
    session.well();
    job.finished(&[&session], &STOPPED);
    let drive = session.well().outcome.drive.expect("a drive");
    assert!(
        drive.missed > drive.cycles / 100,
        "{} of {} missed",
        drive.missed,
        drive.cycles
    );
    eprintln!("  {:?} {:?}", ur.statistics(), session.well().outcome.faults);
}

fn as_robot(ur: &Arc<Ur>) -> Arc<dyn Robot> {
    Arc::clone(ur) as Arc<dyn Robot>
}
