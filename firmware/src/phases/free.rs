//! Free-space motion in joint coordinates: home to approach frame and back.

use spherecal_shared::protocol::host::Fault;

use super::speed_scaling::{SpeedScaling, joint_load, tcp_load};
use super::{Activity, Env, Next, REST_SPEED_RAD_S};
use crate::law::JointSetpoint;
use crate::motion::JointMove;

/// A motion of all joints.
#[derive(Clone, Debug)]
pub(crate) struct Moving<const N: usize> {
    path: JointMove<N>,
    /// Time along the path, in s. It runs slower than the clock while a soft
    /// limit is exceeded.
    along_s: f64,
    elapsed_s: f64,
    scaling: SpeedScaling,
    /// Time since the planned end, or for which the motion has been at its
    /// slowest, in s.
    over_s: f64,
}

impl<const N: usize> Moving<N> {
    /// A motion from the held joint angles to `target` (rad), within the speed of
    /// the procedure and of the joints (rad/s).
    pub(crate) fn new(start: [f64; N], target: [f64; N], env: &Env<'_, N>) -> Self {
        let motion = &env.procedure.motion;
        Self {
            path: JointMove::new(
                start,
                target,
                motion.speed_rad_s,
                env.speeds,
                motion.acceleration_rad_s2,
            ),
            along_s: 0.0,
            elapsed_s: 0.0,
            scaling: SpeedScaling::default(),
            over_s: 0.0,
        }
    }

    /// One tick.
    pub(crate) fn step(&mut self, env: &Env<'_, N>, hold: &mut JointSetpoint<N>) -> Next<N> {
        let scaling = self.scaling.step(tcp_load(env).max(joint_load(env)), env.period_s);
        self.along_s += scaling * (env.elapsed_s - self.elapsed_s);
        self.elapsed_s = env.elapsed_s;
        *hold = self.path.at(self.along_s);
        for speed in &mut hold.dq {
            *speed *= scaling;
        }
        let motion = &env.procedure.motion;
        let mut worst = 0.0f64;
        for (wanted, is) in hold.q.iter().zip(&env.snapshot.q) {
            worst = worst.max((wanted - is).abs());
        }
        let limits = &env.procedure.limits;
        if worst > limits.path_rad {
            return Next::fail(Fault::PathDeviation, worst, limits.path_rad);
        }
        if self.along_s < self.path.duration_s() {
            // At the slowest speed for long: something holds the arm.
            self.over_s = if self.scaling.is_slowest() {
                self.over_s + env.period_s
            } else {
                0.0
            };
            if self.over_s > motion.settle_s {
                return Next::fail(Fault::PathDeviation, worst, limits.path_rad);
            }
            return Next::Stay;
        }
        self.over_s += env.period_s;
        if worst <= motion.tolerance_rad && env.joint_speed <= REST_SPEED_RAD_S {
            *hold = JointSetpoint {
                q: *self.path.target(),
                dq: [0.0; N],
            };
            return Next::Enter(Activity::Idle, None);
        }
        if self.over_s > motion.settle_s {
            return Next::fail(Fault::MotionTimeout, worst, motion.tolerance_rad);
        }
        Next::Stay
    }
}
