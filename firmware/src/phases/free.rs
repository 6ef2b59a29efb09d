//! Free-space motion in joint coordinates: home to approach frame and back.

use spherecal_shared::protocol::host::Fault;

use super::{Activity, Env, Next};
use crate::law::JointSetpoint;
use crate::motion::JointMove;

/// A motion of all joints.
#[derive(Clone, Debug)]
pub struct Moving<const N: usize> {
    path: JointMove<N>,
}

impl<const N: usize> Moving<N> {
    /// From the held joint angles to `target` (rad), under the procedure's
    /// speed and the joints' own (rad/s).
    pub fn new(start: [f64; N], target: [f64; N], env: &Env<'_, N>) -> Self {
        let motion = &env.procedure.motion;
        Self {
            path: JointMove::new(
                start,
                target,
                motion.speed_rad_s,
                env.speeds,
                motion.acceleration_rad_s2,
            ),
        }
    }

    /// One tick.
    pub fn step(&mut self, env: &Env<'_, N>, hold: &mut JointSetpoint<N>) -> Next<N> {
        *hold = self.path.at(env.elapsed_s);
        let motion = &env.procedure.motion;
        let mut worst = 0.0f64;
        for (wanted, is) in hold.q.iter().zip(&env.snapshot.q) {
            worst = worst.max((wanted - is).abs());
        }
        let limits = &env.procedure.limits;
        if worst > limits.path_rad {
            return Next::fail(Fault::PathDeviation, worst, limits.path_rad);
        }
        let over = env.elapsed_s - self.path.duration_s();
        if over < 0.0 {
            return Next::Stay;
        }
        if worst <= motion.tolerance_rad && env.joint_speed <= motion.tolerance_rad {
            *hold = JointSetpoint {
                q: *self.path.target(),
                dq: [0.0; N],
            };
            return Next::Enter(Activity::Idle, None);
        }
        if over > motion.settle_s {
            return Next::fail(Fault::MotionTimeout, worst, motion.tolerance_rad);
        }
        Next::Stay
    }
}
