//! What the drive permits: how fast springs may be, and how torques are smoothed.

use spherecal_shared::robot::{Arm, Dynamics as _};
use spherecal_shared::scalar::sqrt;

/// What the law knows of the drive, from its handshake.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Actuation<const N: usize> {
    /// Inertia of the motors between commanded and measured torque, seen at the
    /// joints, in kg m².
    pub motors: [f64; N],
    /// Highest natural frequency that springs may have on this drive, in rad/s.
    pub fastest_rad_s: f64,
    /// Highest natural frequency, and highest damping, of the spring of a joint alone,
    /// in rad/s: several of them act on one motion.
    pub joint_rad_s: f64,
    /// Time constant of the low-pass of the torques, in s; 0: none.
    pub smoothing_s: f64,
}

impl<const N: usize> Actuation<N> {
    /// Phase, in rad, that a spring may lose by the delay at its natural frequency. A
    /// spring-damper of ratio 0.7 on an inertia alone keeps 0.18 of damping there for
    /// 5 ms of delay, and more for less (eigenvalues of the sampled loop with the
    /// torque loop at its default).
    const LAG_RAD: f64 = 0.35;

    /// The same for the spring of a joint alone, with half of the control period. Where
    /// axes align, the springs of up to three joints act on one motion. The loop then
    /// stays stable with 1.3 times the delay or 1.5 times the gain, on every built-in
    /// arm in every posture, for 0 to 5 ms (a test of `law::joint`).
    const JOINT_LAG_RAD: f64 = 0.14;

    /// Latency, in s, for which the springs of an approach are made: twice the longest that a
    /// drive may declare.
    const APPROACH_LATENCY_S: f64 = 10e-3;

    /// Period and latency together, in s, beyond which torques are smoothed if motors show: a drive that answers at once at
    /// 1 kHz, with a half. Late damping drives a motor against a gear that gives way (`docs/design/control.md`).
    const LATE_S: f64 = 1.5e-3;

    /// Time constant of that low-pass, in s: with 14 ms motors still rang, with 35 ms retreats pressed. It counts as latency.
    const SMOOTHING_S: f64 = 25e-3;

    /// Softest spring, in N m/rad, with which a joint alone still comes to rest where it should. FR3 and Panda
    /// without a tool and with hidden motors finished all runs with 0.88 N m/rad and more; with 0.77 N m/rad and
    /// less some ended in motions that did not settle: dry friction that the torque loop leaves turns the
    /// joint by more than the motion's tolerance.
    const SOFTEST_NM_RAD: f64 = 0.8;

    /// A drive with these motors (kg m²) that is commanded once in `period_s` (s) and
    /// answers `latency_s` (s) after a state.
    pub fn new(motors: [f64; N], period_s: f64, latency_s: f64) -> Self {
        let shows = motors.iter().any(|inertia| *inertia > 0.0);
        let smoothing_s = if shows && period_s + latency_s > Self::LATE_S {
            Self::SMOOTHING_S
        } else {
            0.0
        };
        let latency_s = latency_s + smoothing_s;
        Self {
            motors,
            smoothing_s,
            fastest_rad_s: Self::LAG_RAD / (period_s + latency_s),
            joint_rad_s: Self::JOINT_LAG_RAD / (0.5 * period_s + latency_s),
        }
    }

    /// Whether springs that are safe on this drive hold the last joint of `arm` against friction: it moves the
    /// least inertia.
    pub fn holds(&self, arm: &Arm<f64, N>) -> bool {
        self.joint_rad_s * self.joint_rad_s * self.last_inertia(arm) >= Self::SOFTEST_NM_RAD
    }

    /// Longest latency, in s, with which they do on a drive that is commanded once in `period_s` (s).
    pub fn latest_s(&self, arm: &Arm<f64, N>, period_s: f64) -> f64 {
        let lag_s = Self::JOINT_LAG_RAD * sqrt(self.last_inertia(arm) / Self::SOFTEST_NM_RAD);
        (lag_s - 0.5 * period_s - self.smoothing_s).max(0.0)
    }

    /// Inertia that the last joint moves, its motor included, in kg m².
    fn last_inertia(&self, arm: &Arm<f64, N>) -> f64 {
        arm.last_inertia() + self.motors.last().copied().unwrap_or(0.0)
    }

    /// The same drive in an approach, commanded once in `period_s` (s).
    ///
    /// The drive may answer later than it declares. In an approach nothing damps the tool: the rotational
    /// spring turns a wrist that hides its motor (3 g m²) with 270 rad/s, and a delay of 6 ms made
    /// that joint run away faster than any guard can see it. The orientation need not be exact there, so
    /// the springs are slow enough for a late drive.
    pub fn in_approach(self, period_s: f64) -> Self {
        Self {
            fastest_rad_s: self
                .fastest_rad_s
                .min(Self::LAG_RAD / (period_s + Self::APPROACH_LATENCY_S)),
            ..self
        }
    }
}

impl<const N: usize> Default for Actuation<N> {
    /// A drive that hides its motors and answers within one period of 1 ms.
    fn default() -> Self {
        Self::new([0.0; N], 1e-3, 0.0)
    }
}
