//! Where a target is, and in which frame.

use nalgebra::{Matrix3, Vector3};

use serde::{Deserialize, Serialize};
use spherecal_model::{Sphere, Target};

/// A frame of targets. Each has its own pose relative to the base.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reference {
    /// The measuring device of absolute data.
    Tracker,
    /// The plate in one of its placements.
    Place(u32),
}

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

/// Where the TCP is in its frame, in m; none where the row has only other targets.
pub(crate) fn first_target(target: &Target, spheres: &[Sphere]) -> Option<Vector3<f64>> {
    match target {
        Target::Points(points) => points.first().copied().flatten().map(Vector3::from),
        _ => Some(target_of(target, spheres)),
    }
}

/// Measured position of the TCP in the frame of the measuring device, in m.
pub(crate) fn measured_tcp(target: &Target) -> Option<Vector3<f64>> {
    match target {
        Target::Sphere { .. } => None,
        _ => first_target(target, &[]),
    }
}

/// Targets besides the TCP that were seen: the number, from 1 for target 2, and the position in m.
pub(crate) fn further_targets(target: &Target) -> impl Iterator<Item = (usize, Vector3<f64>)> {
    let points = match target {
        Target::Points(points) => &**points,
        _ => &[],
    };
    let numbered = points.iter().enumerate().skip(1);
    numbered.filter_map(|(number, at)| Some((number, Vector3::from((*at)?))))
}

/// Measured orientation in the frame of the measuring device.
pub(crate) fn orientation_of(target: &Target) -> Option<Matrix3<f64>> {
    match target {
        Target::Frame(pose) => Some(pose.rotation),
        _ => None,
    }
}

/// Where a row's target is in its frame, in m: of several the first that was seen.
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
