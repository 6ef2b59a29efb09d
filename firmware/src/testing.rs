//! A simple arm and sphere for the unit tests of the phases.
//!
//! The arm is the nominal one, integrated at 1 kHz. The sphere is a spring to a
//! point: it catches the TCP when it comes near and releases it above a force. It
//! is no plant (the host has the simulated plant, for the system tests). It is just
//! enough to make the condition of every phase true or false.

mod digest;
mod noise;

use embassy_time::Instant;
use nalgebra::{SVector, Vector3};
use spherecal_shared::Joints;
use spherecal_shared::linalg::Cholesky;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState, DriveStatus};
use spherecal_shared::protocol::host::{
    ApproachCommand, Command, Event, Fault, FaultReport, Phase, PoseCommand, Recording, Refusal,
};
use spherecal_shared::robot::{Arm, Dynamics, JointLimits, iiwa7, iiwa7_tool};
use std::vec::Vec;

use crate::Controller;
pub(crate) use digest::Digest;
use noise::noisy;
pub(crate) use noise::random;

/// Home position of the tests: elbow up, tool straight down, far from every limit.
pub(crate) const HOME: [f64; 7] = [0.0, 0.7, 0.0, -1.2, 0.0, 1.241_592_653_589_793, 0.0];

/// Limits that no posture of a test comes near.
pub(crate) const NO_LIMITS: JointLimits = JointLimits {
    min_rad: -1e3,
    max_rad: 1e3,
    velocity_rad_s: 1e3,
    torque_nm: 1e3,
};

/// The handshake of a drive for the built-in arm at 1 kHz.
pub(crate) fn hello() -> DriveHello {
    DriveHello {
        lock_step: true,
        ..DriveHello::new(1, iiwa7().joints.iter().map(|joint| joint.limits))
    }
}

/// The controller with the simple arm.
#[derive(Clone)]
pub(crate) struct Bench {
    /// The controller under test.
    pub(crate) controller: Controller<7>,
    /// Every event so far.
    pub(crate) events: Vec<Event>,
    /// Number of the present tick.
    pub(crate) tick: u64,
    /// Joint angles, in rad.
    pub(crate) q: SVector<f64, 7>,
    /// Joint velocities, in rad/s.
    pub(crate) dq: SVector<f64, 7>,
    /// Position of the sphere, F0, in m.
    pub(crate) sphere: Option<Vector3<f64>>,
    /// Force at which the sphere releases the TCP, in N.
    pub(crate) hold_n: f64,
    /// External force on the TCP, F0, in N.
    pub(crate) push: Vector3<f64>,
    /// Error of the measured torques, in N m.
    pub(crate) torque_bias: SVector<f64, 7>,
    /// Whether the joints are blocked.
    pub(crate) blocked: bool,
    /// Status that the drive reports.
    pub(crate) status: DriveStatus,
    /// Session number of the drive.
    pub(crate) session: u32,
    /// Whether the drive adds the gravity torque itself.
    pub(crate) gravity_by_drive: bool,
    /// Whether the measured torques have the sign of the links.
    pub(crate) reversed: bool,
    /// Inertia of the motors between commanded and measured torque, in kg m².
    pub(crate) motors: SVector<f64, 7>,
    /// Control period, in µs.
    pub(crate) period_us: u32,
    /// Whether the controller hears the host.
    pub(crate) host: bool,
    /// The last command.
    pub(crate) command: DriveCommand,
    /// Ticks after which a torque acts.
    pub(crate) delay: usize,
    /// Size of the sensors' noise: 1 is 2 µrad, 0.2 mrad/s and 0.01 N m; 0 is none.
    pub(crate) noise: f64,
    /// Delay of the states, in µs.
    pub(crate) lag_us: u64,
    /// Hash of every command, event and sample so far.
    pub(crate) digest: Digest,
    sent: Vec<Joints>,
    /// Whether the sphere holds the TCP.
    pub(crate) caught: bool,
    tau: SVector<f64, 7>,
    arm: Arm<f64, 7>,
}

impl Bench {
    /// A configured controller that holds at home.
    pub(crate) fn new(procedure: Procedure) -> Self {
        Self::at_period(procedure, 1000)
    }

    /// The same with a drive of another period, in µs.
    pub(crate) fn at_period(procedure: Procedure, period_us: u32) -> Self {
        let arm = Arm::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
        let mut controller = Controller::default();
        let hello = DriveHello { period_us, ..hello() };
        controller.connect(&hello).expect("a drive that fits");
        controller
            .command(Command::Robot(iiwa7().driven().expect("seven joints")))
            .expect("a robot");
        controller
            .command(Command::Configure {
                tool: iiwa7_tool(),
                procedure,
            })
            .expect("a procedure");
        let gravity = arm.bodies(&arm.frames(&HOME)).gravity();
        let mut bench = Self {
            controller,
            events: Vec::new(),
            tick: 0,
            q: HOME.into(),
            dq: SVector::zeros(),
            sphere: None,
            hold_n: 26.5,
            push: Vector3::zeros(),
            torque_bias: SVector::zeros(),
            blocked: false,
            status: DriveStatus::Ready,
            session: 1,
            gravity_by_drive: false,
            reversed: false,
            motors: SVector::zeros(),
            period_us,
            host: true,
            command: DriveCommand::default(),
            delay: 0,
            noise: 0.0,
            lag_us: 0,
            digest: Digest::default(),
            sent: Vec::new(),
            caught: false,
            tau: gravity,
            arm,
        };
        bench.run(50);
        bench
    }

    /// The paper's motions and spring of the approach, with short waiting times.
    pub(crate) fn fast_procedure() -> Procedure {
        let Procedure { motion, approach, .. } = Procedure::default().paper();
        let mut procedure = Procedure {
            motion,
            approach,
            ..Procedure::default()
        };
        procedure.approach.tare_s = 0.1;
        procedure.couple.hold_s = 0.3;
        procedure.record.samples = 100;
        procedure.turn.settle_s = 1.0;
        procedure.motion.settle_s = 0.5;
        procedure.decouple.settle_s = 0.5;
        procedure
    }

    /// Computed TCP, in m.
    pub(crate) fn tcp(&self) -> Vector3<f64> {
        self.arm.tcp_frame(&self.arm.frames(&self.q.into())).position
    }

    /// Computed orientation of the tool, F0.
    pub(crate) fn rotation(&self) -> nalgebra::Matrix3<f64> {
        self.arm.tcp_frame(&self.arm.frames(&self.q.into())).rotation
    }

    /// The drive state of this tick.
    pub(crate) fn state(&self) -> DriveState {
        let joints = |kind: u64, v: SVector<f64, 7>, size: f64| {
            noisy(v, self.noise * size, self.tick.wrapping_mul(64).wrapping_add(kind * 8))
        };
        DriveState {
            session: self.session,
            tick: self.tick,
            q: joints(0, self.q, 2e-6),
            dq: joints(1, self.dq, 2e-4),
            tau: joints(
                2,
                (self.tau + self.torque_bias) * if self.reversed { -1.0 } else { 1.0 },
                1e-2,
            ),
            status: self.status,
        }
    }

    /// One tick with the given drive state.
    pub(crate) fn tick_with(&mut self, state: &DriveState) {
        if self.host {
            self.controller.host_heard();
        }
        self.command = self.controller.tick(
            Instant::from_micros(
                self.tick
                    .wrapping_mul(u64::from(self.period_us))
                    .wrapping_add(self.lag_us),
            ),
            state,
        );
        self.digest.command(&self.command);
        while let Some(event) = self.controller.next_event() {
            self.digest.event(&event);
            self.events.push(event);
        }
        while let Some(sample) = self.controller.next_sample() {
            self.digest.sample(&sample);
        }
        assert_eq!(self.command.tau.len(), 7);
        assert!(
            self.command.tau.iter().all(|t| t.is_finite()),
            "a torque must be finite, always"
        );
    }

    /// Runs `ticks` ticks.
    pub(crate) fn run(&mut self, ticks: u32) {
        for _ in 0..ticks {
            self.tick += 1;
            self.tick_with(&self.state());
            self.integrate();
        }
    }

    /// Runs `ticks` ticks whose states `spoil` changes; it gets the number of the tick, from 0.
    pub(crate) fn run_with(&mut self, ticks: u32, mut spoil: impl FnMut(u32, &mut DriveState)) {
        for k in 0..ticks {
            self.tick += 1;
            let mut state = self.state();
            spoil(k, &mut state);
            self.tick_with(&state);
            self.integrate();
        }
    }

    /// Runs until the phase is reached, for at most `ticks` ticks; then panics.
    pub(crate) fn until(&mut self, phase: Phase, ticks: u32) {
        for _ in 0..ticks {
            if self.controller.phase() == phase {
                return;
            }
            self.run(1);
        }
        assert_eq!(self.controller.phase(), phase, "events: {:?}", self.events);
    }

    /// Runs until the fault phase is reached, for at most `ticks` ticks.
    pub(crate) fn until_fault(&mut self, ticks: u32) {
        for _ in 0..ticks {
            if self.controller.phase() == Phase::Fault {
                return;
            }
            self.run(1);
        }
    }

    /// One period, in steps of 1 ms under the same command.
    fn integrate(&mut self) {
        for _ in 0..self.period_us / 1000 {
            self.step();
        }
    }

    fn step(&mut self) {
        self.sent.push(self.command.tau.clone());
        let acts = &self.sent[self.sent.len().saturating_sub(self.delay + 1)];
        for i in 0..7 {
            self.tau[i] = acts[i];
        }
        if self.gravity_by_drive {
            self.tau += self.arm.bodies(&self.arm.frames(&self.q.into())).gravity();
        }
        if self.blocked || !self.command.enable {
            self.dq = SVector::zeros();
            return;
        }
        if let Ok(follow) = <[f64; 7]>::try_from(self.command.follow.as_slice()) {
            let follow = SVector::from(follow);
            self.dq = (follow - self.q) / 1e-3;
            self.q = follow;
            self.tau = self.arm.bodies(&self.arm.frames(&follow.into())).gravity();
            return;
        }
        let frames = self.arm.frames(&self.q.into());
        let tcp = self.arm.tcp_frame(&frames).position;
        let jacobian = self.arm.jacobian(&frames, &tcp);
        let mut force = self.push;
        if let Some(sphere) = self.sphere {
            let stretch = sphere - tcp;
            if stretch.norm() < 0.002 {
                self.caught = true;
            }
            if self.caught {
                let velocity = (jacobian * self.dq).fixed_rows::<3>(0).into_owned();
                let pull = stretch * 2e4 - velocity * 200.0;
                if pull.norm() > self.hold_n && stretch.z < 0.0 {
                    self.caught = false;
                } else {
                    force += pull;
                }
            }
        }
        let bodies = self.arm.bodies(&frames);
        let dq: [f64; 7] = self.dq.into();
        let mut torque = self.tau - bodies.gravity() - bodies.coriolis(&dq);
        torque += jacobian.fixed_rows::<3>(0).transpose() * force;
        let mut mass = bodies.mass_matrix();
        for i in 0..7 {
            mass[(i, i)] += self.motors[i];
        }
        let acceleration = Cholesky::new(&mass).expect("a mass matrix").solve(&torque);
        self.tau -= self.motors.component_mul(&acceleration);
        self.dq += acceleration * 1e-3;
        self.q += self.dq * 1e-3;
    }

    /// Sends a move to `target` (rad).
    pub(crate) fn go(&mut self, target: &[f64]) -> Result<(), Refusal> {
        self.controller.command(Command::Move {
            target: Joints::from_slice(target).expect("at most eight"),
        })
    }

    /// Sends an approach straight down.
    pub(crate) fn approach(&mut self) -> Result<(), Refusal> {
        self.controller.command(Command::Approach(ApproachCommand {
            sphere: 3,
            direction: [0.0, 0.0, -1.0],
        }))
    }

    /// Sends a pose that turns the tool about the vertical by `angle` (rad).
    pub(crate) fn pose(&mut self, angle: f64, record: bool) -> Result<(), Refusal> {
        // The tool points down: half a turn about y, then `angle` about z.
        let (s, c) = libm::sincos(0.5 * angle);
        let orientation = [0.0, -s, c, 0.0];
        let pose = PoseCommand {
            pose: 7,
            orientation,
            elbow_rad: Some(0.0),
            posture: Joints::new(),
            record,
        };
        self.controller.command(Command::Pose(pose))
    }

    /// A bench with the nest seated on a sphere 15 mm below home.
    pub(crate) fn coupled() -> Self {
        Self::coupled_by(Self::fast_procedure())
    }

    /// The same with another procedure.
    pub(crate) fn coupled_by(procedure: Procedure) -> Self {
        let mut bench = Self::new(procedure);
        bench.sphere = Some(bench.tcp() - Vector3::z() * 0.015);
        bench.approach().expect("idle");
        bench.until(Phase::Coupled, 8_000);
        bench
    }

    /// The phases entered so far.
    pub(crate) fn phases(&self) -> Vec<Phase> {
        self.events
            .iter()
            .filter_map(|e| if let Event::Phase(p) = e { Some(p.phase) } else { None })
            .collect()
    }

    /// The faults so far.
    pub(crate) fn faults(&self) -> Vec<FaultReport> {
        self.events
            .iter()
            .filter_map(|e| if let Event::Fault(f) = e { Some(*f) } else { None })
            .collect()
    }

    /// The recordings so far.
    pub(crate) fn recordings(&self) -> Vec<Recording> {
        self.events
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

    /// Checks that there was one fault, from `phase`, and that the arm then comes
    /// to rest under a damped hold with gravity compensation.
    pub(crate) fn expect_fault(&mut self, fault: Fault, phase: Phase) {
        let faults = self.faults();
        assert_eq!(
            faults.iter().map(|f| (f.fault, f.phase)).collect::<Vec<_>>(),
            [(fault, phase)]
        );
        assert_eq!(self.controller.phase(), Phase::Fault);
        self.blocked = false;
        self.push = Vector3::zeros();
        self.torque_bias = SVector::zeros();
        self.status = DriveStatus::Ready;
        let recordings = self.recordings().len();
        self.run(3_000);
        assert!(self.dq.norm() < 1e-3, "the hold must come to rest: {}", self.dq.norm());
        assert_eq!(self.recordings().len(), recordings, "nothing is recorded after a fault");
        assert_eq!(self.faults().len(), 1, "one fault is reported once");
    }
}
