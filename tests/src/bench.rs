//! A controller, wherever it runs, with a scripted host and a stand-in arm: for
//! tests that want one tick at a time, without plant and campaign.
//!
//! The arm is the nominal one, integrated at 1 kHz, with a little noise from a
//! seed on what it measures; the sphere is a spring to a point, of limited reach and
//! strength. Nothing but the control path's own arithmetic is in
//! it, so that a run has the same bits on every machine.

use nalgebra::{Rotation3, SVector, UnitQuaternion, Vector3};
use spherecal::link::Controller;
use spherecal_shared::Joints;
use spherecal_shared::linalg::Cholesky;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState, DriveStatus};
use spherecal_shared::protocol::frame::{self, Accumulator, MAX_FRAME, Message};
use spherecal_shared::protocol::host::{
    ApproachCommand, Banner, Command, Downlink, Event, Fault, Phase, PoseCommand, Recording, Uplink,
};
use spherecal_shared::robot::{Arm, Dynamics, iiwa7, iiwa7_tool};
use spherecal_shared::scalar::Real;

/// Elbow up, tool straight down, far from every limit, in rad.
pub const HOME: [f64; 7] = [0.0, 0.7, 0.0, -1.2, 0.0, 1.241_592_653_589_793, 0.0];

/// The control period, in s.
const PERIOD_S: f64 = 1e-3;
/// Ticks between two keep-alives of the host.
const ALIVE: u64 = 500;
/// How far the sphere draws the TCP, in m.
const REACH_M: f64 = 0.006;
/// How strongly at most, in N.
const HOLD_N: f64 = 20.0;

/// A number between -1 and 1, from a counter.
pub fn spread(seed: &mut u64) -> f64 {
    *seed = seed
        .wrapping_mul(6_364_136_223_846_793_005)
        .wrapping_add(1_442_695_040_888_963_407);
    (*seed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// `message` as a frame.
///
/// # Panics
/// When it does not fit one.
pub fn framed<M: Message>(message: &M, sequence: u32) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let length = frame::encode(message, sequence, 0, &mut out).expect("it fits");
    out[..length].to_vec()
}

/// What a drive that carries the iiwa 7 says of itself.
pub fn hello() -> DriveHello {
    DriveHello {
        lock_step: true,
        ..DriveHello::new(1, iiwa7().joints.iter().map(|joint| joint.limits))
    }
}

/// Seven values as a message carries them.
pub fn joints(values: &[f64; 7]) -> Joints {
    values.iter().copied().collect()
}

/// A drive state that carries `tau` (N m) at `q` (rad) and `dq` (rad/s).
pub fn state(tick: u64, q: &[f64; 7], dq: &[f64; 7], tau: &[f64; 7]) -> DriveState {
    DriveState {
        session: 1,
        tick,
        q: joints(q),
        dq: joints(dq),
        tau: joints(tau),
        status: DriveStatus::Ready,
    }
}

/// Hello, robot and configuration.
///
/// # Panics
/// If the built-in arm has more joints than a controller drives.
pub fn handshake_commands(procedure: Procedure) -> Vec<Command> {
    let tool = iiwa7_tool();
    vec![
        Command::Hello,
        Command::Robot(iiwa7().driven().expect("seven joints")),
        Command::Configure { tool, procedure },
    ]
}

/// The stand-in for arm and sphere.
#[derive(Clone, Debug)]
pub struct StandIn {
    arm: Arm<f64, 7>,
    /// Joint angles, in rad.
    pub q: SVector<f64, 7>,
    /// Joint velocities, in rad/s.
    pub dq: SVector<f64, 7>,
    /// Torques of the drives, in N m.
    tau: SVector<f64, 7>,
    /// Where a sphere is, F0, in m.
    pub sphere: Option<Vector3<f64>>,
    seed: u64,
}

impl StandIn {
    /// At rest at `q`, with no sphere.
    ///
    /// # Panics
    /// When the built-in robot is not one.
    pub fn new(q: &[f64; 7], seed: u64) -> Self {
        let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
        let tau = arm.bodies(&arm.frames(q)).gravity();
        Self {
            arm,
            q: SVector::from(*q),
            dq: SVector::zeros(),
            tau,
            sphere: None,
            seed,
        }
    }

    /// Computed TCP, F0, in m.
    pub fn tcp(&self) -> Vector3<f64> {
        self.arm.tcp_frame(&self.arm.frames(&self.q.into())).position
    }

    /// What the joints carry at rest at `q`, in N m.
    pub fn gravity(&self, q: &[f64; 7]) -> [f64; 7] {
        self.arm.bodies(&self.arm.frames(q)).gravity().into()
    }

    /// What the joints carry at rest at `q` while `force` (F0, in N) is on the
    /// TCP, in N m.
    pub fn carrying(&self, q: &[f64; 7], force: &Vector3<f64>) -> [f64; 7] {
        let frames = self.arm.frames(q);
        let jacobian = self.arm.jacobian(&frames, &self.arm.tcp_frame(&frames).position);
        let gravity = self.arm.bodies(&frames).gravity();
        (gravity - jacobian.fixed_rows::<3>(0).transpose() * force).into()
    }

    /// Axes of the TCP at `q`, F0, as a unit quaternion w, x, y, z.
    pub fn orientation(&self, q: &[f64; 7]) -> [f64; 4] {
        let rotation = self.arm.tcp_frame(&self.arm.frames(q)).rotation;
        let rotation = Rotation3::from_matrix_unchecked(rotation);
        let turn = UnitQuaternion::from_rotation_matrix(&rotation);
        [turn.w, turn.i, turn.j, turn.k]
    }

    /// What the drives measure at `tick`.
    pub fn state(&mut self, tick: u64) -> DriveState {
        let mut noisy = |values: &SVector<f64, 7>, size: f64| {
            let seed = &mut self.seed;
            core::array::from_fn(|i| values[i] + size * spread(seed))
        };
        let (q, dq) = (noisy(&self.q, 1e-5), noisy(&self.dq, 1e-4));
        let tau = noisy(&self.tau, 0.02);
        state(tick, &q, &dq, &tau)
    }

    /// One control period under `command`; without power the brakes hold.
    pub fn step(&mut self, command: &DriveCommand) {
        if !command.enable {
            self.dq = SVector::zeros();
            return;
        }
        for (slot, tau) in self.tau.iter_mut().zip(&command.tau) {
            *slot = *tau;
        }
        let frames = self.arm.frames(&self.q.into());
        let tcp = self.arm.tcp_frame(&frames).position;
        let jacobian = self.arm.jacobian(&frames, &tcp);
        let bodies = self.arm.bodies(&frames);
        let dq: [f64; 7] = self.dq.into();
        let mut torque = self.tau - bodies.gravity() - bodies.coriolis(&dq);
        torque +=
            jacobian.fixed_rows::<3>(0).transpose() * self.pull(&tcp, &(jacobian * self.dq).fixed_rows::<3>(0).into());
        // The mass matrix of the nominal arm is positive definite everywhere.
        let Some(mass) = Cholesky::new(&bodies.mass_matrix()) else {
            return;
        };
        self.dq += mass.solve(&torque) * PERIOD_S;
        self.q += self.dq * PERIOD_S;
    }

    /// Force of the sphere on the TCP, in N.
    fn pull(&self, tcp: &Vector3<f64>, velocity: &Vector3<f64>) -> Vector3<f64> {
        let Some(sphere) = self.sphere else {
            return Vector3::zeros();
        };
        let stretch = sphere - tcp;
        if stretch.norm() > REACH_M {
            return Vector3::zeros();
        }
        let pull = stretch * 2e4;
        pull * (HOLD_N / pull.norm().max(HOLD_N)) - velocity * 200.0
    }
}

/// A controller, what it said decoded, and the host and the arm that it has.
pub struct Bench<C: Controller> {
    /// The controller.
    pub controller: C,
    /// The arm.
    pub arm: StandIn,
    /// Number of the next tick.
    pub tick: u64,
    /// Every event so far, telemetry and statistics included.
    pub events: Vec<Event>,
    /// Whether the host is heard without being asked.
    pub alive: bool,
    accumulator: Accumulator,
    commands: u32,
    frames: u32,
    down: Vec<u8>,
}

impl<C: Controller> Bench<C> {
    /// Joins `controller` and an arm at rest at `q`; noise comes from `seed`.
    ///
    /// # Panics
    /// When the controller does not take the drive's hello.
    pub fn new(mut controller: C, q: &[f64; 7], seed: u64) -> Self {
        controller.connect(&hello()).expect("a hello that fits");
        Self {
            controller,
            arm: StandIn::new(q, seed),
            tick: 0,
            events: Vec::new(),
            alive: true,
            accumulator: Accumulator::new(),
            commands: 0,
            frames: 0,
            down: Vec::new(),
        }
    }

    /// The same, greeted and configured.
    pub fn configured(controller: C, q: &[f64; 7], seed: u64, procedure: Procedure) -> Self {
        let mut bench = Self::new(controller, q, seed);
        for command in handshake_commands(procedure) {
            bench.order(command);
        }
        bench.step();
        bench
    }

    /// Sends `command` with the next tick.
    pub fn order(&mut self, command: Command) {
        self.commands += 1;
        self.send(self.commands, command);
    }

    fn send(&mut self, sequence: u32, command: Command) {
        self.down
            .extend(framed(&Downlink::at_once(sequence, command), self.frames));
        self.frames += 1;
    }

    /// One tick with a drive state of the caller's.
    ///
    /// # Panics
    /// When the controller does not answer, or a frame of its is damaged.
    pub fn exchange(&mut self, state: &DriveState) -> DriveCommand {
        if self.alive && self.tick % ALIVE == ALIVE - 1 {
            self.send(0, Command::KeepAlive);
        }
        let (mut up, down) = (Vec::new(), core::mem::take(&mut self.down));
        let command = self
            .controller
            .exchange(self.tick * 1000, state, &down, &mut up)
            .expect("an answer");
        self.tick += 1;
        let (accumulator, mut heard) = (&mut self.accumulator, Vec::new());
        for byte in up {
            accumulator.push(byte, &mut |frame| {
                let frame = frame.expect("the link loses nothing");
                heard.push(frame::decode::<Uplink>(frame).expect("an uplink").1);
            });
        }
        for uplink in heard {
            if uplink.event > 0 {
                self.send(0, Command::Acknowledge { event: uplink.event });
            }
            self.events.push(uplink.body);
        }
        command
    }

    /// One tick at rest at `q`, whatever the torque.
    pub fn still(&mut self, q: &[f64; 7]) -> DriveCommand {
        let state = state(self.tick, q, &[0.0; 7], &self.arm.gravity(q));
        self.exchange(&state)
    }

    /// One tick of the arm.
    pub fn step(&mut self) -> DriveCommand {
        let state = self.arm.state(self.tick);
        let command = self.exchange(&state);
        self.arm.step(&command);
        command
    }

    /// Ticks of the arm until the controller has entered `phase`, `most` at most.
    ///
    /// # Panics
    /// When it does not.
    pub fn until(&mut self, phase: Phase, most: u64) {
        let (from, seen) = (self.tick, self.events.len());
        while self.tick < from + most {
            self.step();
            if self.entered(phase, seen) {
                return;
            }
        }
        let told = |event: &&Event| !matches!(event, Event::Telemetry(_) | Event::Statistics(_));
        let events: Vec<_> = self.events.iter().filter(told).collect();
        panic!("{phase:?} was not reached in {most} ticks: {events:?}");
    }

    /// Whether `phase` was entered after the first `seen` events.
    pub fn entered(&self, phase: Phase, seen: usize) -> bool {
        let entered = |event: &Event| matches!(event, Event::Phase(change) if change.phase == phase);
        self.events.iter().skip(seen).any(entered)
    }

    /// Sends an approach straight down, with a sphere `below_m` under the TCP.
    pub fn approach(&mut self, below_m: f64) {
        self.arm.sphere = Some(self.arm.tcp() - Vector3::z() * below_m);
        self.order(Command::Approach(ApproachCommand {
            sphere: 1,
            direction: [0.0, 0.0, -1.0],
        }));
    }

    /// Sends a pose, straight down and turned about the vertical by `angle` (rad).
    pub fn pose(&mut self, pose: u32, angle: f64) {
        // Half a turn about y, then `angle` about z.
        let (s, c) = (0.5 * angle).sin_cos_of();
        self.order(Command::Pose(PoseCommand {
            pose,
            orientation: [0.0, -s, c, 0.0],
            elbow_rad: Some(0.0),
            posture: Joints::new(),
            record: true,
        }));
    }

    /// The first fault.
    pub fn fault(&self) -> Option<Fault> {
        self.events.iter().find_map(|event| match event {
            Event::Fault(report) => Some(report.fault),
            _ => None,
        })
    }

    /// The banner.
    pub fn banner(&self) -> Option<Banner> {
        self.events.iter().find_map(|event| match event {
            Event::Banner(banner) => Some(banner.clone()),
            _ => None,
        })
    }

    /// Recordings, in order.
    pub fn recordings(&self) -> Vec<&Recording> {
        let mut recordings = Vec::new();
        for event in &self.events {
            if let Event::Recording(recording) = event {
                recordings.push(recording);
            }
        }
        recordings
    }
}
