//! The phase machine of Algorithm 2.
//!
//! ```text
//!            Move                 Approach
//!   Idle ─────────▶ Moving ─▶ Idle ─────▶ Taring ─▶ Approaching ─▶ Coupling ─▶ Verifying
//!    ▲ ▲                                                                           │
//!    │ └─────────── Decoupling ◀── Decouple ── Coupled ◀──────────────────────────┘
//!    │                                        Pose │ ▲
//!    └── ClearFault ── Fault ◀── (any)             ▼ │
//!                                              Turning ─▶ Recording
//! ```
//!
//! Each phase is a value of [`Activity`] with a `step` that is called once a
//! tick: it moves the setpoint and says what comes next. Phases know targets
//! and time; they compute no torque and touch no hardware, so they can be
//! stepped by hand.

mod approach;
mod couple;
mod decouple;
mod free;
mod pace;
mod record;
mod turn;

use nalgebra::{Matrix3, Vector3, Vector6};
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::{Event, Fault, Phase};
use spherecal_shared::robot::JointLimits;
use spherecal_shared::robot::elbow::elbow;

pub use approach::{Approaching, Taring};
pub use couple::{Coupling, Verifying};
pub use decouple::Decoupling;
pub use free::Moving;
pub use pace::Pace;
pub use record::Recording;
pub use turn::{Pose, Turning};

use crate::contact::SeatingWatch;
use crate::guard::Violation;
use crate::law::{CartesianSetpoint, Impedance, JointSetpoint, NullSpace, Snapshot, Stiffness, Wrench};

/// What a phase sees at one tick.
#[derive(Debug)]
pub struct Env<'a, const N: usize> {
    /// The arm.
    pub snapshot: &'a Snapshot<N>,
    /// Estimated wrench of the environment at the TCP, not tared, F0.
    pub wrench: Wrench,
    /// Measured torques, in N m.
    pub tau: &'a [f64; N],
    /// Fastest joint, low-pass filtered, in rad/s.
    pub joint_speed: f64,
    /// Size of the force at the TCP that the force limit watches, in N.
    pub force_n: f64,
    /// The procedure.
    pub procedure: &'a Procedure,
    /// Speed limits of the joints, in rad/s.
    pub speeds: &'a [f64; N],
    /// Limits of the joints.
    pub joints: &'a [JointLimits; N],
    /// Control period, in s.
    pub period_s: f64,
    /// Time since the phase was entered, in s.
    pub elapsed_s: f64,
    /// Device time, in µs.
    pub time_us: u64,
    /// Tick of the drive state.
    pub tick: u64,
}

/// What comes after a tick.
#[derive(Debug)]
#[allow(clippy::large_enum_variant)] // Made at a phase change only, and there is no heap.
pub enum Next<const N: usize> {
    /// The same phase.
    Stay,
    /// Another phase, and what to tell the host.
    Enter(Activity<N>, Option<Event>),
    /// A fault.
    Fail(Violation),
}

impl<const N: usize> Next<N> {
    /// A fault that concerns no joint.
    fn fail(fault: Fault, value: f64, limit: f64) -> Self {
        Self::Fail(Violation::new(fault, value, limit))
    }
}

/// What the controller is doing.
#[derive(Clone, Debug, Default)]
#[allow(clippy::large_enum_variant)] // Stored in place: there is no heap.
pub enum Activity<const N: usize> {
    /// Damped hold.
    #[default]
    Idle,
    /// Free-space motion.
    Moving(Moving<N>),
    /// Averaging the wrench at rest.
    Taring(Taring),
    /// Descending.
    Approaching(Approaching),
    /// Soft hold after contact.
    Coupling(Coupling),
    /// Test pull.
    Verifying(Verifying),
    /// Seated, waiting.
    Coupled,
    /// Turning.
    Turning(Turning<N>),
    /// Recording.
    Recording(Recording<N>),
    /// Leaving.
    Decoupling(Decoupling),
    /// Hand-guiding.
    HandGuiding,
    /// Damped hold after a fault.
    Fault,
}

impl<const N: usize> Activity<N> {
    /// The phase that the host is told.
    pub fn phase(&self) -> Phase {
        match self {
            Self::Idle => Phase::Idle,
            Self::Moving(_) => Phase::Moving,
            Self::Taring(_) => Phase::Taring,
            Self::Approaching(_) => Phase::Approaching,
            Self::Coupling(_) => Phase::Coupling,
            Self::Verifying(_) => Phase::Verifying,
            Self::Coupled => Phase::Coupled,
            Self::Turning(_) => Phase::Turning,
            Self::Recording(_) => Phase::Recording,
            Self::Decoupling(_) => Phase::Decoupling,
            Self::HandGuiding => Phase::HandGuiding,
            Self::Fault => Phase::Fault,
        }
    }

    /// Whether the Cartesian spring is the law of this phase; the others hold
    /// or move joints.
    pub fn is_cartesian(&self) -> bool {
        matches!(
            self,
            Self::Approaching(_)
                | Self::Coupling(_)
                | Self::Verifying(_)
                | Self::Coupled
                | Self::Turning(_)
                | Self::Recording(_)
                | Self::Decoupling(_)
        )
    }

    /// Whether the nest is known to be on the sphere, so that the seating watch
    /// applies.
    pub fn is_seated(&self) -> bool {
        matches!(self, Self::Coupled | Self::Turning(_) | Self::Recording(_))
    }

    /// One tick.
    pub fn step(&mut self, env: &Env<'_, N>, hold: &mut JointSetpoint<N>, task: &mut Task<N>) -> Next<N> {
        match self {
            Self::Idle | Self::Coupled | Self::HandGuiding | Self::Fault => Next::Stay,
            Self::Moving(phase) => phase.step(env, hold),
            Self::Taring(phase) => phase.step(env, task),
            Self::Approaching(phase) => phase.step(env, task),
            Self::Coupling(phase) => phase.step(env, task),
            Self::Verifying(phase) => phase.step(env, task),
            Self::Turning(phase) => phase.step(env, task),
            Self::Recording(phase) => phase.step(env, task),
            Self::Decoupling(phase) => phase.step(env, task),
        }
    }
}

/// What the Cartesian phases hand on to each other.
#[derive(Clone, Debug)]
pub struct Task<const N: usize> {
    /// Id of the sphere.
    pub sphere: u32,
    /// Direction of the approach in F0, a unit vector.
    pub direction: Vector3<f64>,
    /// Wrench tared away, F0: model error, which the law also compensates.
    pub tare: Wrench,
    /// Computed TCP at contact, in m.
    pub contact: Vector3<f64>,
    /// The watch over the seated nest.
    pub watch: SeatingWatch,
    /// The spring.
    pub impedance: Impedance,
    /// Where it pulls to.
    pub setpoint: CartesianSetpoint,
    /// Where the null space is drawn to.
    pub null_space: NullSpace<N>,
}

impl<const N: usize> Default for Task<N> {
    fn default() -> Self {
        Self {
            sphere: 0,
            direction: Vector3::zeros(),
            tare: Wrench::default(),
            contact: Vector3::zeros(),
            watch: SeatingWatch::new(Vector3::zeros()),
            impedance: Impedance::new(Stiffness::isotropic(0.0, 0.0)),
            setpoint: CartesianSetpoint::at(Vector3::zeros(), Matrix3::identity()),
            null_space: NullSpace::Free,
        }
    }
}

impl<const N: usize> Task<N> {
    /// Takes over from the joint law, bumpless: the spring pulls to where the
    /// arm is, the null space to where the elbow is, and the tared wrench, which
    /// a soft spring would give way to by centimetres, is compensated.
    pub fn engage(&mut self, snapshot: &Snapshot<N>, stiffness: Stiffness) {
        self.setpoint = CartesianSetpoint::at(snapshot.tcp.origin, snapshot.tcp.rotation);
        self.setpoint.feed_forward = self.compensation(Vector3::zeros());
        self.impedance = Impedance::new(stiffness);
        self.null_space = match elbow(&snapshot.frames) {
            Some(now) => NullSpace::Elbow {
                angle: now.angle,
                rate: 0.0,
            },
            None if N > 6 => NullSpace::Posture(snapshot.q),
            None => NullSpace::Free,
        };
    }

    /// Re-latches the spring to where the arm is.
    pub fn relatch(&mut self, snapshot: &Snapshot<N>, rotation: Matrix3<f64>) {
        self.setpoint = CartesianSetpoint::at(snapshot.tcp.origin, rotation);
        self.setpoint.feed_forward = self.compensation(Vector3::zeros());
    }

    /// Force added to the spring's: against the tared wrench, and `pull` (F0, in N).
    pub fn compensation(&self, pull: Vector3<f64>) -> Vector6<f64> {
        let (f, t) = (pull - self.tare.force, -self.tare.torque);
        Vector6::new(f.x, f.y, f.z, t.x, t.y, t.z)
    }

    /// The same stiffness along all axes, reached over the procedure's ramp.
    pub fn soften(&mut self, env: &Env<'_, N>, stiffness_n_m: f64) {
        let law = &env.procedure.law;
        let to = Stiffness::isotropic(stiffness_n_m, law.rotation_nm_rad);
        self.impedance.ramp_to(to, law.stiffness_ramp_s, env.period_s);
    }

    /// Force of the environment against the approach, tared, in N: positive
    /// when the arm pushes on the sphere.
    pub fn contact_force(&self, env: &Env<'_, N>) -> f64 {
        -self.direction.dot(&(env.wrench.force - self.tare.force))
    }

    /// Whether the orientation error is surely less than `angle` (rad, at most
    /// half a turn), told without the arc tangent that the error itself takes.
    pub fn surely_within(&self, snapshot: &Snapshot<N>, angle: f64) -> bool {
        let trace = self.setpoint.rotation.dot(&snapshot.tcp.rotation);
        // 3 - trace is 2 (1 - cos error), which grows with the error, and
        // 2 (1 - cos x) is nowhere less than x² - x⁴/12.
        let square = angle * angle;
        3.0 - trace < square - square * square / 12.0
    }

    /// Orientation error of the arm, in rad.
    pub fn orientation_error(&self, snapshot: &Snapshot<N>) -> f64 {
        crate::law::rotation_error(&self.setpoint.rotation, &snapshot.tcp.rotation).norm()
    }
}
