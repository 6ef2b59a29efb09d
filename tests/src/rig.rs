//! A rig for system tests: the real controller on the simulated plant, without
//! link, campaign or store, tick by tick.
//!
//! The controller sees what a drive shows; the plant's truth is for the
//! test's own questions.
#![allow(clippy::missing_panics_doc)] // A rig that cannot be built must fail its test.

use embassy_time::Instant;
use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};
use spherecal::sim::plant::{Plant, PlantConfig};
use spherecal_firmware::Controller;
use spherecal_shared::Joints;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveHello, DriveState, DriveStatus};
use spherecal_shared::protocol::host::{ApproachCommand, Command, Event, Phase, PoseCommand, Refusal};
use spherecal_shared::robot::elbow::elbow;
use spherecal_shared::robot::{Arm, Robot, iiwa7, iiwa7_tool};

/// Nominal arm with the calibration tool.
pub fn nominal() -> Arm<f64, 7> {
    Arm::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot")
}

/// Joint angles that put the TCP frame at a position (m) and orientation (F0),
/// by damped least squares from a seed; the elbow stays near the seed's.
///
/// # Panics
/// When it does not converge: the test asked for a pose out of reach.
pub fn solve<const N: usize>(
    arm: &Arm<f64, N>,
    position: &Vector3<f64>,
    rotation: &Matrix3<f64>,
    seed: &[f64; N],
) -> [f64; N] {
    let mut q = SVector::from(*seed);
    for _ in 0..500 {
        let frames = arm.frames(&q.into());
        let tcp = arm.tcp_frame(&frames);
        let turn = spherecal_firmware::law::rotation_error(rotation, &tcp.rotation);
        let shift = position - tcp.position;
        let error = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
        if error.norm() < 1e-12 {
            return q.into();
        }
        let j: SMatrix<f64, 6, N> = arm.jacobian(&frames, &tcp.position);
        let gram = j * j.transpose() + SMatrix::<f64, 6, 6>::identity() * 1e-6;
        q += j.transpose() * gram.cholesky().expect("positive definite").solve(&error);
    }
    panic!("no joint angles for {position:?}");
}

/// Orientation of the tool when it points straight down, turned about the
/// vertical by `yaw` (rad): the flange's plane is parallel to the plate.
pub fn down(yaw: f64) -> Matrix3<f64> {
    (UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw)
        * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
    .to_rotation_matrix()
    .into_inner()
}

/// A posture from which the iterations reach the plate with the elbow up.
pub const SEED: [f64; 7] = [0.0, 0.6, 0.0, -1.5, 0.0, 1.0, 0.0];

/// Controller and plant of an arm with `N` joints.
pub struct Rig<const N: usize = 7> {
    /// The plant.
    pub plant: Plant<N>,
    /// The controller.
    pub controller: Controller<N>,
    /// Ticks so far.
    pub tick: u64,
    /// Every event so far, telemetry apart.
    pub events: Vec<Event>,
    /// Largest contact force that the controller estimated, in N.
    pub peak_force: f64,
    /// Whether drive states still reach the controller.
    pub drive: DriveStatus,
}

impl<const N: usize> Rig<N> {
    /// A configured controller on a plant of `robot` with the calibration tool, whose encoders stand at `q` (rad).
    pub fn of(robot: &Robot, config: &PlantConfig, procedure: Procedure, q: &[f64; N]) -> Self {
        let plant = Plant::new(robot, &iiwa7_tool(), config, q).expect("a plant");
        let mut controller = Controller::default();
        let hello = DriveHello {
            motor_kg_m2: plant.declared_motors().iter().copied().collect(),
            latency_us: (plant.latency_s() * 1e6) as u32,
            lock_step: true,
            ..DriveHello::new(1, robot.joints.iter().map(|joint| joint.limits))
        };
        controller.connect(&hello).expect("a drive that fits");
        controller
            .command(Command::Robot(
                robot.driven().expect("as many joints as a controller drives"),
            ))
            .expect("a robot");
        controller
            .command(Command::Configure {
                tool: iiwa7_tool(),
                procedure,
            })
            .expect("a procedure");
        let mut rig = Self {
            plant,
            controller,
            tick: 0,
            events: Vec::new(),
            peak_force: 0.0,
            drive: DriveStatus::Ready,
        };
        rig.run(1);
        rig
    }

    /// The drive state that the controller sees next.
    pub fn state(&self) -> DriveState {
        let sensed = self.plant.sensed();
        let joints = |values: &[f64; N]| Joints::from_slice(values).expect("as many as a message carries");
        DriveState {
            session: 1,
            tick: self.tick,
            q: joints(&sensed.q),
            dq: joints(&sensed.dq),
            tau: joints(&sensed.tau),
            status: self.drive,
        }
    }

    /// Runs so many ticks.
    pub fn run(&mut self, ticks: u64) {
        for _ in 0..ticks {
            self.tick += 1;
            let command = self.controller.tick(Instant::from_millis(self.tick), &self.state());
            self.controller.host_heard();
            while let Some(event) = self.controller.next_event() {
                self.events.push(event);
            }
            while self.controller.next_sample().is_some() {}
            self.peak_force = self.peak_force.max(self.controller.contact_force().norm());
            let tau: [f64; N] = command.tau.as_slice().try_into().expect("a torque for each joint");
            self.plant.step(&tau);
        }
    }

    /// Runs until the phase is `phase`, at most `ticks`; says whether it came.
    pub fn run_until(&mut self, phase: Phase, ticks: u64) -> bool {
        for _ in 0..ticks {
            if self.controller.phase() == phase {
                return true;
            }
            if self.controller.phase() == Phase::Fault {
                return false;
            }
            self.run(1);
        }
        self.controller.phase() == phase
    }

    /// Moves to joint angles and waits.
    pub fn move_to(&mut self, q: &[f64; N]) -> bool {
        let target = Joints::from_slice(q).expect("as many as a message carries");
        self.controller
            .command(Command::Move { target })
            .expect("a target in reach");
        self.run_until(Phase::Idle, 30_000)
    }

    /// Begins an approach straight down.
    ///
    /// # Errors
    /// The controller's refusal.
    pub fn approach(&mut self, sphere: u32) -> Result<(), Refusal> {
        self.controller.command(Command::Approach(ApproachCommand {
            sphere,
            direction: [0.0, 0.0, -1.0],
        }))
    }

    /// Turns to an orientation and elbow angle and records, waiting for it.
    pub fn pose(&mut self, id: u32, rotation: &Matrix3<f64>, elbow_rad: Option<f64>) -> bool {
        let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation));
        let orientation = [q.w, q.i, q.j, q.k];
        let command = PoseCommand {
            pose: id,
            orientation,
            elbow_rad,
            posture: Joints::new(),
            record: true,
        };
        self.controller.command(Command::Pose(command)).expect("a pose");
        self.run_until(Phase::Coupled, 20_000)
    }
}

impl Rig {
    /// The same for the iiwa 7.
    pub fn new(config: &PlantConfig, procedure: Procedure, q: &[f64; 7]) -> Self {
        Self::of(&iiwa7(), config, procedure, q)
    }

    /// Elbow angle of the nominal arm at the encoders' angles, in rad.
    pub fn elbow(&self) -> f64 {
        elbow(&nominal().frames(&self.plant.sensed().q)).map_or(0.0, |e| e.angle)
    }
}
