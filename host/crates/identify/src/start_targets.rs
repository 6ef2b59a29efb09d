//! Where targets 2.. and the measured body are on the tool, before anything is fitted to them.
//!
//! At a given robot and base, `y = B T(q) p` is linear in the place `p`, and each row gives all of
//! it: `p = T(q)⁻¹ B⁻¹ y`. The median over the rows is the start, so that gross errors do not move it.

use nalgebra::{Matrix3, Vector3};

use super::chain::{Prepared, State};
use super::seen::Seen;
use spherecal_model::Pose;
use spherecal_model::statistics::median;

/// Median of points, axis by axis, in m.
pub(crate) fn median_point(points: &[Vector3<f64>]) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| median(points.iter().map(|p| p[axis]).collect()))
}

/// The rotation next to the median of rotations, element by element.
pub(crate) fn median_rotation(rotations: &[Matrix3<f64>]) -> Matrix3<f64> {
    let middle = Matrix3::from_fn(|r, c| median(rotations.iter().map(|m| m[(r, c)]).collect()));
    let parts = middle.svd(true, true);
    let (Some(u), Some(v)) = (parts.u, parts.v_t) else {
        return Matrix3::identity();
    };
    let turn = Vector3::new(1.0, 1.0, (u * v).determinant().signum());
    u * Matrix3::from_diagonal(&turn) * v
}

impl State {
    /// Puts targets 2.. and the measured body where the rows say, at the state's robot and bases.
    pub(crate) fn place_targets(&mut self, prepared: &[Prepared]) {
        let mut places: Vec<Vec<Vector3<f64>>> = vec![Vec::new(); self.targets.len()];
        let mut bodies = Vec::new();
        for p in prepared.iter().filter(|p| p.lead > 0 || !p.further.is_empty()) {
            let k = self.at(p);
            let last = self.rows.len().saturating_sub(1);
            let (Some(flange), Some(base)) = (k.frames.get(last), self.bases.get(p.reference)) else {
                continue;
            };
            let mut put = |number: usize, at: &Vector3<f64>| {
                if let Some(own) = number.checked_sub(1).and_then(|t| places.get_mut(t)) {
                    own.push(flange.inverse_point(&base.inverse_point(at)));
                }
            };
            put(p.lead, &p.target);
            for seen in &p.further {
                match seen {
                    Seen::Target { number, at } => put(*number, at),
                    Seen::Body(rotation) => bodies.push(in_flange(flange, base, rotation)),
                }
            }
        }
        for (slot, own) in self.targets.iter_mut().zip(&places) {
            *slot = median_point(own);
        }
        if !bodies.is_empty() {
            self.body = median_rotation(&bodies);
        }
    }
}

/// Orientation in the flange frame of a body measured in the frame that `base` gives F0 in.
pub(crate) fn in_flange(flange: &Pose, base: &Pose, measured: &Matrix3<f64>) -> Matrix3<f64> {
    flange.rotation.transpose() * base.rotation.transpose() * measured
}
