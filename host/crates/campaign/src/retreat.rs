//! Direction of the retreat from a sphere where no clear one was found: along the approach direction
//! if the joints have room for it, otherwise beside it.
//!
//! Poses are planned for the contact with the sphere, not for leaving it. In a strongly turned pose
//! the straight retreat may end at a joint limit or out of reach. The nest comes off by distance;
//! the direction matters little.

use core::f64::consts::{FRAC_PI_4, TAU};

use nalgebra::{Rotation3, Unit, Vector3};
use spherecal_shared::procedure::Procedure;

use spherecal_model::chain::{Chain, TcpPose};

/// Distance that a joint keeps to the limit at which it faults, in rad: the error of the nominal
/// model, and the overshoot.
const ROOM_RAD: f64 = 0.03;
/// Parts of the way that are looked at.
const PARTS: u32 = 5;
/// Angles to the approach direction that are tried, in rad. The plate is at a right angle to it.
const TILTS: [f64; 3] = [FRAC_PI_4 / 2.0, FRAC_PI_4, 1.4 * FRAC_PI_4];
/// Directions tried at each angle.
const AROUND: u32 = 8;

/// The direction (towards the sphere, F0, a unit vector) opposite to the best retreat of an arm
/// that stands at `q` (rad). It is `approach` if all joints keep their room on the way; else the
/// least tilted direction that lets them; else the direction with the most room. The tool keeps its
/// orientation.
pub(super) fn retreat(chain: &Chain, procedure: &Procedure, q: &[f64], approach: [f64; 3]) -> [f64; 3] {
    let straight = Unit::new_normalize(Vector3::from(approach));
    let enough = procedure.limits.position_margin_rad + ROOM_RAD;
    let mut best = (room(chain, procedure, q, &straight), straight);
    let side = Unit::new_normalize(straight.cross(&if straight.x.abs() < 0.7 {
        Vector3::x()
    } else {
        Vector3::y()
    }));
    for tilt in TILTS {
        if best.0 >= enough {
            break;
        }
        for k in 0..AROUND {
            let around = Rotation3::from_axis_angle(&straight, TAU * f64::from(k) / f64::from(AROUND));
            let tilted = Rotation3::from_axis_angle(&(around * side), tilt) * straight;
            let room = room(chain, procedure, q, &tilted);
            if room > best.0 {
                best = (room, tilted);
            }
        }
    }
    best.1.into_inner().into()
}

/// The smallest distance of a joint to the end of its range on the way, in rad; minus infinity
/// where the arm does not reach.
fn room(chain: &Chain, procedure: &Procedure, q: &[f64], direction: &Unit<Vector3<f64>>) -> f64 {
    let start = chain.pose(q);
    let mut joints = q.to_vec();
    let mut least = f64::INFINITY;
    for part in 1..=PARTS {
        let way = procedure.decouple.retreat_m * f64::from(part) / f64::from(PARTS);
        let pose = TcpPose {
            position: start.position - direction.into_inner() * way,
            elbow: None,
            ..start
        };
        let Some(next) = chain.follow(&pose, &joints) else {
            return f64::NEG_INFINITY;
        };
        joints = next;
        least = least.min(chain.limit_margin(&joints));
    }
    least
}

#[cfg(test)]
mod tests {
    use super::*;
    use spherecal_shared::robot::{iiwa7, iiwa7_tool};

    const DOWN: [f64; 3] = [0.0, 0.0, -1.0];

    // Fails if an arm with room does not retreat straight, or if an arm whose straight retreat ends
    // at a joint limit goes there anyway, or into the plate.
    #[test]
    fn the_way_back_keeps_clear_of_the_limits() {
        let chain = Chain::new(&iiwa7(), &iiwa7_tool()).expect("a chain");
        let procedure = Procedure::default();
        let bent = [0.0, 0.6, 0.0, -1.5, 0.0, 1.0, 0.0];
        assert_eq!(retreat(&chain, &procedure, &bent, DOWN), DOWN);
        // A posture from the paper's grid in which joint 6 ran into its limit.
        let stretched = [0.075, 1.165, 0.012, -0.386, -0.299, 1.963, 0.145];
        let straight = Unit::new_normalize(Vector3::from(DOWN));
        let enough = procedure.limits.position_margin_rad + ROOM_RAD;
        assert!(room(&chain, &procedure, &stretched, &straight) < enough);
        let way = Unit::new_normalize(Vector3::from(retreat(&chain, &procedure, &stretched, DOWN)));
        assert!(room(&chain, &procedure, &stretched, &way) >= enough, "{way:?}");
        assert!(way.dot(&straight) > 0.4, "{way:?}");
    }
}
