//! The retreat from a sphere: against which direction the arm leaves it.
//!
//! Poses are planned for the contact with the sphere, not for leaving it. In a strongly turned pose
//! the straight retreat may end at a joint limit, out of reach, or at the post. Along its own axis the nest comes off with the
//! least force: at 45 degrees to it the arm must pull with 1.4 times as much.

use core::f64::consts::{FRAC_PI_4, TAU};

use nalgebra::{Rotation3, Unit, Vector3};

use super::path::Rules;
use super::scene::Scene;
use super::way::{LIFT_STEP_M, SLACK_M};
use spherecal_model::chain::TcpPose;
use spherecal_shared::procedure::Decouple;

/// Angles to the first choice that a retreat tries, in rad, and directions at each angle.
const TILTS: [f64; 4] = [0.5 * FRAC_PI_4, FRAC_PI_4, 1.4 * FRAC_PI_4, 1.8 * FRAC_PI_4];
const DIRECTIONS: u32 = 8;
/// Angle between the tool and the approach direction, in rad, up to which a pull along the one is as good as along the other.
const UPRIGHT_RAD: f64 = 0.2;
/// Of these angles those to the approach direction that are tried where no retreat is clear. The
/// plate is at a right angle to it.
const AWAY_FROM_THE_PLATE: usize = 3;
/// Distance that a joint keeps to the limit at which it faults while the arm retreats, in rad: the
/// error of the nominal model, and the overshoot.
const ROOM_RAD: f64 = 0.03;

impl Scene {
    /// The direction (towards the sphere, F0, a unit vector) opposite to the best retreat by
    /// `length_m` of an arm that stands at `q` (rad): that nearest to the nest's axis whose retreat is clear and leaves the arm
    /// room. Candidates are that axis, `approach`, the direction from the contact, and directions beside these; `approach` goes
    /// first where it is nearly the axis. If none is clear, it is the one near `approach` that leaves the arm most room.
    /// The tool keeps its orientation. A retreat that failed is not repeated: `failed` of them are
    /// passed over.
    pub fn retreat(&self, q: &[f64], approach: [f64; 3], length_m: f64, failed: usize) -> [f64; 3] {
        let straight = Vector3::from(approach);
        let own = self.nest_axis(q);
        let mut choices = vec![straight, own];
        choices.extend(self.towards_contact(q));
        let axes: Vec<Unit<Vector3<f64>>> = choices.iter().map(|c| Unit::new_normalize(*c)).collect();
        for tilt in TILTS {
            choices.extend(axes.iter().flat_map(|axis| beside(axis, tilt)));
        }
        // A stable sort keeps the approach direction before an axis that is nearly the same.
        let aside = |choice: &Vector3<f64>| choice.angle(&own).max(UPRIGHT_RAD);
        choices.sort_by(|a, b| aside(a).total_cmp(&aside(b)));
        let clear = choices
            .into_iter()
            .filter(|choice| self.leaves_clear(q, (*choice).into(), length_m))
            .nth(failed);
        clear.map_or_else(|| self.roomiest_retreat(q, &straight, length_m, failed), Into::into)
    }

    /// Whether an arm at `q` (rad) has room for a retreat that brings the nest off without much more force than along its own
    /// axis. A nest that stays on its sphere where a turn had to stop could not be brought off otherwise. The retreat is as long
    /// as the default procedure needs to call a nest free; with its whole 50 mm plans had up to 4 % more error.
    pub(super) fn may_leave(&self, q: &[f64]) -> bool {
        let own = self.nest_axis(q);
        let ways = core::iter::once(own).chain(beside(&Unit::new_normalize(own), TILTS[0]));
        let paths = ways.map(|way| self.backed_off(q, &way, Decouple::default().free_m));
        paths.flatten().any(|paths| self.room(&paths) >= 0.0)
    }

    /// The axis of the nest, towards the sphere.
    fn nest_axis(&self, q: &[f64]) -> Vector3<f64> {
        self.chain.pose(q).rotation * Vector3::z()
    }

    /// Whether the retreat of `length_m` against `direction` comes no nearer to anything than a margin
    /// and leaves the arm room.
    pub(super) fn leaves_clear(&self, q: &[f64], direction: [f64; 3], length_m: f64) -> bool {
        self.backed_off(q, &direction.into(), length_m).is_some_and(|paths| {
            self.room(&paths) >= 0.0
                && paths.iter().all(|path| {
                    let refs: Vec<&[f64]> = path.iter().map(Vec::as_slice).collect();
                    let end = path.last().map(|q| self.clearances(q)).unwrap_or_default();
                    // The last clearance is that of the joints, which `room` judges on the whole way.
                    end.split_last().is_some_and(|(_, rest)| {
                        self.too_near(&refs, &vec![0.0; end.len()]) <= SLACK_M
                            && rest.iter().all(|clearance| *clearance >= 0.0)
                    })
                })
        })
    }

    /// Among `straight` and the directions beside it, the roomiest but for `failed`: of those that leave
    /// the arm its room the least tilted, then those that leave it most.
    fn roomiest_retreat(&self, q: &[f64], straight: &Vector3<f64>, length_m: f64, failed: usize) -> [f64; 3] {
        let axis = Unit::new_normalize(*straight);
        let tilts = TILTS.into_iter().take(AWAY_FROM_THE_PLATE);
        let mut ways: Vec<(f64, Vector3<f64>)> = [*straight]
            .into_iter()
            .chain(tilts.flat_map(|tilt| beside(&axis, tilt)))
            .map(|way| {
                let paths = self.backed_off(q, &way, length_m);
                (paths.map_or(f64::NEG_INFINITY, |paths| self.room(&paths)), way)
            })
            .collect();
        // A stable sort keeps the order of the tilts.
        ways.sort_by(|a, b| b.0.min(0.0).total_cmp(&a.0.min(0.0)));
        ways[failed % ways.len()].1.into()
    }

    /// The smallest room after the first configuration of these retreats, in rad; negative where it is
    /// less than a retreat needs: to the end of a joint's range, and to a singular place. An arm that
    /// stands nearer to a singular place may stay as near.
    ///
    /// A Franka's elbow runs through the stretched posture by itself: with the nest 50 mm off, its
    /// joint 4 went on from -41 degrees to the end of its range.
    fn room(&self, paths: &[Vec<Vec<f64>>]) -> f64 {
        let rules = Rules::default();
        let singular = |q: &[f64]| rules.nearest_singular(&self.chain, q).room;
        let least = paths
            .first()
            .and_then(|path| path.first())
            .map_or(0.0, |q| singular(q).min(0.0));
        let ends = self.limits.position_margin_rad + ROOM_RAD;
        let rooms = paths
            .iter()
            .flat_map(|path| path.iter().skip(1))
            .map(|q| (self.chain.limit_margin(q) - ends).min(singular(q) - least));
        rooms.fold(f64::INFINITY, f64::min)
    }

    /// The configurations of a retreat of `length_m` against `direction`, the present one first: for an
    /// elbow that turns as little as it can, and for one that keeps its angle, as the controller wants it.
    /// Friction decides what lies between. `None` where the arm does not reach.
    fn backed_off(&self, q: &[f64], direction: &Vector3<f64>, length_m: f64) -> Option<Vec<Vec<Vec<f64>>>> {
        let start = self.chain.pose(q);
        let parts = (length_m / LIFT_STEP_M).ceil().max(1.0);
        let elbows = [None].into_iter().chain(start.elbow.map(Some));
        let path = |elbow| {
            let mut path = vec![q.to_vec()];
            for part in 1..=parts as usize {
                let pose = TcpPose {
                    position: start.position - direction * (length_m * part as f64 / parts),
                    elbow,
                    ..start
                };
                let next = self.chain.follow(&pose, path.last()?)?;
                path.push(next);
            }
            Some(path)
        };
        elbows.map(path).collect()
    }

    /// Direction from the tool to the ball that is nearest to it, if one is near: that in which the
    /// clearance shrinks fastest.
    fn towards_contact(&self, q: &[f64]) -> Option<Vector3<f64>> {
        let pose = self.chain.pose(q);
        let here = self.clearances(q);
        let nearest = (0..here.len().saturating_sub(3)).min_by(|a, b| here[*a].total_cmp(&here[*b]))?;
        let mut gradient = Vector3::zeros();
        for axis in 0..3 {
            let mut moved = pose;
            moved.elbow = None;
            moved.position[axis] += 1e-3;
            let joints = self.chain.follow(&moved, q)?;
            gradient[axis] = self.clearances(&joints)[nearest] - here[nearest];
        }
        (-gradient).try_normalize(1e-6)
    }
}

/// The directions at angle `tilt` (rad) to an axis.
fn beside(axis: &Unit<Vector3<f64>>, tilt: f64) -> impl Iterator<Item = Vector3<f64>> + use<> {
    let axis = *axis;
    let side = Unit::new_normalize(axis.cross(&if axis.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() }));
    (0..DIRECTIONS).map(move |k| {
        let around = Rotation3::from_axis_angle(&axis, TAU * f64::from(k) / f64::from(DIRECTIONS));
        Rotation3::from_axis_angle(&(around * side), tilt) * axis.into_inner()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Cell, spread_plan};
    use spherecal_model::chain::Chain;
    use spherecal_shared::procedure::Limits;

    const DOWN: [f64; 3] = [0.0, 0.0, -1.0];

    // Fails if an arm with room does not retreat along its nest, or straight where that is nearly upright, or if an arm whose
    // straight retreat ends at a joint limit goes there anyway, or into the plate.
    #[test]
    fn the_retreat_keeps_clear_of_the_limits() {
        let cell = Cell::iiwa7();
        let chain = Chain::new(&cell.robot, &cell.tool).expect("an arm");
        let plan = spread_plan(&cell, 3).expect("a plan");
        let scene = Scene::new(&plan, &chain, 0, &Limits::default(), &[]);
        let approach = &plan.spheres[0].approach.joints;
        assert_eq!(scene.retreat(approach, DOWN, 0.05, 0), DOWN);
        let mut pose = chain.pose(approach);
        pose.rotation *= Rotation3::from_axis_angle(&Vector3::x_axis(), 0.4);
        let tilted = chain.follow(&pose, approach).expect("in reach");
        let axis = scene.nest_axis(&tilted);
        assert_eq!(scene.retreat(&tilted, DOWN, 0.05, 0), <[f64; 3]>::from(axis));
        assert!(scene.may_leave(&tilted));
        // A posture from the paper's grid in which joint 6 ran into its limit.
        let stretched = [0.075, 1.165, 0.012, -0.386, -0.299, 1.963, 0.145];
        let room = |direction: [f64; 3]| room(&scene, &stretched, direction);
        assert!(room(DOWN) < 0.0);
        for way in [
            scene.retreat(&stretched, DOWN, 0.05, 0),
            scene.roomiest_retreat(&stretched, &DOWN.into(), 0.05, 0),
        ] {
            assert!(room(way) >= 0.0, "{way:?}");
            assert!(-way[2] > 0.4, "{way:?}");
        }
    }

    // Fails if a nest may be turned to where a nearly stretched UR5e cannot bring it off: it pulled beside the nest's axis there,
    // with 44 N, three times in vain.
    #[test]
    fn a_stretched_arm_may_not_leave() {
        let scene = scene_of("ur5e");
        assert!(!scene.may_leave(&[-0.169, -0.595, 0.341, -0.549, -1.752, 1.795]));
    }

    /// A built-in arm in the cell of the iiwa 7.
    fn scene_of(robot: &str) -> Scene {
        let mut cell = Cell::iiwa7();
        cell.robot = spherecal_shared::robot::built_in(robot).expect("a robot");
        let chain = Chain::new(&cell.robot, &cell.tool).expect("an arm");
        Scene::planned(&cell, &chain, &cell.plates[0])
    }

    fn room(scene: &Scene, q: &[f64], direction: [f64; 3]) -> f64 {
        let paths = scene.backed_off(q, &direction.into(), 0.05);
        paths.map_or(f64::NEG_INFINITY, |paths| scene.room(&paths))
    }

    // Fails if an FR3 retreats into its stretched posture, where its elbow runs on to the end of joint 4, or if a
    // retreat that failed is tried again. The posture is that of a contact that was lost in `docs/first-cell.md`.
    #[test]
    fn the_retreat_keeps_clear_of_the_stretched_posture() {
        let scene = scene_of("fr3");
        let q = [0.644, 0.942, -0.997, -0.952, 0.238, 0.980, 0.062];
        assert!(room(&scene, &q, DOWN) < 0.0, "{}", room(&scene, &q, DOWN));
        let ways = [0, 1, 2].map(|failed| scene.retreat(&q, DOWN, 0.05, failed));
        for way in ways {
            assert!(room(&scene, &q, way) >= 0.0, "{way:?}");
        }
        assert!(
            ways[0] != ways[1] && ways[1] != ways[2] && ways[0] != ways[2],
            "{ways:?}"
        );
    }
}
