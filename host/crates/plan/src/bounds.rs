//! The space that a plan needs: the limits in which the arm is kept while it carries out the plan.
//!
//! The space is a box about all TCP positions and a plane below the lowest sphere. The procedure's
//! limits are narrowed to both ([`Bounds::narrow`]). So an arm that leaves its path because of a
//! wrong model, a wrong plate or a person slows down and stops near its work.

use nalgebra::Vector3;
use spherecal_shared::procedure::Limits;

use super::types::Plan;
use spherecal_model::chain::Chain;

/// Number of parts of a joint motion at whose ends the TCP is checked.
const PARTS: u32 = 40;

/// The room of a plan, F0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Least coordinates of the TCP, in m.
    pub min_m: Vector3<f64>,
    /// Largest coordinates of the TCP, in m.
    pub max_m: Vector3<f64>,
    /// Mean direction opposite to the descents, a unit vector: the plate's normal.
    pub normal: Vector3<f64>,
    /// Lowest coordinate of a sphere's centre along it, in m.
    pub lowest_m: f64,
}

impl Bounds {
    /// The space of `plan`: home, the paths from home to every visit and back, those between
    /// visits, and the spheres. `None` for a plan without visits.
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

    /// Narrows the procedure's limits to this space with a margin of `margin_m` on every side and
    /// of `below_m` below the lowest sphere's centre. Tighter limits stay.
    pub fn narrow(&self, limits: &mut Limits, margin_m: f64, below_m: f64) {
        for axis in 0..3 {
            limits.workspace_min_m[axis] = limits.workspace_min_m[axis].max(self.min_m[axis] - margin_m);
            limits.workspace_max_m[axis] = limits.workspace_max_m[axis].min(self.max_m[axis] + margin_m);
        }
        // Only one plane is monitored. A plane that the user has set takes precedence.
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

    // Fails if a position of the plan lies outside the limits made from it, if the limits are wider
    // than requested, or if a user's limit is widened.
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
