//! The durations of a plan's parts.
//!
//! Motions follow the controller's rest-to-rest quintic with the procedure's default speeds. Times
//! that do not depend on the plan were measured in simulated campaigns.

use spherecal_shared::procedure::{Motion, Turn};

/// Settling, recording and the pull at a pose, in s: 0.4, 1.1 and 0.15.
pub(super) const RECORD_S: f64 = 1.65;
/// Approach, contact, coupling, test pull and decoupling, in s.
pub(super) const VISIT_S: f64 = 13.5;

/// Time of a quintic from rest to rest over `distance`, in s. Its peak speed is 1.875 times the
/// mean; its peak acceleration is 5.774 times the distance over the time squared.
fn quintic_s(distance: f64, speed: f64, acceleration: f64) -> f64 {
    (1.875 * distance / speed).max((5.774 * distance / acceleration).sqrt())
}

/// Time of a turn about a sphere by `angle` (rad), in s.
pub(super) fn turn_s(angle: f64) -> f64 {
    let turn = Turn::default();
    quintic_s(angle, turn.speed_rad_s, turn.acceleration_rad_s2)
}

/// Time of a joint motion between two configurations (rad), in s.
pub(super) fn motion_s(a: &[f64], b: &[f64]) -> f64 {
    let motion = Motion::default();
    let distance = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    quintic_s(distance, motion.speed_rad_s, motion.acceleration_rad_s2)
}
