//! The phase machine of Algorithm 2.
//!
//! ```text
//!            Move                 Approach
//!   Idle ─────────▶ Moving ─▶ Idle ─────▶ Taring ─▶ Approaching ─▶ Coupling ─▶ Verifying
//!    ▲ ▲                                                                           │
//!    │ └─────────── Decoupling ◀── Decouple ── Coupled ◀──────────────────────────┘
//!    │                                        PoseTarget │ ▲
//!    └── ClearFault ── Fault ◀── (any)             ▼ │
//!                                              Turning ─▶ Recording
//! ```
//!
//! Each phase is a value of [`Activity`] with a `step` that is called once a
//! tick: it moves the setpoint and says what comes next. Phases know targets
//! and time; they compute no torque and touch no hardware, so they can be
//! stepped by hand.

mod approach;
mod cartesian;
mod couple;
mod decouple;
mod free;
mod pull;
mod record;
mod speed_scaling;
mod turn;

use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::{Event, Fault, Phase};
use spherecal_shared::robot::JointLimits;

pub(crate) use approach::{Approaching, Taring};
pub(crate) use cartesian::CartesianState;
pub(crate) use couple::{Coupling, Verifying};
pub(crate) use decouple::Decoupling;
pub(crate) use free::Moving;
pub(crate) use record::RecordingPose;
pub(crate) use turn::{PoseTarget, Turning};

use crate::law::{JointSetpoint, Snapshot, Wrench};
use crate::safety::Violation;

/// How long the arm must have been still to count as settled, in s.
const STILL_S: f64 = 0.020;
/// Speed of the fastest joint, low-pass filtered, at which a motion in free space
/// counts as finished, in rad/s.
const REST_SPEED_RAD_S: f64 = 0.02;

/// What a phase sees at one tick.
#[derive(Debug)]
pub(crate) struct Env<'a, const N: usize> {
    /// The arm.
    pub(crate) snapshot: &'a Snapshot<N>,
    /// Estimated wrench of the environment at the TCP, not tared, F0.
    pub(crate) wrench: Wrench,
    /// Measured torques, in N m.
    pub(crate) tau: &'a [f64; N],
    /// Fastest joint, low-pass filtered, in rad/s.
    pub(crate) joint_speed: f64,
    /// Size of the force at the TCP that the force limit watches, in N.
    pub(crate) force_n: f64,
    /// The procedure.
    pub(crate) procedure: &'a Procedure,
    /// Speed limits of the joints, in rad/s.
    pub(crate) speeds: &'a [f64; N],
    /// Limits of the joints.
    pub(crate) joints: &'a [JointLimits; N],
    /// Control period, in s.
    pub(crate) period_s: f64,
    /// Time since the phase was entered, in s.
    pub(crate) elapsed_s: f64,
    /// Device time, in µs.
    pub(crate) time_us: u64,
    /// Tick of the drive state.
    pub(crate) tick: u64,
}

/// What comes after a tick.
#[derive(Debug)]
#[allow(clippy::large_enum_variant)] // Made at a phase change only, and there is no heap.
pub(crate) enum Next<const N: usize> {
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
pub(crate) enum Activity<const N: usize> {
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
    Recording(RecordingPose<N>),
    /// Leaving.
    Decoupling(Decoupling),
    /// Hand-guiding.
    HandGuiding,
    /// Damped hold after a fault.
    Fault,
}

impl<const N: usize> Activity<N> {
    /// The phase that the host is told.
    pub(crate) fn phase(&self) -> Phase {
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
    pub(crate) fn is_cartesian(&self) -> bool {
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
    pub(crate) fn is_seated(&self) -> bool {
        matches!(self, Self::Coupled | Self::Turning(_) | Self::Recording(_))
    }

    /// One tick.
    pub(crate) fn step(
        &mut self,
        env: &Env<'_, N>,
        hold: &mut JointSetpoint<N>,
        cartesian: &mut CartesianState<N>,
    ) -> Next<N> {
        match self {
            Self::Idle | Self::Coupled | Self::HandGuiding | Self::Fault => Next::Stay,
            Self::Moving(phase) => phase.step(env, hold),
            Self::Taring(phase) => phase.step(env, cartesian),
            Self::Approaching(phase) => phase.step(env, cartesian),
            Self::Coupling(phase) => phase.step(env, cartesian),
            Self::Verifying(phase) => phase.step(env, cartesian),
            Self::Turning(phase) => phase.step(env, cartesian),
            Self::Recording(phase) => phase.step(env, cartesian),
            Self::Decoupling(phase) => phase.step(env, cartesian),
        }
    }
}
