//! The drive over KUKA's Fast Robot Interface against the simulated cabinet.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use spherecal_cyclic::testing::World;
use spherecal_cyclic::{JointArm, Machine, this_machine};
use spherecal_fri::client::{ClientConfig, EndCause, TorqueLimits};
use spherecal_fri::robot::{
    ArmCommand, ArmHardware, ArmState, CabinetConfig, CabinetSide, START, Tolerance, joint_arm, start_cabinet,
};
use spherecal_fri::wire::SafetyState;
use spherecal_link::native::{DriveEvent, KukaDrive, KukaOptions, Undeclared};
use spherecal_link::{Drive, LinkError};
use spherecal_shared::Joints;
use spherecal_shared::protocol::drive::{DriveCommand, DriveState, DriveStatus, TorqueSign};
use spherecal_shared::robot::{self as shared, Dynamics as _, iiwa7, iiwa7_tool};

/// What no test waits longer for.
const PATIENCE: Duration = Duration::from_secs(30);

/// An arm whose sensors show the gravity of an iiwa 7 with the calibration tool.
struct Iiwa {
    joints: JointArm,
    model: shared::Arm<f64, 7>,
    /// How much of the gravity the sensors show.
    share: f64,
}

impl Iiwa {
    fn new(share: f64) -> Self {
        let mut joints = joint_arm(START);
        joints.gravity = [0.0; 7];
        Self {
            joints,
            model: shared::Arm::new(&iiwa7(), &iiwa7_tool()).expect("an arm"),
            share,
        }
    }

    fn with_gravity(&self, mut state: ArmState) -> ArmState {
        let gravity = self.model.bodies(&self.model.frames(&state.q)).gravity();
        for (tau, gravity) in state.tau.iter_mut().zip(gravity.iter()) {
            *tau += self.share * gravity;
        }
        state
    }
}

impl ArmHardware for Iiwa {
    fn state(&self) -> ArmState {
        self.with_gravity(self.joints.state())
    }

    fn step(&mut self, command: ArmCommand, step_s: f64) -> ArmState {
        let state = self.joints.step(command, step_s);
        self.with_gravity(state)
    }
}

/// A cabinet for a client at a free port, and that port. It does not wait, as a real one does not.
fn cabinet(machine: &Arc<dyn Machine>, sign: f64, share: f64) -> (CabinetSide, SocketAddr) {
    cabinet_with(machine, sign, share, Tolerance::strict())
}

fn cabinet_with(machine: &Arc<dyn Machine>, sign: f64, share: f64, tolerance: Tolerance) -> (CabinetSide, SocketAddr) {
    let probe = machine.datagrams((Ipv4Addr::LOCALHOST, 0).into()).expect("a free port");
    let client = probe.address().expect("an address");
    drop(probe);
    let config = CabinetConfig {
        machine: Arc::clone(machine),
        client,
        tolerance,
        measured_sign: sign,
        ..CabinetConfig::new()
    };
    (
        start_cabinet(config, Box::new(Iiwa::new(share))).expect("a cabinet"),
        client,
    )
}

fn listen(machine: &Arc<dyn Machine>, address: SocketAddr) -> Result<KukaDrive, LinkError> {
    let config = ClientConfig {
        machine: Arc::clone(machine),
        address,
        timeout: Duration::from_millis(500),
        ..ClientConfig::new(TorqueLimits::IIWA_7)
    };
    KukaDrive::listen(&KukaOptions {
        config,
        torque_rate: 4000.0,
        robot: iiwa7(),
        tool: iiwa7_tool(),
        undeclared: Undeclared {
            motor_kg_m2: [0.25; 7].into_iter().collect(),
            latency_us: 1500,
        },
    })
}

/// Exchanges with a law that holds the arm, until `done`.
fn run(
    machine: &Arc<dyn Machine>,
    drive: &mut KukaDrive,
    state: &mut DriveState,
    events: &mut Vec<DriveEvent>,
    done: impl Fn(&DriveState, &[DriveEvent]) -> bool,
) {
    let begun = machine.now();
    let at = state.q.clone();
    while !done(state, events) {
        assert!(machine.now() < begun + PATIENCE, "{state:?} {events:?}");
        let enable = state.status == DriveStatus::Ready;
        let law = |j: usize| 60.0 * (at[j] - state.q[j]) - 6.0 * state.dq[j];
        let tau: Joints = (0..7).map(|j| if enable { law(j) } else { 0.0 }).collect();
        let command = DriveCommand {
            session: 1,
            tick: state.tick,
            tau,
            enable,
            ..DriveCommand::default()
        };
        drive.exchange(Some(&command), state).expect("the link lives");
        let monitor = drive.monitor().expect("a monitor");
        while let Some(event) = monitor.next_event() {
            events.push(event);
        }
    }
}

// Fails if the sign of the torques is guessed or wrong, the motion does not start, ticks are lost while it runs, or the
// loop allocates memory. On a real socket: a simulated network allocates.
#[test]
fn the_sign_is_found_and_the_arm_is_held() {
    let machine = this_machine();
    for (sign, found) in [(1.0, TorqueSign::OfActuator), (-1.0, TorqueSign::OfLink)] {
        let (side, client) = cabinet_with(&machine, sign, 1.0, Tolerance::tolerant());
        let mut drive = listen(&machine, client).expect("a cabinet");
        assert_eq!(drive.hello().torque_sign, found);
        assert!(drive.hello().compensates_gravity && !drive.hello().lock_step);
        assert_eq!((drive.hello().motor_kg_m2[6], drive.hello().latency_us), (0.25, 1500));
        let (mut state, mut events) = (DriveState::default(), Vec::new());
        drive.exchange(None, &mut state).expect("a state");
        side.controls().command.store(true, Ordering::Relaxed);
        run(&machine, &mut drive, &mut state, &mut events, |_, events| {
            events.contains(&DriveEvent::Started)
        });
        let start = state.q.clone();
        let at = start.clone();
        let mut tick = state.tick;
        let allocated = allocation_counter::measure(|| {
            for _ in 0..1000 {
                let mut tau = Joints::new();
                for j in 0..7 {
                    let _ = tau.push(60.0 * (at[j] - state.q[j]) - 6.0 * state.dq[j]);
                }
                let command = DriveCommand {
                    session: 1,
                    tick: state.tick,
                    tau,
                    enable: true,
                    ..DriveCommand::default()
                };
                drive.exchange(Some(&command), &mut state).expect("the link lives");
                assert_eq!(state.tick, tick + 1 + u64::from(drive.missed()));
                tick = state.tick;
            }
        });
        assert_eq!(allocated.count_total, 0, "allocations in 1000 cycles");
        for (now, then) in state.q.iter().zip(&start) {
            assert!((now - then).abs() < 0.01, "{state:?}");
        }
    }
}

// Fails if a safety stop is no emergency stop with KUKA's own level, or a torque leaves after it.
#[test]
fn a_safety_stop_is_an_emergency_stop() {
    let machine = World::new(2).machine();
    let (side, client) = cabinet(&machine, 1.0, 1.0);
    let mut drive = listen(&machine, client).expect("a cabinet");
    let (mut state, mut events) = (DriveState::default(), Vec::new());
    drive.exchange(None, &mut state).expect("a state");
    side.controls().command.store(true, Ordering::Relaxed);
    run(&machine, &mut drive, &mut state, &mut events, |_, events| {
        events.contains(&DriveEvent::Started)
    });
    side.controls().safety.store(2, Ordering::Relaxed);
    run(&machine, &mut drive, &mut state, &mut events, |state, _| {
        state.status == DriveStatus::EmergencyStop
    });
    let stopped = events.iter().any(|event| {
        matches!(event, DriveEvent::KukaEnded(end)
            if matches!(end.cause, EndCause::SafetyStop(level) if level != SafetyState::NormalOperation))
    });
    assert!(stopped, "{events:?}");
    assert_eq!(side.statistics().torques_after_stop, 0);
}

// Fails if the sign is guessed where the sensors show no gravity: a wrong one would make the torque loop unstable.
#[test]
fn a_sign_that_cannot_be_told_is_refused() {
    let machine = World::new(3).machine();
    let (_side, client) = cabinet(&machine, 1.0, 0.0);
    let Err(error) = listen(&machine, client) else {
        panic!("a sign was guessed")
    };
    assert!(error.to_string().contains("stretched forwards"), "{error}");
}

// Fails if an overlay waits for the next exchange, is sent twice, or the first message of the motion is lost.
#[test]
fn an_overlay_leaves_as_soon_as_it_is_computed() {
    let machine = World::new(4).machine();
    let (side, client) = cabinet(&machine, 1.0, 1.0);
    let mut drive = listen(&machine, client).expect("a cabinet");
    let (mut state, mut events) = (DriveState::default(), Vec::new());
    drive.exchange(None, &mut state).expect("a state");
    side.controls().command.store(true, Ordering::Relaxed);
    let (at, monitor) = (state.q.clone(), drive.monitor().expect("a monitor"));
    let begun = machine.now();
    let (mut started, mut tick) = (0, None);
    while started < 300 {
        assert!(machine.now() < begun + PATIENCE, "{state:?} {events:?}");
        let enable = state.status == DriveStatus::Ready;
        let law = |j: usize| 60.0 * (at[j] - state.q[j]) - 6.0 * state.dq[j];
        let command = DriveCommand {
            session: 1,
            tick: state.tick,
            tau: (0..7).map(|j| if enable { law(j) } else { 0.0 }).collect(),
            enable,
            ..DriveCommand::default()
        };
        let (cycles, answered) = (monitor.record().cycles, side.statistics().answered);
        drive.answer(&command).expect("the link lives");
        if started > 0 {
            // Nobody asks for the next message yet.
            machine.sleep(Duration::from_millis(1));
            assert_eq!(side.statistics().answered, answered + 1);
        }
        drive.exchange(Some(&command), &mut state).expect("the link lives");
        assert!(monitor.record().cycles >= cycles);
        while let Some(event) = monitor.next_event() {
            events.push(event);
        }
        if events.contains(&DriveEvent::Started) {
            started += 1;
            if let Some(before) = tick.replace(state.tick) {
                assert_eq!(state.tick, before + 1 + u64::from(drive.missed()));
            }
        }
    }
    drop(drive);
    assert_eq!(monitor.record().cycles, 299);
}
