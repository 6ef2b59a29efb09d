//! Where a target is, and in which frame.

use nalgebra::Vector3;

use crate::{Reference, Sphere, Target};

/// The frame that a target is given in.
pub(crate) fn reference_of(target: &Target) -> Reference {
    match target {
        Target::Point(_) | Target::Points(_) | Target::Frame(_) => Reference::Tracker,
        Target::Sphere { place, .. } => Reference::Place(*place),
    }
}

/// The frame that a row's target is given in: points of closed-loop data live in
/// the plate's frame.
pub(crate) fn frame_of(target: &Target, place: u32, closed_loop: bool) -> Reference {
    match (reference_of(target), closed_loop) {
        (Reference::Tracker, true) => Reference::Place(place),
        (reference, _) => reference,
    }
}

/// Where a target is in its frame, in m.
pub(crate) fn target_of(target: &Target, spheres: &[Sphere]) -> Vector3<f64> {
    match target {
        Target::Point(p) => Vector3::from(*p),
        Target::Sphere { sphere, .. } => {
            let known = spheres.iter().find(|s| s.id == *sphere);
            known.map_or_else(Vector3::zeros, |s| Vector3::from(s.position_m))
        }
        Target::Frame(pose) => pose.position,
        Target::Points(points) => points
            .iter()
            .flatten()
            .next()
            .map_or_else(Vector3::zeros, |p| Vector3::from(*p)),
    }
}
