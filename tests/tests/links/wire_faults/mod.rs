//! Whole jobs over the robots' own wires (Franka's FCI, KUKA's FRI, RTDE of Universal Robots), with faults in the middle:
//! network, robot, persons.
//!
//! ```text
//!   job ─ campaign ─ controller ─ drive ──▶ network that fails ──▶ robot side ─ simulated arm
//!    └ script: what happens in which phase ─────────┴──────────────────┘
//! ```
//!
//! Each fault must end as `docs/recovery.md` says: the job goes on by itself and records every pose, or it stops with the
//! fault and its remedy, and a second session finishes it. No acknowledged recording may be lost or stored twice, and no
//! command may reach the robot between a stop and the next motion.
//!
//! Robot, network, controller and host are in one process on a virtual clock (`spherecal_cyclic::testing::World`): a test
//! has one course of events, whatever the machine does beside it. The robots do not wait for an answer, as real ones do
//! not; only those behind a bad network wait for up to 30 ms, because there a real robot would stop again and again. What
//! needs the wall clock is in `real_time`.

mod job;
mod real_time;
mod robots;
mod universal_robots;

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use spherecal_fci::wire::Version;
use spherecal_shared::protocol::host::{Fault, Phase};

use job::{Job, Now, Session, short};
use robots::{Franka, Kuka, Robot};

/// What the recovery table lets a stop of the robot, or states that stay away, become.
const STOPPED: [Fault; 3] = [Fault::Drive, Fault::StaleState, Fault::Overrun];

/// A robot that does not wait.
const STRICT: Duration = Duration::ZERO;
/// One that waits for a late answer.
const PATIENT: Duration = Duration::from_millis(30);

/// A job on a Panda (version 5) or an FR3, which waits for `patience` for an answer.
fn franka(version: Version, poses: usize, patience: Duration) -> (Job, Arc<dyn Robot>) {
    let config = short(version.robot(), poses);
    let robot = Franka::start(&config, version, patience);
    (Job::new(&config, robot.as_ref()), robot)
}

fn panda(poses: usize) -> (Job, Arc<dyn Robot>) {
    franka(Version::V5, poses, STRICT)
}

fn fr3(poses: usize) -> (Job, Arc<dyn Robot>) {
    franka(Version::V10, poses, STRICT)
}

fn iiwa(poses: usize, patience: Duration) -> (Job, Arc<dyn Robot>) {
    let config = short("iiwa7", poses);
    let robot = Kuka::start(&config, patience);
    (Job::new(&config, robot.as_ref()), robot)
}

/// Something that happens to a robot. It does not wait: what comes later is planned.
type Happens = fn(&Arc<dyn Robot>);

/// Lets something happen in each of these phases, in any order, once: as the phase begins and the arm follows torques.
/// Between two recordings at most two things happen, and on the way to the first sphere one: the host gives up after three
/// attempts in vain, and what lasts for seconds costs more than one.
struct Script {
    robot: Arc<dyn Robot>,
    left: Vec<(Phase, Happens)>,
    since: usize,
    recorded: usize,
}

impl Script {
    fn new(robot: &Arc<dyn Robot>, what: &[(Phase, Happens)]) -> Self {
        Self {
            robot: Arc::clone(robot),
            left: what.to_vec(),
            since: 0,
            recorded: 0,
        }
    }

    fn at(&mut self, now: Now) {
        if now.recorded > self.recorded {
            (self.recorded, self.since) = (now.recorded, 0);
        }
        let most = if self.recorded == 0 { 1 } else { 2 };
        let next = self.left.iter().position(|(phase, _)| *phase == now.phase);
        if let Some(next) = next.filter(|_| self.since < most && self.robot.is_moving()) {
            let (phase, happens) = self.left.swap_remove(next);
            eprintln!("  {phase:?}: it happens");
            self.since += 1;
            happens(&self.robot);
        }
    }
}

/// Runs the job with this in each phase; it must record all, and no command may follow a stop.
fn survives(job: &Job, robot: &Arc<dyn Robot>, what: Happens) -> Session {
    let mut script = Script::new(robot, &PHASES.map(|phase| (phase, what)));
    let session = job.measure(false, &mut |now| script.at(now));
    session.well();
    job.finished(&[&session], &STOPPED);
    assert!(
        script.left.is_empty(),
        "never came: {:?}",
        script.left.iter().map(|l| l.0).collect::<Vec<_>>()
    );
    assert_eq!(robot.counts().after_stop, 0);
    session
}

/// Every phase in which the arm follows torques.
const PHASES: [Phase; 9] = [
    Phase::Idle,
    Phase::Moving,
    Phase::Taring,
    Phase::Approaching,
    Phase::Coupling,
    Phase::Verifying,
    Phase::Turning,
    Phase::Recording,
    Phase::Decoupling,
];

/// Undoes something after this time.
fn later(robot: &Arc<dyn Robot>, seconds: u64, what: fn(&dyn Robot)) {
    let later = Arc::clone(robot);
    robot
        .world()
        .after(Duration::from_secs(seconds), move || what(later.as_ref()));
}

fn trip(robot: &Arc<dyn Robot>) {
    robot.trip();
}

/// Pressed for 2 s.
fn stop(robot: &Arc<dyn Robot>) {
    robot.stop(true);
    later(robot, 2, |robot| robot.stop(false));
}

/// Out for 3 s.
fn cable_out(robot: &Arc<dyn Robot>) {
    robot.world().faults().cable_out.store(true, Ordering::Relaxed);
    later(robot, 3, |robot| {
        robot.world().faults().cable_out.store(false, Ordering::Relaxed);
    });
}

/// Off for 1 s.
fn restart(robot: &Arc<dyn Robot>) {
    robot.switch(false);
    later(robot, 1, |robot| robot.switch(true));
}

/// The robot ends its motion in each phase. Each end is the fault `drive`, and `words` are the robot's own.
fn stops_in_each_phase(job: &Job, robot: &Arc<dyn Robot>, words: &str) -> Session {
    let session = survives(job, robot, trip);
    session.told(words);
    let drive = session.well().outcome.drive.expect("a drive");
    assert!(drive.stops >= PHASES.len() as u64, "{} stops", drive.stops);
    let faults = &session.well().outcome.faults;
    let named = faults.iter().filter(|report| report.fault == Fault::Drive).count();
    assert!(named >= PHASES.len(), "{faults:?}");
    session
}

// Fails if a reflex in some phase of the procedure is not the fault `drive`, is not named, is not recovered from, or costs
// a recording.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_reflex_in_each_phase_is_recovered_from() {
    let (job, robot) = panda(8);
    let session = stops_in_each_phase(&job, &robot, "joint_reflex");
    let drive = session.well().outcome.drive.expect("a drive");
    assert!(
        drive.recoveries >= PHASES.len() as u64,
        "{} recoveries",
        drive.recoveries
    );
}

// Fails if a job in which the robot stops has two courses: then a failure of these tests could not be repeated.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_one_job_has_one_course() {
    let course = || {
        let (job, robot) = fr3(3);
        let mut script = Script::new(&robot, &[(Phase::Moving, cable_out), (Phase::Recording, trip)]);
        job.measure(false, &mut |now| script.at(now)).well();
        let stored = job.stored();
        (stored.recordings, stored.faults)
    };
    let first = course();
    assert!(first.1.len() >= 2, "{:?}", first.1);
    assert_eq!(first, course());
}

// Fails if the end of the application's motion in some phase is not the fault `drive`, is not named, or costs a recording.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_session_that_falls_in_each_phase_is_recovered_from() {
    let (job, robot) = iiwa(8, STRICT);
    stops_in_each_phase(
        &job,
        &robot,
        "the session went from COMMANDING_ACTIVE to MONITORING_READY",
    );
}

// Fails if the user stop is not the fault `drive`, is not named, or the job does not go on once it is released.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_the_user_stop_is_waited_for() {
    let (job, robot) = fr3(12);
    survives(&job, &robot, stop).told("the user stop was pressed");
}

// Fails if a safety stop is not the fault `drive`, is not named with its level, or the job does not go on after it.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_safety_stop_is_waited_for() {
    let (job, robot) = iiwa(12, STRICT);
    survives(&job, &robot, stop).told("safety stop (");
}

/// The cable is out for 3 s; the robot stops by itself and says so by `words`.
fn cable(job: &Job, robot: &Arc<dyn Robot>, words: &str) {
    let session = survives(job, robot, cable_out);
    session.told("no state from the robot");
    session.told("the robot sends states again");
    session.told(words);
}

// Fails if a cable that is out for 3 s ends the job, is not named, or costs a recording.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_cable_that_is_out_is_waited_for_by_franka() {
    let (job, robot) = fr3(12);
    cable(&job, &robot, "communication_constraints_violation");
}

// Fails if the same does not hold for KUKA.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_cable_that_is_out_is_waited_for_by_kuka() {
    let (job, robot) = iiwa(12, STRICT);
    cable(&job, &robot, "commanding ended");
}

// Fails if a robot that restarts ends the job, is not connected again, or costs a recording.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_restarted_franka_is_connected_again() {
    let (job, robot) = panda(12);
    let session = survives(&job, &robot, restart);
    session.told("the connection to the robot was lost and made again");
    assert!(
        session
            .well()
            .outcome
            .drive
            .is_some_and(|drive| drive.reconnects >= PHASES.len() as u64)
    );
}

// Fails if a cabinet that restarts ends the job, is commanded without a new permission, or costs a recording.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_restarted_cabinet_is_commanded_again() {
    let (job, robot) = iiwa(12, STRICT);
    survives(&job, &robot, restart).told("the cabinet was restarted");
}

/// A network that loses 1 % of the datagrams until a pose is recorded, delays them by up to 2 ms while the arm turns to the
/// second one and records it, and loses 5 % while it turns and records after that.
fn bad_network(job: &Job, robot: &Arc<dyn Robot>) {
    let faults = robot.world().faults();
    let session = job.measure(false, &mut |now| {
        let pose = matches!(now.phase, Phase::Turning | Phase::Recording);
        let (loss, jitter_us) = match now.recorded {
            0 => (100, 0),
            1 if pose => (0, 2000),
            2.. if pose => (500, 0),
            _ => (0, 0),
        };
        faults.loss.store(loss, Ordering::Relaxed);
        faults.jitter_us.store(jitter_us, Ordering::Relaxed);
    });
    session.well();
    job.finished(&[&session], &STOPPED);
    assert_eq!(robot.counts().after_stop, 0);
    let (lost, missing) = (faults.lost.load(Ordering::Relaxed), robot.counts().missing);
    let (summary, report) = job.calibrated();
    let drive = summary.drive.expect("a drive");
    let met = &session.well().outcome.faults;
    eprintln!(
        "  {lost} lost, {missing} missing, {} missed, faults {met:?}",
        drive.missed
    );
    // Each datagram that was lost while torques were due is a period that the robot waited in vain, and half of them are
    // periods that the drive missed.
    assert!(lost > 100 && missing > lost / 2, "{missing} of {lost}");
    assert!(drive.missed > lost / 4, "{} of {lost}", drive.missed);
    assert!(report.contains(&format!("{} periods missed", drive.missed)));
}

// Fails if lost and late datagrams end the job, cost a recording, or are not in the counts and the report.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_bad_network_before_a_franka_costs_nothing() {
    let (job, robot) = franka(Version::V10, 3, PATIENT);
    bad_network(&job, &robot);
}

// Fails if the same does not hold for KUKA.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_bad_network_before_a_cabinet_costs_nothing() {
    let (job, robot) = iiwa(3, PATIENT);
    bad_network(&job, &robot);
}

/// A stop that nobody releases ends the job with the fault and its remedy; a second session finishes it.
fn gives_up(job: &Job, robot: &Arc<dyn Robot>) {
    let first = job.measure(false, &mut |now| {
        if now.recorded == 1 {
            robot.stop(true);
        }
    });
    let error = match &first.result {
        Ok(_) => panic!("the job went on"),
        Err(error) => error.to_string(),
    };
    assert!(
        error.contains("drive") && error.contains("release the emergency stop and enable the drives"),
        "{error}"
    );
    assert!(!job.nothing_is_lost(&[&first]).is_empty());
    assert!(!robot.is_moving());
    robot.stop(false);
    let second = job.measure(true, &mut |_| ());
    second.well();
    job.finished(&[&first, &second], &STOPPED);
    assert_eq!(robot.counts().after_stop, 0);
}

// Fails if a user stop that stays pressed does not end the job with its remedy, or `--resume` does not finish it.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_user_stop_for_good_ends_the_job_and_another_session_finishes_it() {
    let (job, robot) = panda(4);
    gives_up(&job, &robot);
}

// Fails if the same does not hold for KUKA's safety stop.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_safety_stop_for_good_ends_the_job_and_another_session_finishes_it() {
    let (job, robot) = iiwa(4, STRICT);
    gives_up(&job, &robot);
}
