//! The client against single messages of a cabinet that the test plays itself.

use std::net::UdpSocket;
use std::time::Duration;

use crate::common::on_this_machine;
use spherecal_cyclic::testing::LOCAL;
use spherecal_fri::client::{Client, ClientError, EndCause, MonitoredState, ReadOnlyClient};
use spherecal_fri::wire::*;

/// A cabinet of one message at a time.
struct Cabinet {
    udp: UdpSocket,
    message: MonitoringMessage,
}

impl Cabinet {
    fn before(client: std::net::SocketAddr) -> Self {
        let udp = UdpSocket::bind(LOCAL).expect("a port");
        udp.connect(client).expect("an address");
        udp.set_read_timeout(Some(Duration::from_millis(300)))
            .expect("a socket");
        let message = MonitoringMessage {
            sequence: 1000,
            reflected_sequence: 0,
            robot: RobotInfo {
                number_of_joints: Some(7),
                safety: Some(SafetyState::NormalOperation),
                drives: Some([DriveState::Active; 7]),
                operation: Some(OperationMode::T1),
                control: Some(ControlMode::JointImpedance),
            },
            measured_position: [0.1; 7],
            measured_torque: [0.0; 7],
            commanded_position: Some([0.2; 7]),
            commanded_torque: None,
            external_torque: None,
            time: None,
            connection: ConnectionInfo {
                session: SessionState::MonitoringReady,
                quality: Quality::Excellent,
                send_period_ms: Some(1),
                receive_multiplier: Some(1),
            },
            ipo: None,
            end: None,
        };
        Self { udp, message }
    }

    fn session(&mut self, session: SessionState) {
        self.message.connection.session = session;
        let commanding = session >= SessionState::CommandingWait;
        self.message.ipo = commanding.then_some(IpoData {
            joint_position: Some([0.3; 7]),
            command_mode: Some(ClientCommandMode::Torque),
            overlay: Some(OverlayType::Joint),
            tracking_performance: None,
        });
    }

    /// Sends the message with the next sequence number.
    fn send(&mut self) {
        self.message.sequence = self.message.sequence.wrapping_add(1);
        self.repeat();
    }

    fn repeat(&self) {
        let mut bytes = [0; MAX_MESSAGE_SIZE];
        let size = self.message.encode(&mut bytes, false).expect("it fits");
        self.udp.send(&bytes[..size]).expect("a client");
    }

    /// The client's answer; `None` if it sends none.
    fn answer(&self) -> Option<CommandMessage> {
        let mut bytes = [0; MAX_MESSAGE_SIZE];
        let size = self.udp.recv(&mut bytes).ok()?;
        Some(CommandMessage::decode(&bytes[..size]).expect("a command"))
    }
}

fn client() -> (Client, Cabinet) {
    let client = Client::listen(&on_this_machine()).expect("a client");
    let cabinet = Cabinet::before(client.address().expect("an address"));
    (client, cabinet)
}

// Fails if a state of the session gets another answer than documented: which position, which torques, or none at all.
#[test]
fn each_session_state_has_its_answer() {
    use SessionState as S;
    let all = [
        S::Idle,
        S::MonitoringWait,
        S::MonitoringReady,
        S::CommandingWait,
        S::CommandingActive,
    ];
    let mut observer = ReadOnlyClient::listen(&on_this_machine()).expect("an observer");
    let mut cabinet = Cabinet::before(observer.address().expect("an address"));
    let mut state = MonitoredState::default();
    for session in all {
        cabinet.session(session);
        cabinet.send();
        observer.receive(&mut state).expect("a message");
        let monitoring = matches!(session, S::MonitoringWait | S::MonitoringReady);
        let answer = cabinet.answer();
        assert_eq!(answer.is_some(), monitoring, "{session}");
        if let Some(answer) = answer {
            assert_eq!((answer.joint_position, answer.joint_torque), (Some([0.2; 7]), None));
            assert_eq!(answer.reflected_sequence, cabinet.message.sequence);
        }
    }

    let law = |_: &MonitoredState| [0.5; 7];
    let (mut client, mut cabinet) = self::client();
    for session in all {
        cabinet.session(session);
        cabinet.send();
        client.exchange(&mut state, law).expect("a message");
        assert_eq!(
            cabinet.answer().is_some(),
            matches!(session, S::MonitoringWait | S::MonitoringReady),
            "{session}"
        );
    }
    let (mut client, mut cabinet) = self::client();
    let mut sequence = None;
    for session in all {
        cabinet.session(session);
        if session == S::MonitoringReady {
            client.enable().expect("a robot that may move");
        }
        cabinet.send();
        client.exchange(&mut state, law).expect("a message");
        let Some(answer) = cabinet.answer() else {
            assert_eq!(session, S::Idle);
            continue;
        };
        let expected = match session {
            S::CommandingWait => (Some([0.3; 7]), Some([0.0; 7])),
            S::CommandingActive => (Some([0.3; 7]), Some([0.5; 7])),
            _ => (Some([0.2; 7]), None),
        };
        assert_eq!((answer.joint_position, answer.joint_torque), expected, "{session}");
        assert_eq!(answer.reflected_sequence, cabinet.message.sequence);
        // The client counts its own messages.
        assert!(sequence.is_none_or(|s: u32| s + 1 == answer.sequence));
        sequence = Some(answer.sequence);
    }
}

// Fails if repeated or reordered messages are answered or move the state back, or a gap is a jump of the velocity.
#[test]
fn gaps_and_repetitions_are_told_apart() {
    let (mut client, mut cabinet) = client();
    let mut state = MonitoredState::default();
    let speed = 0.3;
    for k in 0..300_u32 {
        // Every seventh step jumps over four messages.
        let gap = if k % 7 == 3 { 4 } else { 0 };
        cabinet.message.sequence += gap;
        cabinet.message.measured_position = [speed * 1e-3 * f64::from(cabinet.message.sequence + 1 - 1000); 7];
        cabinet.send();
        let cycle = client.exchange(&mut state, |_| [0.0; 7]).expect("a message");
        assert!(cabinet.answer().is_some());
        if k > 0 {
            assert_eq!(cycle.missed, u64::from(gap), "{k}");
        }
        if k > 100 {
            assert!((state.dq[5] - speed).abs() < 1e-9, "{}", state.dq[5]);
        }
    }
    let before = client.statistics();
    assert_eq!((before.messages, before.missed, before.longest_gap), (300, 43 * 4, 4));
    // The same once more, then an older one, then a new one.
    let newest = cabinet.message.sequence;
    cabinet.repeat();
    cabinet.message.sequence -= 5;
    cabinet.repeat();
    cabinet.message.sequence = newest;
    cabinet.send();
    client.exchange(&mut state, |_| [0.0; 7]).expect("a message");
    assert_eq!(state.message.sequence, newest + 1);
    let after = client.statistics();
    assert_eq!((after.stale, after.messages, after.missed), (2, 301, before.missed));
    assert_eq!(cabinet.answer().expect("an answer").reflected_sequence, newest + 1);
    assert!(cabinet.answer().is_none());
}

// Fails if commands that the cabinet did not receive are not counted.
#[test]
fn lost_commands_are_counted_by_the_reflected_counter() {
    let (mut client, mut cabinet) = client();
    let mut state = MonitoredState::default();
    let mut reflected = Vec::new();
    for k in 0..20 {
        cabinet.send();
        client.exchange(&mut state, |_| [0.0; 7]).expect("a message");
        let answer = cabinet.answer().expect("an answer");
        // The cabinet does not see the answers 5, 6 and 7.
        if !(5..8).contains(&k) {
            cabinet.message.reflected_sequence = answer.sequence;
            reflected.push(answer.sequence);
        }
    }
    assert_eq!(client.statistics().commands_lost, 3);
    assert_eq!(reflected.len(), 17);
}

// Fails if what forbids commanding is not named: a safety state that is not sent, drives, command mode.
#[test]
fn what_forbids_commanding_is_named() {
    type Change = fn(&mut MonitoringMessage);
    let cases: [(Change, EndCause); 5] = [
        (|m| m.robot.safety = None, EndCause::SafetyUnknown),
        (
            |m| m.robot.safety = Some(SafetyState::StopLevel0),
            EndCause::SafetyStop(SafetyState::StopLevel0),
        ),
        (|m| m.robot.drives = Some([DriveState::Off; 7]), EndCause::DrivesOff),
        (
            |m| m.ipo.as_mut().expect("ipo").command_mode = Some(ClientCommandMode::Position),
            EndCause::CommandMode(ClientCommandMode::Position),
        ),
        (|m| m.sequence = 3, EndCause::Restarted),
    ];
    for (change, cause) in cases {
        let (mut client, mut cabinet) = client();
        let mut state = MonitoredState::default();
        cabinet.send();
        client.exchange(&mut state, |_| [0.0; 7]).expect("a message");
        client.enable().expect("a robot that may move");
        cabinet.session(SessionState::CommandingActive);
        cabinet.send();
        assert!(client.exchange(&mut state, |_| [0.0; 7]).expect("a message").commanded);
        change(&mut cabinet.message);
        cabinet.send();
        let ended = client.exchange(&mut state, |_| [0.0; 7]);
        let Err(ClientError::Ended(end)) = ended else {
            panic!("{ended:?}")
        };
        assert_eq!(end.cause, cause);
        assert!(!client.is_enabled());
    }
    let (mut client, mut cabinet) = client();
    cabinet.message.robot.safety = None;
    cabinet.send();
    client
        .exchange(&mut MonitoredState::default(), |_| [0.0; 7])
        .expect("a message");
    assert!(matches!(
        client.enable(),
        Err(ClientError::NotReady(EndCause::SafetyUnknown))
    ));
}

// Fails if bytes that are no message, or that come from another host, reach the control law.
#[test]
fn other_datagrams_do_not_reach_the_law() {
    let mut settings = on_this_machine();
    settings.cabinet = Some([127, 0, 0, 2].into());
    settings.timeout = Duration::from_millis(50);
    let mut client = Client::listen(&settings).expect("a client");
    let mut cabinet = Cabinet::before(client.address().expect("an address"));
    cabinet.send();
    let silent = client.exchange(&mut MonitoredState::default(), |_| [0.0; 7]);
    assert!(matches!(silent, Err(ClientError::Silent { .. })), "{silent:?}");
    assert_eq!(client.statistics().foreign, 1);

    let (mut client, cabinet) = self::client();
    cabinet.udp.send(&[1, 2, 3]).expect("a client");
    let wire = client.exchange(&mut MonitoredState::default(), |_| [0.0; 7]);
    assert!(matches!(wire, Err(ClientError::Wire(_))), "{wire:?}");
}
