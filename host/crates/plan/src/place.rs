//! Finds a placement of the plate where this arm can work.
//!
//! A plan uses the plate's pose from the configuration. If that is out of reach, [`suggest`] finds
//! a reachable placement, so that the error can name it.

use nalgebra::{Rotation3, Vector3};
use rayon::prelude::*;

use super::cell::{Cell, PlatePose};
use super::path::Rules;
use super::start::{PlacedCell, home};
use spherecal_model::chain::{Chain, TcpPose};

/// Distances of the plate's centre from the axis of joint 1, in m, by step.
const RADIUS: (f64, f64, u32) = (0.25, 0.075, 10);
/// Heights of the sphere centres over F0, in m.
const HEIGHT: (f64, f64, u32) = (0.05, 0.075, 8);
/// Tilts about the tool's axes that a useful placement allows, in rad: the paper's largest.
const TILT: f64 = 20.0 * core::f64::consts::PI / 180.0;

/// A placement of the plate on the x axis of F0, with the orientation of the cell's first. It is
/// the one of a grid at which the arm reaches, and can leave, most of the largest turns of the paper's grid on all
/// spheres, and of those the one with the largest distance to joint limits and singular places. `None` if no
/// placement has all spheres within reach.
pub fn suggest(cell: &Cell, chain: &Chain, rules: &Rules) -> Option<PlatePose> {
    let like = cell.plates.first()?;
    let places: Vec<(u32, u32)> = (0..RADIUS.2).flat_map(|i| (0..HEIGHT.2).map(move |k| (i, k))).collect();
    let worths: Vec<_> = places
        .par_iter()
        .filter_map(|&(i, k)| {
            let x = RADIUS.0 + RADIUS.1 * f64::from(i);
            let z = HEIGHT.0 + HEIGHT.1 * f64::from(k);
            let plate = PlatePose {
                centre_m: [x, 0.0, z],
                ..*like
            };
            Some((worth(cell, chain, rules, &plate)?, plate))
        })
        .collect();
    // The first of equals, so the result does not depend on the number of threads.
    let better = |a: &(usize, f64), b: &(usize, f64)| a.0 > b.0 || (a.0 == b.0 && a.1 > b.1);
    let mut best: Option<((usize, f64), PlatePose)> = None;
    for found in worths {
        if best.as_ref().is_none_or(|(most, _)| better(&found.0, most)) {
            best = Some(found);
        }
    }
    best.map(|(_, plate)| plate)
}

/// Number of turns within reach at a placement, over all spheres, and the smallest distance to a
/// joint limit or a singular place at the neutral poses, in rad; `None` if a sphere is out of reach.
fn worth(cell: &Cell, chain: &Chain, rules: &Rules, plate: &PlatePose) -> Option<(usize, f64)> {
    let mut cell = Cell {
        plates: vec![*plate],
        // Of another place another yaw is the best.
        tool_yaw_rad: None,
        ..cell.clone()
    };
    let yaw = PlacedCell::new(&cell, chain, rules, plate).tool_yaw().ok()?;
    cell.tool_yaw_rad = Some(yaw);
    let home = home(&cell, chain, rules).ok()?;
    let placed = PlacedCell::new(&cell, chain, rules, plate);
    let (mut turns, mut room) = (0, f64::INFINITY);
    for sphere in &cell.spheres {
        let starts = placed.starts(sphere, yaw).ok()?;
        let start = starts.iter().find(|start| placed.straight(&home, start))?;
        let singular = rules.nearest_singular(chain, &start.joints).room;
        room = room.min(chain.limit_margin(&start.joints)).min(singular);
        for axis in [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()] {
            for angle in [-TILT, TILT] {
                let turned = TcpPose {
                    rotation: start.neutral.rotation * Rotation3::from_axis_angle(&axis, angle),
                    ..start.neutral
                };
                let reached = rules.follow(chain, &start.neutral, &start.joints, &turned);
                turns += usize::from(reached.is_ok_and(|q| placed.scene.may_leave(&q)));
            }
        }
    }
    Some((turns, room))
}
