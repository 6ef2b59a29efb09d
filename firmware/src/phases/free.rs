//! Free-space motion in joint coordinates: home to approach frame and back.

use spherecal_shared::protocol::host::Fault;

use super::speed_scaling::{SpeedScaling, joint_load, tcp_load};
use super::{Activity, Env, Next, REST_SPEED_RAD_S};
use crate::law::JointSetpoint;
use crate::motion::JointMove;
use crate::safety::Violation;

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
        let load = tcp_load(env, &hold.dq).max(joint_load(env, &hold.dq));
        let felt = env.force_n / env.procedure.limits.soft_force_n;
        let scaling = self.scaling.step(load, felt, env.period_s);
        self.along_s += scaling * (env.elapsed_s - self.elapsed_s);
        self.elapsed_s = env.elapsed_s;
        *hold = self.path.at(self.along_s);
        for speed in &mut hold.dq {
            *speed *= scaling;
        }
        let motion = &env.procedure.motion;
        let (mut worst, mut joint) = (0.0f64, 0);
        for i in 0..N {
            let error = (hold.q[i] - env.snapshot.q[i]).abs();
            if error > worst {
                (worst, joint) = (error, i as u8 + 1);
            }
        }
        let limits = &env.procedure.limits;
        let deviation = Violation {
            joint,
            ..Violation::new(Fault::PathDeviation, worst, limits.path_rad)
        };
        if worst > limits.path_rad {
            return Next::Fail(deviation);
        }
        if self.along_s < self.path.duration_s() {
            // At the slowest speed for long: something holds the arm.
            self.over_s = if self.scaling.is_slowest() {
                self.over_s + env.period_s
            } else {
                0.0
            };
            if self.over_s > motion.settle_s {
                return Next::Fail(deviation);
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
            let timeout = Violation {
                joint,
                ..Violation::new(Fault::MotionTimeout, worst, motion.tolerance_rad)
            };
            return Next::Fail(env.excess.map_or(timeout, |excess| Violation {
                joint: excess.joint,
                ..Violation::new(Fault::Disturbance, excess.torque, excess.limit)
            }));
        }
        Next::Stay
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::law::Excess;
    use crate::phases::scene::Scene;
    use crate::testing::HOME;

    /// A motion of joint 1 by 0.1 rad whose arm follows with an error of `off` (rad); runs it at `speed`
    /// (rad/s) for `ticks`. Returns the tick of its end, and how it ended.
    fn run(scene: &mut Scene, off: f64, speed: f64, ticks: u32) -> Option<(u32, Result<(), (Fault, f64, f64)>)> {
        let mut target = HOME;
        target[0] += 0.1;
        let mut hold = JointSetpoint { q: HOME, dq: [0.0; 7] };
        let mut phase = Moving::new(HOME, target, &scene.env());
        scene.joint_speed = speed;
        (1..=ticks).find_map(|tick| {
            scene.elapsed_s = f64::from(tick) * 1e-3;
            let before = hold;
            match phase.step(&scene.env(), &mut hold) {
                Next::Stay => {
                    let change = hold.q[0] - before.q[0];
                    assert!((change - 0.5e-3 * (hold.dq[0] + before.dq[0])).abs() < 1e-6);
                    scene.snapshot.q = hold.q;
                    scene.snapshot.q[2] += off;
                    None
                }
                Next::Enter(Activity::Idle, None) => {
                    assert_eq!((hold.q, hold.dq), (target, [0.0; 7]));
                    Some((tick, Ok(())))
                }
                Next::Enter(..) => panic!("another phase"),
                Next::Fail(found) => Some((tick, Err((found.fault, found.value, found.limit)))),
            }
        })
    }

    // Fails if the measured speed slows a motion down: it is late, and the motion would swing with it. At
    // 2 rad/s of all joints the TCP is faster than its soft limit.
    #[test]
    fn the_setpoint_tells_the_speed() {
        let mut scene = Scene::at(&HOME, &[2.0; 7]);
        assert!(scene.snapshot.tcp_speed() > scene.procedure.limits.soft_speed_m_s);
        assert_eq!(run(&mut scene, 0.0, 0.0, 9_000), Some((601, Ok(()))));
        // A setpoint that is too fast does.
        scene.procedure.limits.soft_speed_m_s = 0.05;
        let (tick, end) = run(&mut scene, 0.0, 0.0, 9_000).expect("it ends");
        assert!(tick > 900 && end == Ok(()), "{tick}: {end:?}");
    }

    // Fails if the tolerance of the angle serves as a speed: a motion ends with an error below the
    // tolerance at up to 20 mrad/s, however small or large the tolerance is.
    #[test]
    fn a_tolerance_is_an_angle() {
        let timeout = Fault::MotionTimeout;
        for tolerance in [1e-3, 0.05] {
            let mut scene = Scene::new();
            scene.procedure.motion.tolerance_rad = tolerance;
            // By the acceleration of 1.6 rad/s²: sqrt(5.7735 * 0.1 / 1.6) s.
            let end = Some((601, Ok(())));
            assert_eq!(run(&mut scene, 0.99 * tolerance, 0.0199, 9_000), end);
            let mut scene = Scene::new();
            scene.procedure.motion.tolerance_rad = tolerance;
            let (tick, fault) = run(&mut scene, 0.0, 0.0201, 9_000).expect("it never rests");
            assert!((tick.abs_diff(3_601)) <= 1, "3 s later: {tick}");
            assert_eq!(fault.map_err(|found| found.0), Err(timeout));
            let mut scene = Scene::new();
            scene.procedure.motion.tolerance_rad = tolerance;
            let fault = run(&mut scene, 1.01 * tolerance, 0.0, 9_000)
                .expect("it is not there")
                .1;
            let (fault, value, limit) = fault.expect_err("a fault");
            assert_eq!((fault, limit), (timeout, tolerance));
            assert!((value - 1.01 * tolerance).abs() < 1e-12);
        }
    }

    // Fails if an arm may be farther from its path than the limit, or if one that is slowed down for as
    // long as a motion may settle goes on.
    #[test]
    fn an_arm_keeps_to_its_path() {
        let mut scene = Scene::new();
        assert_eq!(run(&mut scene, 0.099, 0.0, 500), None);
        let (tick, fault) = run(&mut Scene::new(), 0.101, 0.0, 500).expect("too far");
        let (fault, value, limit) = fault.expect_err("a fault");
        assert_eq!((tick, fault, limit), (2, Fault::PathDeviation, 0.1));
        assert!((value - 0.101).abs() < 1e-3);
        let mut scene = Scene::new();
        scene.force_n = 1e3;
        // From 1 to 0.05 at 5/s takes 190 ms.
        let (tick, fault) = run(&mut scene, 0.0, 0.0, 9_000).expect("something holds it");
        assert!(tick.abs_diff(3_190) <= 2, "{tick}");
        assert_eq!(fault.map_err(|found| found.0), Err(Fault::PathDeviation));
    }

    // Fails if a motion does not slow down from the soft force on, 40 N, or before.
    #[test]
    fn a_force_slows_a_motion_down() {
        let end = |force_n: f64| {
            let mut scene = Scene::new();
            scene.force_n = force_n;
            let (tick, end) = run(&mut scene, 0.0, 0.0, 9_000).expect("an end");
            end.map(|()| tick)
        };
        let free = end(0.0).expect("arrived");
        assert_eq!(end(40.0), Ok(free));
        assert_ne!(end(40.1), Ok(free));
    }

    // Fails if a motion that does not reach its target names another joint than the worst, or takes a disturbance beyond
    // its bound for friction.
    #[test]
    fn a_motion_names_the_joint_that_does_not_come() {
        let reported = |off: f64, excess: Option<Excess>| {
            let mut scene = Scene::new();
            scene.excess = excess;
            let mut hold = JointSetpoint { q: HOME, dq: [0.0; 7] };
            let mut phase = Moving::new(HOME, HOME, &scene.env());
            scene.snapshot.q[4] -= off;
            (1..4_000).find_map(|_| match phase.step(&scene.env(), &mut hold) {
                Next::Fail(found) => Some((found.fault, found.joint, found.limit)),
                _ => None,
            })
        };
        assert_eq!(reported(0.03, None), Some((Fault::MotionTimeout, 5, 0.02)));
        assert_eq!(reported(0.11, None), Some((Fault::PathDeviation, 5, 0.1)));
        let excess = Excess {
            joint: 7,
            torque: 3.9,
            limit: 3.3,
        };
        assert_eq!(reported(0.03, Some(excess)), Some((Fault::Disturbance, 7, 3.3)));
    }
}
