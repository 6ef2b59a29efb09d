//! The robot's rules, period by period, without clock and sockets.

use proptest::prelude::*;
use spherecal_cyclic::JointArm;
use spherecal_fci::robot::*;
use spherecal_fci::wire::*;

/// A strict robot with the simple arm, advanced by hand.
struct Rig {
    supervisor: RobotSupervisor,
    arm: JointArm,
    state: RobotState,
    id: u64,
}

impl Rig {
    fn new(version: Version) -> Self {
        let arm = joint_arm(READY);
        let config = RobotConfig {
            recovery: 3,
            ..RobotConfig::new(version)
        };
        Self {
            supervisor: RobotSupervisor::new(config, arm.state()),
            arm,
            state: RobotState::default(),
            id: 0,
        }
    }

    fn moving(version: Version) -> Self {
        let mut rig = Self::new(version);
        let request = Request::Move(MoveRequest::torque(version));
        assert_eq!(rig.supervisor.request(1, &request), Some(Status::MotionStarted));
        rig
    }

    /// One period with this torque, or without an answer.
    fn period(&mut self, torque: Option<[f64; 7]>) -> &RobotState {
        let answer = torque.map(|t| RobotCommand::torque(self.id, t));
        self.answer(answer.as_ref())
    }

    fn answer(&mut self, answer: Option<&RobotCommand>) -> &RobotState {
        let command = self.supervisor.decide(answer);
        let measured = self.arm.step(command);
        self.supervisor.observe(&measured);
        self.id += 1;
        self.supervisor.fill(self.id, &mut self.state);
        &self.state
    }

    fn reason(&self) -> String {
        self.state.reflex_reason.to_string()
    }
}

fn torque(joint: usize, value: f64) -> [f64; 7] {
    std::array::from_fn(|j| if j == joint { value } else { 0.0 })
}

// Fails if the robot permits more than 1,000 N m/s or punishes 1,000 N m/s, in any joint and direction.
#[test]
fn the_torque_rate_has_a_sharp_limit() {
    for joint in 0..7 {
        for sign in [-1.0, 1.0] {
            let mut rig = Rig::moving(Version::V10);
            for step in 1..=5 {
                assert_eq!(
                    rig.period(Some(torque(joint, sign * f64::from(step)))).robot_mode,
                    RobotMode::Move
                );
            }
            rig.period(Some(torque(joint, sign * 6.001)));
            assert_eq!(rig.state.robot_mode, RobotMode::Reflex);
            assert_eq!(rig.reason(), "controller_torque_discontinuity");
            assert_eq!(rig.supervisor.take_finished()[0].status, Status::ReflexAborted);
        }
    }
}

// Fails if the first command of a motion may jump: the robot starts from zero torque.
#[test]
fn the_first_command_may_not_jump() {
    let mut rig = Rig::moving(Version::V5);
    rig.period(Some(torque(6, 1.5)));
    assert_eq!(rig.reason(), "controller_torque_discontinuity");
}

// Fails if a commanded torque beyond the joint's limit is carried out.
#[test]
fn torques_beyond_the_limit_are_a_reflex() {
    let mut rig = Rig::new(Version::V10);
    let limits = CollisionBehavior::uniform([90.0; 7], [90.0; 7], [90.0; 6], [90.0; 6]);
    assert_eq!(
        rig.supervisor.request(1, &Request::SetCollisionBehavior(limits)),
        Some(Status::Success)
    );
    let motion = Request::Move(MoveRequest::torque(Version::V10));
    assert_eq!(rig.supervisor.request(2, &motion), Some(Status::MotionStarted));
    for step in 1..=12 {
        // The arm is pushed back as hard, so that it does not move.
        rig.arm.external = torque(6, -f64::from(step));
        assert_eq!(rig.period(Some(torque(6, f64::from(step)))).robot_mode, RobotMode::Move);
    }
    rig.period(Some(torque(6, 12.5)));
    assert_eq!(rig.reason(), "tau_j_range_violation");
}

// Fails if 19 missing commands stop the robot or 20 do not; or if the last torque is not repeated meanwhile.
#[test]
fn twenty_missing_commands_stop_the_robot() {
    let mut rig = Rig::moving(Version::V7);
    for _ in 0..200 {
        rig.period(Some(torque(0, 0.5)));
    }
    for _ in 0..19 {
        let state = rig.period(None);
        assert_eq!((state.robot_mode, state.tau_J_d[0]), (RobotMode::Move, 0.5));
    }
    assert!((rig.state.control_command_success_rate - 0.81).abs() < 1e-12);
    for _ in 0..200 {
        rig.period(Some(torque(0, 0.5)));
    }
    assert_eq!(rig.state.control_command_success_rate, 1.0);
    for _ in 0..20 {
        rig.period(None);
    }
    assert_eq!(rig.reason(), "communication_constraints_violation");
    assert_eq!(rig.state.control_command_success_rate, 0.0);
}

// Fails if every fourth command may be missing for ever.
#[test]
fn too_low_a_success_rate_stops_the_robot() {
    let mut rig = Rig::moving(Version::V10);
    for period in 0..1000 {
        rig.period((period % 4 != 0).then_some([0.0; 7]));
    }
    assert_eq!(rig.reason(), "communication_constraints_violation");
    let mut rig = Rig::moving(Version::V10);
    for period in 0..1000 {
        rig.period((period % 20 != 0).then_some([0.0; 7]));
        assert_eq!(rig.state.robot_mode, RobotMode::Move);
    }
}

// Fails if a client that never commands keeps the robot in a motion.
#[test]
fn a_motion_without_a_first_command_ends() {
    let mut rig = Rig::moving(Version::V10);
    let periods = (0..1000)
        .take_while(|_| rig.period(None).robot_mode == RobotMode::Move)
        .count();
    assert_eq!(periods, 99);
    assert_eq!(rig.reason(), "communication_constraints_violation");
}

// Fails if errors do not stay until the recovery, or the reason does not stay until the next motion.
#[test]
fn a_reflex_lasts_until_the_recovery() {
    let mut rig = Rig::moving(Version::V10);
    rig.period(Some(torque(1, 5.0)));
    for _ in 0..50 {
        assert_eq!(rig.period(None).robot_mode, RobotMode::Reflex);
    }
    let again = Request::Move(MoveRequest::torque(Version::V10));
    assert_eq!(rig.supervisor.request(2, &again), Some(Status::NotPossible));
    assert_eq!(rig.supervisor.request(3, &Request::StopMove), Some(Status::NotPossible));
    let _ = rig.supervisor.take_finished();
    assert_eq!(rig.supervisor.request(4, &Request::AutomaticErrorRecovery), None);
    assert_eq!(rig.period(None).robot_mode, RobotMode::AutomaticErrorRecovery);
    assert!(rig.supervisor.take_finished().is_empty());
    rig.period(None);
    let state = rig.period(None);
    assert_eq!((state.robot_mode, state.errors), (RobotMode::Idle, ErrorSet::NONE));
    assert_eq!(rig.reason(), "controller_torque_discontinuity");
    let finished = Finished {
        command: CommandKind::AutomaticErrorRecovery,
        id: 4,
        status: Status::Success,
    };
    assert_eq!(rig.supervisor.take_finished(), [finished]);
    assert_eq!(rig.supervisor.request(5, &again), Some(Status::MotionStarted));
    assert_eq!(rig.period(Some([0.0; 7])).reflex_reason, ErrorSet::NONE);
}

// Fails if a Panda ends a motion by the flag of the FR3, or the other way round.
#[test]
fn the_motion_ends_by_the_flag_of_its_version() {
    for version in Version::ALL.into_iter().filter(|v| v.can_move()) {
        let mut rig = Rig::moving(version);
        rig.period(Some([0.0; 7]));
        let mut bytes = [0; MAX_COMMAND_SIZE];
        let size = RobotCommand::torque(1, [0.0; 7])
            .finished(version)
            .encode(version, &mut bytes);
        let command = RobotCommand::decode(version, &bytes[..size]).expect("a command");
        rig.answer(Some(&command));
        assert_eq!(rig.state.robot_mode, RobotMode::Idle);
        assert_eq!(rig.supervisor.take_finished()[0].status, Status::Success);
    }
}

/// How far a generator's motion turns joint 1, rad, and moves the end effector along y, m.
const WAY: f64 = 0.02;

// Fails if a motion generator with one of the robot's own controllers does not bring the arm where its commands lead, or
// does not end by its flag.
#[test]
fn motion_generators_move_the_arm() {
    use MoveGeneratorMode as G;
    for generator in [
        G::JointPosition,
        G::JointVelocity,
        G::CartesianPosition,
        G::CartesianVelocity,
    ] {
        for controller in [
            MoveControllerMode::JointImpedance,
            MoveControllerMode::CartesianImpedance,
        ] {
            let mut rig = Rig::new(Version::V10);
            let request = MoveRequest {
                controller,
                generator,
                ..MoveRequest::torque(Version::V10)
            };
            let started = rig.supervisor.request(1, &Request::Move(request));
            assert_eq!(started, Some(Status::MotionStarted));
            rig.answer(None);
            let (start, joints) = (rig.state.O_T_EE, rig.state.q_d);
            let (mut pose, mut way) = (start, 0.0);
            for ms in 0..=1000 {
                // From rest to rest: a half wave.
                let part = f64::from(ms) / 1000.0;
                let now = WAY * 0.5 * (1.0 - (std::f64::consts::PI * part).cos());
                let speed = (now - way) / 1e-3;
                way = now;
                pose[13] = start[13] + now;
                let mut command = RobotCommand::torque(rig.state.message_id, [0.0; 7]);
                command.q_c = joints;
                command.q_c[0] += now;
                command.dq_c[0] = speed;
                command.O_T_EE_c = pose;
                command.O_dP_EE_c[1] = speed;
                command.motion_generation_finished = ms == 1000;
                rig.answer(Some(&command));
                assert!(rig.state.errors.is_empty(), "{generator} {ms}: {}", rig.state.errors);
            }
            assert_eq!(rig.supervisor.take_finished()[0].status, Status::Success);
            let moved = match generator {
                G::JointPosition | G::JointVelocity => rig.state.q[0] - joints[0],
                _ => rig.state.O_T_EE[13] - start[13],
            };
            assert!((moved - WAY).abs() < 1e-3, "{generator}: {moved}");
        }
    }
}

// Fails if a request that the robot cannot carry out is accepted.
#[test]
fn impossible_requests_are_refused() {
    let mut rig = Rig::new(Version::V10);
    let mut position = MoveRequest::torque(Version::V10);
    position.controller = MoveControllerMode::JointImpedance;
    assert_eq!(
        rig.supervisor.request(1, &Request::Move(position)),
        Some(Status::InvalidArgument)
    );
    let load = FlangeLoad {
        mass: -1.0,
        centre_of_mass: [0.0; 3],
        inertia: [0.0; 9],
    };
    assert_eq!(
        rig.supervisor.request(2, &Request::SetLoad(load)),
        Some(Status::InvalidArgument)
    );
    let zero = CollisionBehavior::uniform([0.0; 7], [1.0; 7], [1.0; 6], [1.0; 6]);
    assert_eq!(
        rig.supervisor.request(3, &Request::SetCollisionBehavior(zero)),
        Some(Status::InvalidArgument)
    );
    let mut rig = Rig::moving(Version::V10);
    let load = FlangeLoad { mass: 1.0, ..load };
    assert_eq!(
        rig.supervisor.request(4, &Request::SetLoad(load)),
        Some(Status::NotPossible)
    );
    rig.supervisor.set_person(false, true, false);
    let motion = Request::Move(MoveRequest::torque(Version::V10));
    assert_eq!(
        rig.supervisor.request(5, &motion),
        Some(Status::RejectedBySafetyFunction)
    );
}

proptest! {
    // Fails if any sequence of answers, pauses, people and requests panics the robot, lets a torque jump pass, or leaves
    // a torque after a stop.
    #[test]
    fn no_sequence_breaks_the_rules(
        steps in prop::collection::vec((0_u8..10, prop::array::uniform7(-1.03..1.03_f64), any::<[bool; 3]>()), 1..200),
    ) {
        let mut rig = Rig::moving(Version::V10);
        let mut last = [0.0; 7];
        for (what, values, person) in steps {
            match what {
                0 => rig.supervisor.set_person(person[0], person[1], person[2]),
                1 => { let _ = rig.supervisor.request(7, &Request::AutomaticErrorRecovery); }
                2 => { let _ = rig.supervisor.request(8, &Request::Move(MoveRequest::torque(Version::V10))); }
                3 => { let _ = rig.supervisor.request(9, &Request::StopMove); }
                4 => rig.supervisor.client_gone(),
                5 => { rig.period(None); }
                _ => { rig.period(Some(std::array::from_fn(|j| last[j] + values[j]))); }
            }
            rig.period(None);
            let torque = rig.state.tau_J_d;
            if rig.state.robot_mode == RobotMode::Move {
                prop_assert!(rig.state.errors.is_empty());
                // Two periods passed at most since the last look.
                prop_assert!((0..7).all(|j| (torque[j] - last[j]).abs() <= 2.001) || torque == [0.0; 7]);
            } else {
                prop_assert_eq!(torque, [0.0; 7]);
            }
            last = torque;
        }
    }
}
