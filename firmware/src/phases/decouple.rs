//! Leaving the sphere: stiff, the setpoint backs off along the approach until
//! the magnet lets go and the TCP has followed.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::Fault;

use super::{Activity, Env, Next, Task};
use crate::motion::LineMove;

/// Acceleration of the retreating setpoint, in m/s².
const ACCELERATION: f64 = 0.25;

/// Backing off.
#[derive(Clone, Copy, Debug)]
pub struct Decoupling {
    start: Vector3<f64>,
    line: LineMove,
    over_s: f64,
}

impl Decoupling {
    /// Re-latches the setpoint to the measured pose, stiffens and backs off.
    pub fn new<const N: usize>(env: &Env<'_, N>, task: &mut Task<N>) -> Self {
        let decouple = &env.procedure.decouple;
        let tcp = &env.snapshot.tcp;
        task.relatch(env.snapshot, task.setpoint.rotation);
        task.soften(env, decouple.stiffness_n_m);
        let line = LineMove::new(-task.direction, decouple.speed_m_s, ACCELERATION, decouple.retreat_m);
        Self {
            start: tcp.origin,
            line,
            over_s: 0.0,
        }
    }

    /// One tick.
    pub fn step<const N: usize>(&mut self, env: &Env<'_, N>, task: &mut Task<N>) -> Next<N> {
        let decouple = &env.procedure.decouple;
        let (displacement, velocity) = self.line.step(env.period_s);
        task.setpoint.position = self.start + displacement;
        task.setpoint.velocity.fixed_rows_mut::<3>(0).copy_from(&velocity);
        let followed = -(env.snapshot.tcp.origin - self.start).dot(&task.direction);
        if !self.line.finished() {
            return Next::Stay;
        }
        self.over_s += env.period_s;
        if followed >= decouple.free_m && env.joint_speed <= env.procedure.motion.tolerance_rad {
            return Next::Enter(Activity::Idle, None);
        }
        if self.over_s > decouple.settle_s {
            return Next::fail(Fault::StillCoupled, followed, decouple.free_m);
        }
        Next::Stay
    }
}
