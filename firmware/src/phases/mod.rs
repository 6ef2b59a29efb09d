//! The phases of Algorithm 2 as a state machine.
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
//! Beside them Idle becomes HandGuiding or Impedance, and either Idle again.
//!
//! Each phase is a value of [`Activity`]. Its `step` is called once per tick: it
//! moves the setpoint and returns what comes next. Phases know targets and time.
//! They compute no torque and use no hardware, so a test can step them.

mod approach;
mod cartesian;
mod couple;
mod decouple;
mod free;
mod impedance;
#[cfg(test)]
mod limit_tests;
mod pull;
mod record;
#[cfg(test)]
mod scene;
mod speed_scaling;
mod turn;

use nalgebra::{SVector, Vector3};
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::{Fault, Phase};
use spherecal_shared::robot::JointLimits;

pub(crate) use approach::{Approaching, Taring};
pub(crate) use cartesian::CartesianState;
pub(crate) use couple::{Coupling, Verifying};
pub(crate) use decouple::Decoupling;
pub(crate) use free::Moving;
pub(crate) use impedance::ImpedanceHold;
pub(crate) use record::RecordingPose;
pub(crate) use turn::{PoseTarget, Turning};

use crate::Report;
use crate::law::{Excess, JointSetpoint, Snapshot, Wrench};
use crate::safety::{Ends, Touch, Violation};

/// Time for which the arm must be still to count as settled, in s.
const STILL_S: f64 = 0.020;
/// Part of the time to settle after which a turn is content with a wider tolerance, and an arm that is there holds its joints.
const PATIENT_SHARE: f64 = 0.5;
/// Speed of the fastest joint (low-pass filtered) below which a motion in free
/// space is finished, in rad/s.
const REST_SPEED_RAD_S: f64 = 0.02;

/// What is felt at rest where a motion begins: another posture than that at its end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Departed<const N: usize> {
    /// Estimated external joint torque, in N m.
    pub(crate) external: SVector<f64, N>,
    /// The force at the TCP that explains it best, F0, in N.
    pub(crate) force: Vector3<f64>,
}

/// What a phase sees at one tick.
#[derive(Debug)]
pub(crate) struct Env<'a, const N: usize> {
    /// The arm.
    pub(crate) snapshot: &'a Snapshot<N>,
    /// Estimated wrench of the environment at the TCP, not tared, F0.
    pub(crate) wrench: Wrench,
    /// Estimated external joint torque, in N m.
    pub(crate) external: &'a SVector<f64, N>,
    /// What was felt where the last motion began.
    pub(crate) departed: Option<&'a Departed<N>>,
    /// A joint whose disturbance is beyond what the law compensates.
    pub(crate) excess: Option<Excess>,
    /// Measured torques, in N m.
    pub(crate) tau: &'a [f64; N],
    /// Speed of the fastest joint, low-pass filtered, in rad/s.
    pub(crate) joint_speed: f64,
    /// Magnitude of the force at the TCP that the force limit watches, in N.
    pub(crate) force_n: f64,
    /// The procedure.
    pub(crate) procedure: &'a Procedure,
    /// Speed that motions may use, per joint, in rad/s.
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

/// Result of a phase's tick.
#[derive(Debug)]
#[allow(clippy::large_enum_variant)] // Only made at a change of phase, and there is no heap.
pub(crate) enum Next<const N: usize> {
    /// The same phase.
    Stay,
    /// Another phase, and an event for the host.
    Enter(Activity<N>, Option<Report>),
    /// A fault.
    Fail(Violation),
}

impl<const N: usize> Next<N> {
    /// A fault that concerns no joint.
    fn fail(fault: Fault, value: f64, limit: f64) -> Self {
        Self::Fail(Violation::new(fault, value, limit))
    }
}

/// The present phase with its state.
#[derive(Clone, Debug, Default)]
#[allow(clippy::large_enum_variant)] // Stored in place: there is no heap.
pub(crate) enum Activity<const N: usize> {
    /// Holds, damped.
    #[default]
    Idle,
    /// Moves in free space.
    Moving(Moving<N>),
    /// Averages the wrench at rest.
    Taring(Taring<N>),
    /// Descends to the sphere.
    Approaching(Approaching),
    /// Holds softly after contact.
    Coupling(Coupling),
    /// Makes the test pull.
    Verifying(Verifying),
    /// Seated; waits for a pose.
    Coupled,
    /// Turns to a pose.
    Turning(Turning<N>),
    /// Records a pose.
    Recording(RecordingPose<N>),
    /// Leaves the sphere.
    Decoupling(Decoupling),
    /// Follows a hand.
    HandGuiding,
    /// Is a spring of the host.
    Impedance(ImpedanceHold),
    /// Holds, damped, after a fault.
    Fault,
}

impl<const N: usize> Activity<N> {
    /// The phase as reported to the host.
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
            Self::Impedance(_) => Phase::Impedance,
            Self::Fault => Phase::Fault,
        }
    }

    /// Whether the Cartesian spring is the law of this phase. The other phases hold
    /// or move the joints.
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
                | Self::Impedance(_)
        )
    }

    /// Whether the nest is on the sphere, so that the seating watch applies.
    pub(crate) fn is_seated(&self) -> bool {
        matches!(self, Self::Coupled | Self::Turning(_) | Self::Recording(_))
    }

    /// What the arm touches in this phase. `hangs` says that the nest may be on a sphere
    /// although the arm is idle.
    pub(crate) fn touch(&self, hangs: bool) -> Touch {
        match self {
            Self::Idle if !hangs => Touch::Rest,
            Self::Moving(_) => Touch::Free,
            Self::Coupling(_) | Self::Verifying(_) | Self::Coupled | Self::Turning(_) | Self::Recording(_) => {
                Touch::Seated
            }
            Self::Decoupling(phase) => Touch::Leaving(phase.pull_ms),
            Self::Idle
            | Self::Taring(_)
            | Self::Approaching(_)
            | Self::HandGuiding
            | Self::Impedance(_)
            | Self::Fault => Touch::Wanted,
        }
    }

    /// What it may do where a joint is at the end of its range.
    pub(crate) fn ends(&self) -> Ends {
        match self {
            Self::Idle | Self::Moving(_) => Ends::Return,
            Self::Decoupling(_) => Ends::Leave,
            _ => Ends::Keep,
        }
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
            Self::Impedance(phase) => phase.step(env, cartesian),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if an idle arm with its nest on a sphere is judged like one in free space: it may
    // be pushed aside, and it may carry what it hangs on.
    #[test]
    fn an_idle_arm_may_hang_on_a_sphere() {
        assert_eq!(Activity::<7>::Idle.touch(false), Touch::Rest);
        assert_eq!(Activity::<7>::Idle.touch(true), Touch::Wanted);
        assert_eq!(Activity::<7>::Coupled.touch(true), Touch::Seated);
    }
}
