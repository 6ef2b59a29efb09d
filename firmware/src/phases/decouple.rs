//! Leaving the sphere. At high stiffness the setpoint moves back along the
//! approach until the magnet lets go and the TCP has followed.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::Fault;

use super::{Activity, CartesianState, Env, Next, REST_SPEED_RAD_S};
use crate::motion::LineMove;

/// Acceleration of the setpoint, in m/s².
const ACCELERATION: f64 = 0.25;

/// How far the TCP has followed, in m, when the magnet has certainly let go: there it pulls with less than 1 N. An
/// elastic arm that it still holds has followed by 4 mm at most (7,000 N m/rad, stretched).
const FREED_M: f64 = 0.005;
/// Time in ms for which a large force may be a wrong estimate from there on.
const FREED_MS: u16 = 50;

/// Speed in rad/s below which a joint of an arm that is free may still move when its time is over. A Panda's elbow that
/// friction had kept from its target moved with 0.08 rad/s.
const ELBOW_RAD_S: f64 = 0.2;

/// Moves back along the approach.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Decoupling {
    start: Vector3<f64>,
    line: LineMove,
    over_s: f64,
    /// Time in ms for which the magnet explains a large force.
    pub(super) pull_ms: u16,
}

impl Decoupling {
    /// Sets the setpoint to the measured pose, raises the stiffness and starts.
    pub(crate) fn new<const N: usize>(env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Self {
        let decouple = &env.procedure.decouple;
        let tcp = &env.snapshot.tcp;
        cartesian.relatch(env.snapshot, cartesian.setpoint.rotation);
        cartesian.soften(env, decouple.pull_n_m());
        let line = LineMove::new(
            -cartesian.direction,
            decouple.speed_m_s,
            ACCELERATION,
            decouple.retreat_m,
        );
        Self {
            start: tcp.position,
            line,
            over_s: 0.0,
            // A slow spring may take longer than the count holds.
            pull_ms: (decouple.pull_s() * 1e3) as u16,
        }
    }

    /// One tick.
    pub(crate) fn step<const N: usize>(&mut self, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Next<N> {
        let decouple = &env.procedure.decouple;
        let (displacement, velocity) = self.line.step(env.period_s);
        cartesian.setpoint.position = self.start + displacement;
        cartesian.setpoint.velocity.fixed_rows_mut::<3>(0).copy_from(&velocity);
        let followed = -(env.snapshot.tcp.position - self.start).dot(&cartesian.direction);
        if followed > FREED_M {
            self.pull_ms = self.pull_ms.min(FREED_MS);
        }
        if !self.line.finished() {
            return Next::Stay;
        }
        self.over_s += env.period_s;
        if followed >= decouple.free_m && env.joint_speed <= REST_SPEED_RAD_S {
            return Next::Enter(Activity::Idle, None);
        }
        if self.over_s > decouple.settle_s {
            // The nest is off where the TCP has followed: only the elbow still moves, and idle holds it.
            return if followed >= decouple.free_m && env.joint_speed <= ELBOW_RAD_S {
                Next::Enter(Activity::Idle, None)
            } else {
                Next::fail(Fault::StillCoupled, followed, decouple.free_m)
            };
        }
        Next::Stay
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phases::scene::Scene;

    // Fails if the magnet explains a force for its whole time once the nest is certainly off the sphere, for a shorter
    // time before, or again when the arm is pushed back.
    #[test]
    fn the_magnet_explains_no_force_on_a_nest_that_is_off() {
        let direction = Vector3::new(0.0, 0.6, -0.8);
        let mut scene = Scene::new();
        let mut cartesian = scene.engaged(direction);
        let mut phase = Decoupling::new(&scene.env(), &mut cartesian);
        let start = scene.snapshot.tcp.position;
        for (followed, pull_ms) in [(0.0, 250), (0.0049, 250), (0.0051, 50), (0.0, 50)] {
            scene.snapshot.tcp.position = start - direction * followed;
            phase.step(&scene.env(), &mut cartesian);
            assert_eq!(phase.pull_ms, pull_ms, "{followed} m");
        }
    }

    // Fails if the arm counts as free before it has followed or while it still moves fast, if a magnet that
    // holds it is reported with another way than that against the approach, or if the time for which
    // the magnet explains a force is not that of the spring: 15 N at 2000 N/m and 50 mm/s take 0.15 s.
    #[test]
    fn an_arm_is_free_when_it_has_followed_and_rests() {
        let direction = Vector3::new(0.0, 0.6, -0.8);
        let run = |followed: f64, joint_speed: f64| {
            let mut scene = Scene::new();
            let mut cartesian = scene.engaged(direction);
            let mut phase = Decoupling::new(&scene.env(), &mut cartesian);
            assert_eq!(phase.pull_ms, 250);
            scene.snapshot.tcp.position -= direction * followed;
            scene.joint_speed = joint_speed;
            for k in 1..10_000_u32 {
                match phase.step(&scene.env(), &mut cartesian) {
                    Next::Stay => {}
                    Next::Enter(Activity::Idle, None) => return Ok(k),
                    Next::Fail(found) => {
                        assert_eq!((found.fault, found.limit), (Fault::StillCoupled, 0.03));
                        assert!((found.value - followed).abs() < 1e-12);
                        return Err(k);
                    }
                    Next::Enter(..) => panic!("another phase"),
                }
            }
            panic!("it never ends")
        };
        // 50 mm at 50 mm/s with 0.25 m/s² at both ends: 1.2 s, to 0.1 mm.
        let end = run(0.031, 0.019).expect("free");
        assert!((1_170..=1_200).contains(&end), "{end} ms");
        let late = run(0.029, 0.019).expect_err("it still hangs");
        assert!((i64::from(late) - i64::from(end) - 3_000).abs() <= 1, "{late} ms");
        // The elbow of an arm that is free may still move slowly when its time is over; a faster joint may not.
        assert_eq!(run(0.031, 0.021), Ok(late));
        assert_eq!((run(0.031, 0.201), run(0.029, 0.1)), (Err(late), Err(late)));
    }
}
