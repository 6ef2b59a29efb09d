//! The cabinet's rules, period by period, without clock and socket.

use proptest::prelude::*;
use spherecal_cyclic::JointArm;
use spherecal_fri::robot::*;
use spherecal_fri::wire::*;

struct Rig {
    cabinet: Cabinet,
    arm: JointArm,
    newest: MonitoringMessage,
    sequence: u32,
}

impl Rig {
    fn new(config: CabinetConfig) -> Self {
        let arm = joint_arm(START);
        let mut cabinet = Cabinet::new(config, arm.state());
        let newest = cabinet.message(&arm.state());
        Self {
            cabinet,
            arm,
            newest,
            sequence: 0,
        }
    }

    /// The answer that the rules ask for, with this overlay while commanding.
    fn good_answer(&mut self, overlay: [f64; 7]) -> CommandMessage {
        let ipo = self.newest.ipo.and_then(|i| i.joint_position);
        let active = self.newest.connection.session == SessionState::CommandingActive;
        self.sequence += 1;
        CommandMessage {
            sequence: self.sequence,
            reflected_sequence: self.newest.sequence,
            joint_position: ipo.or(self.newest.commanded_position),
            joint_torque: ipo.map(|_| if active { overlay } else { [0.0; 7] }),
            ..CommandMessage::default()
        }
    }

    fn period(&mut self, answer: Option<&CommandMessage>) -> SessionState {
        let command = self.cabinet.decide(answer);
        let state = self.arm.step(command, 1e-3);
        self.newest = self.cabinet.message(&state);
        self.newest.connection.session
    }

    fn good(&mut self) -> SessionState {
        let answer = self.good_answer([0.0; 7]);
        self.period(Some(&answer))
    }

    /// A session that commands.
    fn commanding() -> Self {
        let mut rig = Self::new(CabinetConfig::new());
        rig.cabinet.set_controls(true, SafetyState::NormalOperation, false);
        for _ in 0..110 {
            rig.good();
        }
        assert_eq!(rig.newest.connection.session, SessionState::CommandingActive);
        rig
    }
}

// Fails if the session rises without answers, without the application, or without mirrored positions.
#[test]
fn the_session_rises_step_by_step() {
    let mut rig = Rig::new(CabinetConfig::new());
    for _ in 0..200 {
        assert_eq!(rig.period(None), SessionState::MonitoringWait);
    }
    let waits = (0..500)
        .take_while(|_| rig.good() == SessionState::MonitoringWait)
        .count();
    // 75 of the last 100 answers.
    assert_eq!(waits, 74);
    for _ in 0..100 {
        assert_eq!(rig.good(), SessionState::MonitoringReady);
    }
    rig.cabinet.set_controls(true, SafetyState::NormalOperation, false);
    assert_eq!(rig.good(), SessionState::CommandingWait);
    assert_eq!(rig.newest.robot.drives, Some([DriveState::Active; 7]));
    assert_eq!(rig.newest.robot.control, Some(ControlMode::JointImpedance));
    let waits = (0..500)
        .take_while(|_| rig.good() == SessionState::CommandingWait)
        .count();
    assert_eq!(waits, 49);
    assert_eq!(rig.newest.connection.session, SessionState::CommandingActive);
}

// Fails if a session goes on although every second answer is missing, or ends although one in ten is.
#[test]
fn the_quality_decides() {
    let mut rig = Rig::commanding();
    for period in 0..1000 {
        let answer = (period % 10 != 0).then(|| rig.good_answer([0.0; 7]));
        assert_eq!(rig.period(answer.as_ref()), SessionState::CommandingActive);
    }
    assert_eq!(rig.cabinet.quality(), Quality::Excellent);
    let mut periods = 0;
    while rig.newest.connection.session == SessionState::CommandingActive {
        let answer = (periods % 2 != 0).then(|| rig.good_answer([0.0; 7]));
        rig.period(answer.as_ref());
        periods += 1;
    }
    assert_eq!(rig.newest.connection.session, SessionState::MonitoringWait);
    assert!(periods > 20 && periods < 60, "{periods}");
    // Brakes closed, and no new motion before the application asks for one.
    assert_eq!(rig.newest.robot.drives, Some([DriveState::Off; 7]));
    for _ in 0..300 {
        assert!(rig.good() < SessionState::CommandingWait);
    }
    rig.cabinet.set_controls(false, SafetyState::NormalOperation, false);
    rig.good();
    rig.cabinet.set_controls(true, SafetyState::NormalOperation, false);
    rig.good();
    assert_eq!(rig.good(), SessionState::CommandingWait);
}

// Fails if a missing answer drops the overlay, or the last one is not repeated.
#[test]
fn a_missing_overlay_repeats_the_last() {
    let mut rig = Rig::commanding();
    let overlay = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.02];
    let answer = rig.good_answer(overlay);
    rig.period(Some(&answer));
    for _ in 0..5 {
        rig.period(None);
        assert_eq!(rig.newest.commanded_torque, Some(overlay));
    }
}

// Fails if a command that a cabinet must not carry out is carried out.
#[test]
fn bad_commands_end_the_motion() {
    type Change = fn(&mut CommandMessage);
    let changes: [Change; 5] = [
        |c| c.joint_torque = None,
        |c| c.joint_position = None,
        |c| c.joint_torque = Some([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 40.5]),
        |c| c.joint_torque = Some([-177.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        |c| c.joint_position = Some([1.0; 7]),
    ];
    for change in changes {
        let mut rig = Rig::commanding();
        let mut answer = rig.good_answer([0.0; 7]);
        change(&mut answer);
        assert_eq!(rig.period(Some(&answer)), SessionState::MonitoringReady);
        assert_eq!(rig.newest.commanded_torque, Some([0.0; 7]));
    }
    // While waiting, a position that is not mirrored ends it, and torques that are not zero do not count.
    let mut rig = Rig::new(CabinetConfig::new());
    rig.cabinet.set_controls(true, SafetyState::NormalOperation, false);
    while rig.good() != SessionState::CommandingWait {}
    for _ in 0..200 {
        let mut answer = rig.good_answer([0.0; 7]);
        answer.joint_torque = Some([1.0; 7]);
        assert_eq!(rig.period(Some(&answer)), SessionState::CommandingWait);
    }
    rig.good();
    let mut answer = rig.good_answer([0.0; 7]);
    answer.joint_position = Some(START.map(|q| q + 1e-3));
    assert_eq!(rig.period(Some(&answer)), SessionState::MonitoringReady);
}

// Fails if a safety stop does not close the brakes at once.
#[test]
fn a_safety_stop_closes_the_brakes() {
    let mut rig = Rig::commanding();
    rig.arm.external = [5.0; 7];
    rig.cabinet.set_controls(true, SafetyState::StopLevel2, false);
    assert_eq!(rig.good(), SessionState::MonitoringReady);
    let stopped = rig.newest.measured_position;
    for _ in 0..100 {
        rig.good();
    }
    assert_eq!(rig.newest.measured_position, stopped);
    assert_eq!(rig.newest.robot.safety, Some(SafetyState::StopLevel2));
}

// Fails if the quality counts answers that are not due.
#[test]
fn each_nth_answer_counts() {
    let config = CabinetConfig {
        receive_multiplier: 5,
        ..CabinetConfig::new()
    };
    let mut rig = Rig::new(config);
    for period in 0..2000 {
        let answer = (period % 5 == 4).then(|| rig.good_answer([0.0; 7]));
        rig.period(answer.as_ref());
    }
    assert_eq!(rig.cabinet.quality(), Quality::Excellent);
    assert_eq!(rig.newest.connection.receive_multiplier, Some(5));
}

// Fails if the cabinet's clock does not follow its messages, or its counters do not wrap.
#[test]
fn the_clock_follows_the_messages() {
    let mut rig = Rig::new(CabinetConfig {
        send_period_ms: 10,
        ..CabinetConfig::new()
    });
    for _ in 0..250 {
        rig.good();
    }
    assert_eq!(rig.newest.sequence, 250);
    assert_eq!(
        rig.newest.time,
        Some(Timestamp {
            sec: 2,
            nanosec: 500_000_000
        })
    );
    assert_eq!(rig.newest.reflected_sequence, 250);
}

proptest! {
    // Fails if any sequence of answers, controls and pauses panics the cabinet, moves the arm by an overlay outside
    // COMMANDING_ACTIVE, or makes a message that cannot be read.
    #[test]
    fn no_sequence_breaks_the_rules(
        steps in prop::collection::vec((0_u8..12, prop::array::uniform7(-60.0..60.0_f64), 0_u64..4), 1..400),
    ) {
        let mut rig = Rig::new(CabinetConfig::new());
        rig.cabinet.set_controls(true, SafetyState::NormalOperation, false);
        for _ in 0..90 {
            rig.good();
        }
        for (what, values, level) in steps {
            match what {
                0 => {
                    let safety = SafetyState::from_number(level).expect("a level");
                    rig.cabinet.set_controls(level < 2, safety, level == 1);
                }
                1 => { rig.period(None); }
                2 => {
                    let answer = CommandMessage { joint_torque: Some(values), ..CommandMessage::default() };
                    rig.period(Some(&answer));
                }
                3 => {
                    let mut answer = rig.good_answer(values);
                    answer.joint_position = Some(values);
                    rig.period(Some(&answer));
                }
                _ => {
                    let answer = rig.good_answer(values);
                    rig.period(Some(&answer));
                }
            }
            if rig.newest.connection.session != SessionState::CommandingActive {
                prop_assert_eq!(rig.newest.commanded_torque, Some([0.0; 7]));
            }
            let mut bytes = [0; MAX_MESSAGE_SIZE];
            let size = rig.newest.encode(&mut bytes, false);
            let read = size.and_then(|s| MonitoringMessage::decode(&bytes[..s]));
            prop_assert_eq!(read, Ok(rig.newest));
        }
    }
}
