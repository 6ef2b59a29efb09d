//! Turning about the sphere to the next pose, at 20 N/m. The TCP stays where the
//! nest seated; the tool and the elbow turn.

use nalgebra::{Matrix3, Vector3};
use spherecal_shared::procedure::Limits;
use spherecal_shared::protocol::host::Fault;

use super::record::{RESTART_FACTOR, RecordingPose};
use super::speed_scaling::{SpeedScaling, joint_load};
use super::{Activity, CartesianState, Env, Next, PATIENT_SHARE, STILL_S};
use crate::Report;
use crate::law::{NullSpace, rotation_about, rotation_error};
use crate::motion::TurnMove;
use crate::safety::energy_share;

/// Motion of the null space during a turn.
#[derive(Clone, Copy, Debug)]
enum NullMove<const N: usize> {
    Elbow,
    Posture([f64; N], [f64; N]),
    Stay,
}

/// A checked pose command.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PoseTarget<const N: usize> {
    /// Id of the pose.
    pub(crate) id: u32,
    /// Orientation of FT in F0.
    pub(crate) rotation: Matrix3<f64>,
    /// Elbow angle, in rad, if the arm has one.
    pub(crate) elbow: Option<f64>,
    /// Posture, in rad, for a redundant arm without an elbow angle.
    pub(crate) posture: Option<[f64; N]>,
    /// Whether to record there.
    pub(crate) record: bool,
}

/// Turns to a pose.
#[derive(Clone, Debug)]
pub(crate) struct Turning<const N: usize> {
    pose: PoseTarget<N>,
    path: TurnMove,
    null: NullMove<N>,
    /// Time along the path, in s. It runs slower than the clock while a joint is
    /// fast.
    along_s: f64,
    scaling: SpeedScaling,
    over_s: f64,
    still_s: f64,
    /// By how much the setpoint of the orientation leads the pose, against friction: a rotation vector in F0, in rad.
    lead: Vector3<f64>,
}

impl<const N: usize> Turning<N> {
    /// A turn from the present setpoint to the pose.
    pub(crate) fn new(pose: PoseTarget<N>, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Self {
        let turn = &env.procedure.turn;
        cartesian.soften(env, turn.stiffness_n_m);
        cartesian.setpoint.position = *cartesian.watch.centre();
        if pose.elbow.is_some() && !matches!(cartesian.null_space, NullSpace::Elbow { .. }) {
            // The turn before ended with a held posture.
            cartesian.null_space = NullSpace::at(env.snapshot);
        }
        let (null, elbow) = match (pose.elbow, pose.posture, cartesian.null_space) {
            (Some(target), _, NullSpace::Elbow { angle, .. }) => (NullMove::Elbow, (angle, target)),
            (_, Some(target), _) => {
                let start = match cartesian.null_space {
                    NullSpace::Posture(q) => q,
                    _ => env.snapshot.q,
                };
                (NullMove::Posture(start, target), (0.0, 0.0))
            }
            _ => (NullMove::Stay, (0.0, 0.0)),
        };
        let path = TurnMove::new(
            cartesian.setpoint.rotation,
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
            scaling: SpeedScaling::default(),
            over_s: 0.0,
            still_s: 0.0,
            lead: Vector3::zeros(),
        }
    }

    /// Advances along the path by one tick, more slowly the faster a joint is. Near
    /// a singularity a joint moves fast although the tool turns slowly. A heavy arm has much
    /// kinetic energy before any joint is fast (a UR30 with its tool 5 J).
    fn advance(&mut self, env: &Env<'_, N>) {
        let mut share = 0.0f64;
        for (dq, limit) in env.snapshot.dq.iter().zip(env.speeds) {
            share = share.max(dq.abs() / limit);
        }
        let load = (share / Limits::SLOW_TURN_SHARE)
            .max(energy_share(env.snapshot) / Limits::MOTION_SHARE)
            .max(joint_load(env, &env.snapshot.dq));
        self.along_s += self.scaling.step(load, 0.0, env.period_s) * env.period_s;
    }

    /// One tick.
    pub(crate) fn step(&mut self, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Next<N> {
        self.advance(env);
        let at = self.path.at(self.along_s);
        let rate = self.scaling.rate();
        let lead = self.lead.norm();
        cartesian.setpoint.rotation = if lead > 0.0 {
            rotation_about(&(self.lead / lead), lead) * at.rotation
        } else {
            at.rotation
        };
        cartesian.setpoint.acceleration = at.angular_acceleration * (rate * rate);
        cartesian
            .setpoint
            .velocity
            .fixed_rows_mut::<3>(3)
            .copy_from(&(at.angular * rate));
        match &self.null {
            NullMove::Elbow => {
                cartesian.null_space = NullSpace::Elbow {
                    angle: at.elbow,
                    rate: at.elbow_rate * rate,
                    acceleration: at.elbow_acceleration * (rate * rate),
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
                cartesian.null_space = NullSpace::Posture(posture);
            }
            NullMove::Stay => {}
        }
        let most = env.procedure.limits.turn_rad;
        let turns = self.along_s < self.path.duration_s();
        if turns && cartesian.surely_within(env.snapshot, most) {
            return Next::Stay;
        }
        let off = rotation_error(&at.rotation, &env.snapshot.tcp.rotation);
        let error = off.norm();
        if error > most {
            return Next::fail(Fault::PathDeviation, error, most);
        }
        if turns {
            return Next::Stay;
        }
        self.over_s += env.period_s;
        let turn = &env.procedure.turn;
        let elbow_error = cartesian.null_space.elbow_error(env.snapshot).abs();
        let (mut tolerance, mut elbow_tolerance) = (turn.tolerance_rad, turn.elbow_tolerance_rad);
        let patient = self.over_s > PATIENT_SHARE * turn.settle_s;
        if patient {
            tolerance *= env.snapshot.softened(env.procedure.law.rotation_nm_rad).min(WIDEST);
            elbow_tolerance *= ELBOW_WIDEST;
            if error > tolerance {
                self.lead += off * (LEAD_PER_S * env.period_s);
                let longest = LEAD_MOST * tolerance;
                self.lead *= (longest / self.lead.norm()).min(1.0);
            }
        }
        let there = error <= tolerance && elbow_error <= elbow_tolerance;
        if there && patient {
            self.null = NullMove::Stay;
            cartesian.hold_posture(env.snapshot);
        }
        if there && !self.pose.record {
            return Next::Enter(Activity::Coupled, Some(Report::Passed { pose: self.pose.id }));
        }
        let slow_rad_s = SLOW_FACTOR * turn.still_rad_s;
        self.still_s = if there && env.joint_speed <= slow_rad_s {
            self.still_s + env.period_s
        } else {
            0.0
        };
        if self.still_s >= STILL_S {
            return Next::Enter(
                Activity::Recording(RecordingPose::new(self.pose.id, env, cartesian)),
                None,
            );
        }
        let most_s = if there {
            turn.most_s(env.joint_speed)
        } else {
            turn.settle_s
        };
        if self.over_s > most_s {
            let (value, limit) = if error > tolerance {
                (error, tolerance)
            } else if elbow_error > elbow_tolerance {
                (elbow_error, elbow_tolerance)
            } else {
                (env.joint_speed, slow_rad_s)
            };
            return Next::fail(Fault::MotionTimeout, value, limit);
        }
        Next::Stay
    }
}

/// How much wider the tolerance of the orientation gets at most. It is as much wider as the drive's delay makes the spring
/// softer: the moment that friction may leave stays the same. The recording takes the pose as it is.
const WIDEST: f64 = 3.0;
/// An arm that friction keeps from its pose for [`PATIENT_SHARE`] is turned further: the setpoint leads the pose by the integral of
/// the error, in 1/s, a sixth of what the softest spring bears (12 rad/s); at most by this many tolerances.
const LEAD_PER_S: f64 = 2.0;
const LEAD_MOST: f64 = 3.0;
/// How much wider the tolerance of the elbow is after [`PATIENT_SHARE`]. Dry friction of 1 to 2 N m holds the elbow of an arm of
/// 12 N m at the wrist (a Panda) 0.18 rad from its target.
const ELBOW_WIDEST: f64 = 2.0;

/// The arm need not be still at the end of a turn: it comes to rest while the stiffness falls to that of the recording, which
/// begins when it is.
const SLOW_FACTOR: f64 = RESTART_FACTOR;

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use spherecal_shared::robot::elbow::elbow;
    use spherecal_shared::robot::{Arm, iiwa7, iiwa7_tool};

    use super::*;
    use crate::law::rotation_about;
    use crate::law::{Actuation, Snapshot};
    use crate::phases::scene::Scene;
    use crate::testing::HOME;

    /// The pose of a scene, turned about z by an angle (rad).
    fn turned_by(scene: &Scene, angle: f64) -> PoseTarget<7> {
        PoseTarget {
            id: 1,
            rotation: rotation_about(&Vector3::z(), angle) * scene.snapshot.tcp.rotation,
            elbow: None,
            posture: None,
            record: true,
        }
    }

    /// Value and limit of the fault of a turn by `angle` (rad), and of the elbow by `elbow_by` (rad), whose
    /// arm does not move and is said to have this speed (rad/s).
    fn timeout(angle: f64, elbow_by: f64, joint_speed: f64) -> (f64, f64) {
        let mut scene = Scene::new();
        scene.joint_speed = joint_speed;
        let mut cartesian = scene.engaged(-Vector3::z());
        let now = elbow(&scene.snapshot.frames).expect("an elbow");
        let pose = PoseTarget {
            elbow: Some(now.angle + elbow_by),
            ..turned_by(&scene, angle)
        };
        let mut phase = Turning::new(pose, &scene.env(), &mut cartesian);
        for _ in 0..20_000 {
            match phase.step(&scene.env(), &mut cartesian) {
                Next::Stay => {}
                Next::Fail(found) => {
                    assert_eq!(found.fault, Fault::MotionTimeout);
                    return (found.value, found.limit);
                }
                Next::Enter(..) => panic!("it is not there"),
            }
        }
        panic!("it never ends");
    }

    // Fails if a turn that does not end reports something else than what keeps it from its end: first the
    // orientation, then the elbow, then the speed.
    #[test]
    fn a_turn_says_what_keeps_it() {
        for (turn, reported, limit) in [
            (timeout(0.1, 0.2, 1.0), 0.1, 0.02),
            (timeout(0.03, 0.0, 0.0), 0.03, 0.02),
            (timeout(0.01, 0.3, 1.0), 0.3, 0.2),
            (timeout(0.01, 0.05, 1.0), 1.0, 0.006),
            (timeout(0.01, 0.05, 0.01), 0.01, 0.006),
        ] {
            assert!((turn.0 - reported).abs() < 1e-9 && turn.1 == limit, "{turn:?}");
        }
    }

    // Fails if an arm with much kinetic energy goes on at its full speed, or if one with little slows down.
    #[test]
    fn a_heavy_arm_turns_more_slowly() {
        let rate = |tool_kg: f64| {
            let mut tool = iiwa7_tool();
            tool.body.mass_kg = tool_kg;
            let arm = Arm::new(&iiwa7(), &tool).expect("the built-in robot with a tool");
            let mut scene = Scene::new();
            let dq = [0.5, 0.5, 0.0, -0.5, 0.0, 0.0, 0.0];
            scene.snapshot = Snapshot::new(&arm, &HOME, &dq).expect("a mass matrix");
            let mut cartesian = scene.engaged(-Vector3::z());
            let pose = turned_by(&scene, 0.5);
            let mut phase = Turning::new(pose, &scene.env(), &mut cartesian);
            for _ in 0..100 {
                phase.advance(&scene.env());
            }
            phase.scaling.rate()
        };
        assert_eq!(rate(1.5), 1.0);
        assert!(rate(60.0) < 0.9, "{}", rate(60.0));
    }

    // Fails if the setpoint of an arm that friction holds off its pose does not go further after half of its time, away from where
    // the arm is, or goes without bound; or if it does so earlier, or for an arm that is there.
    #[test]
    fn an_arm_that_friction_holds_is_turned_further() {
        for (angle, ends) in [(0.05, LEAD_MOST * 0.02), (0.019, 0.0)] {
            let mut scene = Scene::new();
            scene.joint_speed = 0.07;
            let mut cartesian = scene.engaged(-Vector3::z());
            let pose = turned_by(&scene, angle);
            let mut phase = Turning::new(pose, &scene.env(), &mut cartesian);
            let half_s = PATIENT_SHARE * scene.procedure.turn.settle_s;
            let mut lead = 0.0;
            for _ in 0..3_900 {
                assert!(matches!(phase.step(&scene.env(), &mut cartesian), Next::Stay));
                let from_pose = rotation_error(&cartesian.setpoint.rotation, &pose.rotation);
                let early = phase.over_s > 0.0 && phase.over_s <= half_s;
                assert!(!early || from_pose.norm() < 1e-9, "{} s: {from_pose}", phase.over_s);
                lead = from_pose.z;
            }
            assert!((lead - ends).abs() < 1e-9, "{lead}");
        }
    }

    // Fails if an arm whose springs a late drive makes soft is recorded before it has had half of its time, or
    // not at all. On a prompt drive it never is: see above.
    #[test]
    fn a_soft_joint_has_its_time() {
        let mut scene = Scene::new();
        let late = Actuation::new([0.0; 7], 1e-3, 4e-3);
        let arm = Arm::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
        scene.snapshot = Snapshot::on(&late, &arm, &HOME, &[0.0; 7]).expect("a mass matrix");
        let mut cartesian = scene.engaged(-Vector3::z());
        let pose = turned_by(&scene, 0.05);
        let mut phase = Turning::new(pose, &scene.env(), &mut cartesian);
        let end = (1..20_000).find(|_| match phase.step(&scene.env(), &mut cartesian) {
            Next::Stay => false,
            Next::Enter(Activity::Recording(_), None) => true,
            other => panic!("{other:?}"),
        });
        let turned_s = phase.path.duration_s();
        let waited_s = f64::from(end.expect("it ends")) * 1e-3 - turned_s - STILL_S;
        assert!((waited_s - 2.0).abs() < 0.01, "{waited_s} s");
    }

    // Fails if an arm that is there and does not rest follows its elbow for more than half of its time, holds its joints before
    // that or where the elbow is not there, or if the turn after it leaves the elbow alone.
    #[test]
    fn an_arm_that_drifts_holds_its_joints() {
        for (elbow_by, holds) in [(0.05, true), (0.3, false)] {
            let mut scene = Scene::new();
            scene.joint_speed = 0.07;
            let mut cartesian = scene.engaged(-Vector3::z());
            let now = elbow(&scene.snapshot.frames).expect("an elbow");
            let pose = PoseTarget {
                elbow: Some(now.angle + elbow_by),
                ..turned_by(&scene, 0.0)
            };
            let mut phase = Turning::new(pose, &scene.env(), &mut cartesian);
            let half_s = phase.path.duration_s() + PATIENT_SHARE * scene.procedure.turn.settle_s;
            for tick in 0..3_900 {
                let elbow = matches!(cartesian.null_space, NullSpace::Elbow { .. });
                let since_s = f64::from(tick) * 1e-3 - half_s;
                assert!(since_s.abs() < 0.01 || elbow == (since_s < 0.0 || !holds), "{tick}");
                assert!(matches!(phase.step(&scene.env(), &mut cartesian), Next::Stay));
            }
            let _ = Turning::new(pose, &scene.env(), &mut cartesian);
            assert!(matches!(cartesian.null_space, NullSpace::Elbow { .. }));
        }
    }
}
