//! The room that a plan takes up: what the arm is kept in while it carries it out.
//!
//! The box about every place that the TCP comes to, and the plane under the
//! lowest sphere: the procedure's limits are narrowed to both
//! ([`Bounds::narrow`]), so that an arm that is led astray by a wrong model, a
//! wrong plate or a person slows down and stops near where it has work.

use nalgebra::Vector3;
use spherecal_shared::procedure::Limits;

use super::types::Plan;
use spherecal_model::chain::Chain;

/// Parts of a joint motion at whose ends the TCP is looked at.
const PARTS: u32 = 40;

/// The room of a plan, F0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Least coordinates of the TCP, in m.
    pub min_m: Vector3<f64>,
    /// Largest coordinates of the TCP, in m.
    pub max_m: Vector3<f64>,
    /// Mean direction against the descents, a unit vector: the plate's normal.
    pub normal: Vector3<f64>,
    /// Least coordinate of a sphere's centre along it, in m.
    pub lowest_m: f64,
}

impl Bounds {
    /// The room of `plan`: home, the ways from home to every visit and back,
    /// those from visit to visit, and the spheres. `None` of a plan without visits.
    pub fn of(plan: &Plan, chain: &Chain) -> Option<Self> {
        let home = Vector3::from(plan.home.position_m);
        let mut bounds = Self {
            min_m: home,
            max_m: home,
            normal: plan
                .spheres
                .iter()
                .map(|visit| -Vector3::from(visit.approach_direction))
                .sum::<Vector3<f64>>()
                .try_normalize(0.1)?,
            lowest_m: f64::INFINITY,
        };
        let mut before: Option<&[f64]> = None;
        for visit in &plan.spheres {
            let there = &visit.approach.joints;
            bounds.way(chain, &plan.home.joints, there);
            if let Some(before) = before.filter(|_| !visit.over_home) {
                bounds.way(chain, before, there);
            }
            before = Some(there);
            let centre = Vector3::from(visit.position_m);
            bounds.take(&centre);
            bounds.lowest_m = bounds.lowest_m.min(bounds.normal.dot(&centre));
        }
        Some(bounds)
    }

    fn take(&mut self, tcp: &Vector3<f64>) {
        self.min_m = self.min_m.inf(tcp);
        self.max_m = self.max_m.sup(tcp);
    }

    fn way(&mut self, chain: &Chain, from: &[f64], to: &[f64]) {
        for part in 0..=PARTS {
            let t = f64::from(part) / f64::from(PARTS);
            let q: Vec<f64> = from.iter().zip(to).map(|(a, b)| a + (b - a) * t).collect();
            self.take(&chain.pose(&q).position);
        }
    }

    /// Narrows the procedure's limits to this room, `margin_m` wider on every
    /// side and `below_m` under the lowest sphere's centre; what is narrower stays.
    pub fn narrow(&self, limits: &mut Limits, margin_m: f64, below_m: f64) {
        for axis in 0..3 {
            limits.workspace_min_m[axis] = limits.workspace_min_m[axis].max(self.min_m[axis] - margin_m);
            limits.workspace_max_m[axis] = limits.workspace_max_m[axis].min(self.max_m[axis] + margin_m);
        }
        // One plane is watched: a person's, where there is one.
        if limits.plate_offset_m <= Limits::default().plate_offset_m {
            limits.plate_normal = self.normal.into();
            limits.plate_offset_m = self.lowest_m - below_m;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Cell, spread_plan};

    // Fails if a place that the plan leads to lies outside the limits made of it,
    // if they are wider than asked for, or if what a person has set is widened.
    #[test]
    fn the_limits_hold_what_the_plan_needs() {
        let cell = Cell::iiwa7();
        let chain = Chain::new(&cell.robot, &cell.tool).expect("an arm");
        let plan = spread_plan(&cell, 12).expect("a plan");
        let bounds = Bounds::of(&plan, &chain).expect("visits");
        let mut limits = Limits::default();
        limits.workspace_max_m[2] = 0.55;
        bounds.narrow(&mut limits, 0.1, 0.03);
        for visit in &plan.spheres {
            for point in [visit.position_m, visit.approach.position_m] {
                for axis in 0..3 {
                    assert!(point[axis] >= limits.workspace_min_m[axis] + 0.1 - 1e-9);
                    assert!(point[axis] <= limits.workspace_max_m[axis] - 0.1 + 1e-9 || axis == 2);
                }
            }
        }
        assert!((Vector3::from(limits.plate_normal) - Vector3::z()).norm() < 1e-9);
        assert!(
            (limits.plate_offset_m - 0.290).abs() < 1e-6,
            "{}",
            limits.plate_offset_m
        );
        assert_eq!(limits.workspace_max_m[2], 0.55, "a person's is kept");
        let sides: Vec<f64> = (0..2)
            .map(|axis| limits.workspace_max_m[axis] - limits.workspace_min_m[axis])
            .collect();
        assert!(sides.iter().all(|side| (0.4..1.4).contains(side)), "{sides:?}");
        let again = limits;
        bounds.narrow(&mut limits, 0.1, 0.03);
        assert_eq!(limits, again, "narrowed once for all");
    }
}
