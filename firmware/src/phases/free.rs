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
    /// Time along the path, in s: slower than the clock where a soft limit bites.
    along_s: f64,
    elapsed_s: f64,
    scaling: SpeedScaling,
    /// For how long the motion has been over, or all but stopped, in s.
    over_s: f64,
}

impl<const N: usize> Moving<N> {
    /// From the held joint angles to `target` (rad), under the procedure's
    /// speed and the joints' own (rad/s).
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
            // Something holds the arm: it does not get on.
            self.over_s = if self.scaling.stopped() {
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
