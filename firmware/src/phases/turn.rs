//! Turning about the sphere to the next pose, at 20 N/m: the TCP stays where
//! it seated, the tool and the elbow turn.

use nalgebra::Matrix3;
use spherecal_shared::protocol::host::{Event, Fault};

use super::pace::{Pace, joint_load};
use super::record::Recording;
use super::{Activity, Env, Next, Task};
use crate::law::NullSpace;
use crate::motion::TurnMove;

/// Where the null space goes with a turn.
#[derive(Clone, Copy, Debug)]
enum NullMove<const N: usize> {
    Elbow,
    Posture([f64; N], [f64; N]),
    Stay,
}

/// A checked pose command.
#[derive(Clone, Copy, Debug)]
pub struct Pose<const N: usize> {
    /// Id of the pose.
    pub id: u32,
    /// Orientation of FT in F0.
    pub rotation: Matrix3<f64>,
    /// Elbow angle, in rad, where the arm has one.
    pub elbow: Option<f64>,
    /// Posture, in rad, for a redundant arm without an elbow angle.
    pub posture: Option<[f64; N]>,
    /// Whether to record there.
    pub record: bool,
}

/// Turning to a pose.
#[derive(Clone, Debug)]
pub struct Turning<const N: usize> {
    pose: Pose<N>,
    path: TurnMove,
    null: NullMove<N>,
    /// Time along the path, in s: slower than the clock where a joint is fast.
    along_s: f64,
    pace: Pace,
    over_s: f64,
    still_s: f64,
}

impl<const N: usize> Turning<N> {
    /// From the present setpoint to the pose.
    pub fn new(pose: Pose<N>, env: &Env<'_, N>, task: &mut Task<N>) -> Self {
        let turn = &env.procedure.turn;
        task.soften(env, turn.stiffness_n_m);
        task.setpoint.position = *task.watch.centre();
        let (null, elbow) = match (pose.elbow, pose.posture, task.null_space) {
            (Some(target), _, NullSpace::Elbow { angle, .. }) => (NullMove::Elbow, (angle, target)),
            (_, Some(target), _) => {
                let start = match task.null_space {
                    NullSpace::Posture(q) => q,
                    _ => env.snapshot.q,
                };
                (NullMove::Posture(start, target), (0.0, 0.0))
            }
            _ => (NullMove::Stay, (0.0, 0.0)),
        };
        let path = TurnMove::new(
            task.setpoint.rotation,
            pose.rotation,
            elbow,
            turn.speed_rad_s,
            turn.acceleration_rad_s2,
        );
        Self {
            pose,
            path,
            null,
            along_s: 0.0,
            pace: Pace::default(),
            over_s: 0.0,
            still_s: 0.0,
        }
    }

    /// Moves along the path by one tick, the slower the faster a joint is:
    /// near a singularity a slow turn of the tool is a fast one of a joint.
    fn advance(&mut self, env: &Env<'_, N>) {
        let mut share = 0.0f64;
        for (dq, limit) in env.snapshot.dq.iter().zip(env.speeds) {
            share = share.max(dq.abs() / limit);
        }
        let load = (share / BRISK).max(joint_load(env));
        self.along_s += self.pace.step(load, env.period_s) * env.period_s;
    }

    /// One tick.
    pub fn step(&mut self, env: &Env<'_, N>, task: &mut Task<N>) -> Next<N> {
        self.advance(env);
        let at = self.path.at(self.along_s);
        task.setpoint.rotation = at.rotation;
        task.setpoint
            .velocity
            .fixed_rows_mut::<3>(3)
            .copy_from(&(at.angular * self.pace.now()));
        match &self.null {
            NullMove::Elbow => {
                task.null_space = NullSpace::Elbow {
                    angle: at.elbow,
                    rate: at.elbow_rate * self.pace.now(),
                }
            }
            NullMove::Posture(start, target) => {
                let share = if self.path.duration_s() > 0.0 {
                    (self.along_s / self.path.duration_s()).min(1.0)
                } else {
                    1.0
                };
                let mut posture = *target;
                for i in 0..N {
                    posture[i] = start[i] + (target[i] - start[i]) * share;
                }
                task.null_space = NullSpace::Posture(posture);
            }
            NullMove::Stay => {}
        }
        let most = env.procedure.limits.turn_rad;
        let turns = self.along_s < self.path.duration_s();
        if turns && task.surely_within(env.snapshot, most) {
            return Next::Stay;
        }
        let error = task.orientation_error(env.snapshot);
        if error > most {
            return Next::fail(Fault::PathDeviation, error, most);
        }
        if turns {
            return Next::Stay;
        }
        self.over_s += env.period_s;
        let turn = &env.procedure.turn;
        let elbow_error = task.null_space.elbow_error(env.snapshot).abs();
        let there = error <= turn.tolerance_rad && elbow_error <= turn.elbow_tolerance_rad;
        if there && !self.pose.record {
            return Next::Enter(Activity::Coupled, Some(Event::Passed { pose: self.pose.id }));
        }
        self.still_s = if there && env.joint_speed <= turn.still_rad_s {
            self.still_s + env.period_s
        } else {
            0.0
        };
        if self.still_s >= STILL_S {
            return Next::Enter(Activity::Recording(Recording::new(self.pose.id, env, task)), None);
        }
        if self.over_s > turn.settle_s {
            let (value, limit) = if error > turn.tolerance_rad {
                (error, turn.tolerance_rad)
            } else if elbow_error > turn.elbow_tolerance_rad {
                (elbow_error, turn.elbow_tolerance_rad)
            } else {
                (env.joint_speed, turn.still_rad_s)
            };
            return Next::fail(Fault::MotionTimeout, value, limit);
        }
        Next::Stay
    }
}

/// Share of the speed limits beyond which a turn slows down.
const BRISK: f64 = 0.6;

/// How long the arm must have been still to count as settled, in s.
pub(super) const STILL_S: f64 = 0.020;
