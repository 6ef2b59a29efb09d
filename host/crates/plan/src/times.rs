//! The durations of a plan's parts.
//!
//! Motions follow the controller's rest-to-rest quintic; recordings and couplings take what the procedure says. What neither
//! says was measured in simulated campaigns on `as_measured`.

use std::collections::BTreeSet;

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Uniform};
use spherecal_model::chain::{Chain, TcpPose, rotation_of};
use spherecal_shared::procedure::{Limits, Motion, Procedure, Turn};
use spherecal_shared::robot::{JointLimits, Robot};

use super::order::one_way;
use super::path::move_angle;
use super::types::{Plan, Visit};

/// Coming to rest after a turn, and the exchange of messages, in s.
const SETTLE_S: f64 = 0.42;
/// What of it an elbow takes to come to its angle, in s: arms without one are that much sooner at rest (UR5e, UR10e).
const ELBOW_S: f64 = 0.22;
/// Exchange of messages at a pose that is only passed, in s.
const PASS_S: f64 = 0.1;
/// Descent to the contact, and leaving the sphere, in s, of a visit.
const VISIT_S: f64 = 3.5;
/// Coming to rest after a joint motion, in s.
const REST_S: f64 = 0.2;

/// Time of a quintic from rest to rest over `distance`, in s. Its peak speed is 1.875 times the
/// mean; its peak acceleration is 5.774 times the distance over the time squared.
fn quintic_s(distance: f64, speed: f64, acceleration: f64) -> f64 {
    (1.875 * distance / speed).max((5.774 * distance / acceleration).sqrt())
}

/// Time of a turn about a sphere by `angle` (rad), in s, whose joints move by `swings` of their slow speeds (s): the
/// controller slows down where a joint would be faster.
fn turning_s(turn: &Turn, angle: f64, swings: f64) -> f64 {
    // Of the first half: the second is its mirror image.
    const STEPS: u32 = 8;
    let fast_s = quintic_s(angle, turn.speed_rad_s, turn.acceleration_rad_s2);
    let slowed = |step: u32| {
        let x = (f64::from(step) + 0.5) / f64::from(2 * STEPS);
        (30.0 * (x * (1.0 - x)).powi(2) * swings).max(fast_s)
    };
    (0..STEPS).map(slowed).sum::<f64>() / f64::from(STEPS)
}

/// Time of a joint motion between two configurations (rad), in s.
fn moving_s(motion: &Motion, a: &[f64], b: &[f64]) -> f64 {
    let distance = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    quintic_s(distance, motion.speed_rad_s, motion.acceleration_rad_s2)
}

/// Time of a joint motion with the default procedure, in s.
pub(super) fn motion_s(a: &[f64], b: &[f64]) -> f64 {
    moving_s(&Motion::default(), a, b)
}

/// A pose about a sphere with its joint angles, in rad.
type Posed<'a> = (&'a TcpPose, &'a [f64]);

/// The times of an arm's turns about a sphere.
#[derive(Clone)]
pub(super) struct Turns {
    turn: Turn,
    /// Speeds of the joints above which a turn slows down, in rad/s.
    slow_rad_s: Vec<f64>,
}

impl Turns {
    pub(super) fn new(procedure: &Procedure, limits: &[JointLimits]) -> Self {
        let share = Limits::SLOW_TURN_SHARE * Limits::MOTION_SHARE * procedure.limits.velocity_share;
        Self {
            turn: procedure.turn,
            slow_rad_s: limits.iter().map(|limit| share * limit.velocity_rad_s).collect(),
        }
    }

    /// Time of a turn between two poses, in s.
    pub(super) fn between_s(&self, a: Posed<'_>, b: Posed<'_>) -> f64 {
        let swing = |((a, b), slow): ((&f64, &f64), &f64)| (a - b).abs() / slow;
        let swings = a.1.iter().zip(b.1).zip(&self.slow_rad_s).map(swing);
        turning_s(&self.turn, move_angle(a.0, b.0), swings.fold(0.0, f64::max))
    }
}

/// Time of a recording, in s, with coming to rest before it.
pub(super) fn record_s(procedure: &Procedure) -> f64 {
    SETTLE_S + procedure.law.stiffness_ramp_s + 1e-3 * f64::from(procedure.record.samples) + procedure.seating.check_s
}

/// Predicted time of turning through the poses of a visit and recording, in s.
fn poses_s(procedure: &Procedure, turns: &Turns, visit: &Visit) -> f64 {
    let record_s = record_s(procedure);
    let mut here = TcpPose {
        position: visit.position_m.into(),
        rotation: rotation_of(&visit.approach.orientation),
        elbow: visit.approach.elbow_rad,
    };
    let mut joints = &visit.approach.joints;
    let mut time = 0.0;
    for pose in &visit.poses {
        let next = TcpPose {
            position: here.position,
            rotation: rotation_of(&pose.orientation),
            elbow: pose.elbow_rad,
        };
        time += turns.between_s((&here, joints), (&next, &pose.joints));
        time += match (pose.via, pose.elbow_rad) {
            (true, _) => PASS_S,
            (false, Some(_)) => record_s,
            (false, None) => record_s - ELBOW_S,
        };
        here = next;
        joints = &pose.joints;
    }
    time
}

/// Predicted time of a whole plan without a fault, in s: travelling, coupling, turning, recording, and, where asked for
/// (`couple_again`), coupling every sphere once more.
pub fn robot_time(plan: &Plan, robot: &Robot, procedure: &Procedure, couple_again: bool) -> f64 {
    let home = plan.home.joints.as_slice();
    let approach = &procedure.approach;
    // The spring that pulls the arm on grows until the force of contact is there.
    let contact_s = approach.trigger_n / (approach.stiffness_n_m[2] * approach.speed_m_s);
    let visit_s = VISIT_S + contact_s + approach.tare_s + procedure.couple.hold_s + procedure.seating.test_s;
    let travel_s = |a: &[f64], b: &[f64]| moving_s(&procedure.motion, a, b) + REST_S;
    let limits: Vec<JointLimits> = robot.joints.iter().map(|joint| joint.limits).collect();
    let turns = Turns::new(procedure, &limits);
    let mut here = home;
    let mut time = 0.0;
    for (number, visit) in plan.spheres.iter().enumerate() {
        if visit.over_home {
            time += travel_s(here, home);
            here = home;
        }
        time += travel_s(here, &visit.approach.joints) + visit_s + poses_s(procedure, &turns, visit);
        here = &visit.approach.joints;
        let is_last = plan
            .spheres
            .get(number + 1)
            .is_none_or(|next| next.place != visit.place);
        if couple_again && is_last {
            for again in second_visits(plan, visit.place, |_| true) {
                time += travel_s(here, &again.approach.joints) + visit_s;
                here = &again.approach.joints;
            }
        }
    }
    time + travel_s(here, home)
}

/// The first visit of a plan that `counts` to each sphere of a placement, in the order of least travel from the last visit
/// there to home: after all poses, each sphere is coupled once more.
pub fn second_visits(plan: &Plan, place: u32, counts: impl Fn(&Visit) -> bool) -> Vec<&Visit> {
    let there = || plan.spheres.iter().filter(|visit| visit.place == place);
    let mut seen = BTreeSet::new();
    let first: Vec<&Visit> = there()
        .filter(|visit| counts(visit) && seen.insert(visit.sphere_id))
        .collect();
    let Some(last) = there().next_back() else {
        return first;
    };
    let at = |k: usize| match first.get(k) {
        Some(visit) => &visit.approach.joints,
        None if k == first.len() => &plan.home.joints,
        None => &last.approach.joints,
    };
    let order = one_way(first.len(), |a, b| motion_s(at(a), at(b)));
    order.into_iter().filter_map(|k| first.get(k).copied()).collect()
}

/// Moves every approach waypoint by up to `error_m` along each axis of F0, as quick hand-guiding
/// does (uniform, from `seed`), and adapts the joints.
///
/// Two visits to one sphere in one placement share the error, because the sphere was taught once.
/// If the shifted waypoint is out of reach, the planned one stays.
pub fn teach(plan: &mut Plan, chain: &Chain, error_m: f64, seed: u64) {
    let Ok(axis) = Uniform::new_inclusive(-error_m.abs(), error_m.abs()) else {
        return;
    };
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ 0x7465_6163_6800_0000);
    let mut taught: Vec<((u32, u32), Vector3<f64>)> = Vec::new();
    for visit in &mut plan.spheres {
        let key = (visit.sphere_id, visit.place);
        let shift = if let Some((_, shift)) = taught.iter().find(|(k, _)| *k == key) {
            *shift
        } else {
            let shift = Vector3::from_fn(|_, _| axis.sample(&mut random));
            taught.push((key, shift));
            shift
        };
        let position = Vector3::from(visit.approach.position_m) + shift;
        let pose = TcpPose {
            position,
            rotation: rotation_of(&visit.approach.orientation),
            elbow: visit.approach.elbow_rad,
        };
        if let Some(joints) = chain.follow(&pose, &visit.approach.joints)
            && chain.limit_margin(&joints) >= 0.0
        {
            visit.approach.position_m = position.into();
            visit.approach.joints = joints;
        }
    }
}
