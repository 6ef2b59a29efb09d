//! Standard Denavit-Hartenberg tables, in and out: `T_i = Rz(theta + q) Tz(d) Tx(a) Rx(alpha)`.
//!
//! Their frames stand at the far ends of the links: frame i has the axis of joint i+1 as its z axis. Of two axes that are
//! nearly parallel the common normal is far away, so `d` may be hundreds of metres: makers write such tables, and they are
//! exact. The table of a [`RobotModel`] takes Hayati's `beta` there.

use nalgebra::Vector3;
use spherecal_shared::robot::{MdhRow, Pose};

use super::frames::{compose, inverse, rot_x, rot_z, row_transform};
use super::mdh::{Axis, MdhChain, from_axes, from_axes_within};
use super::model::{RobotModel, table_frames};

/// Axes closer to parallel than this (rad) count as parallel in a standard table: at 1 m that is 1 nm.
const PARALLEL_RAD: f64 = 1e-9;

/// One row.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DhRow {
    /// Angle about z at joint position zero, in rad.
    pub theta: f64,
    /// Shift along z, in m.
    pub d: f64,
    /// Shift along the new x, in m.
    pub a: f64,
    /// Turn about the new x, in rad.
    pub alpha: f64,
}

impl DhRow {
    /// Frame i in frame i-1 at joint position `q` (rad).
    pub fn transform(&self, q: f64) -> Pose<f64> {
        let turn = Pose {
            rotation: rot_z(self.theta + q),
            position: Vector3::z() * self.d,
        };
        let link = Pose {
            rotation: rot_x(self.alpha),
            position: Vector3::x() * self.a,
        };
        compose(&turn, &link)
    }
}

/// A chain as a standard table between two constant frames.
#[derive(Clone, Debug)]
pub struct StandardChain {
    /// Frame 0 in the root frame: its z axis is that of joint 1.
    pub base: Pose<f64>,
    /// One row for each joint.
    pub rows: Vec<DhRow>,
    /// The flange in frame n.
    pub flange: Pose<f64>,
}

impl StandardChain {
    /// The frames 1 to n at joint positions zero, in the root frame.
    pub fn frames(&self) -> Vec<Pose<f64>> {
        let next = |at: &mut Pose<f64>, row: &DhRow| {
            *at = compose(at, &row.transform(0.0));
            Some(*at)
        };
        self.rows.iter().scan(self.base, next).collect()
    }

    /// The same chain as a modified table.
    pub fn modified(&self) -> MdhChain {
        let frames = self.frames();
        let before = std::iter::once(&self.base).chain(&frames);
        let axes: Vec<Axis> = before
            .take(self.rows.len())
            .map(|frame| Axis {
                point: frame.position,
                direction: frame.z(),
            })
            .collect();
        let last = frames.last().copied().unwrap_or(self.base);
        from_axes(&axes, &compose(&last, &self.flange))
    }
}

impl RobotModel {
    /// The frames F1 to Fn of the table at joint positions zero, in the root frame.
    pub(super) fn frames_at_zero(&self) -> Vec<Pose<f64>> {
        let rows = self.rows();
        let frames = table_frames(&rows, &vec![0.0; rows.len()]);
        frames.iter().map(|frame| compose(&self.base, frame)).collect()
    }

    /// The robot as a standard table.
    pub fn standard(&self) -> StandardChain {
        let frames = self.frames_at_zero();
        let axis = |frame: &Pose<f64>| Axis {
            point: frame.position,
            direction: frame.z(),
        };
        let axes: Vec<Axis> = frames.iter().map(axis).collect();
        let last = frames.last().copied().unwrap_or(self.base);
        let chain = from_axes_within(&axes, &compose(&last, &self.flange), PARALLEL_RAD);
        // A row of a modified table is the link before its joint, one of a standard table the link behind it.
        let link = |row: &MdhRow<f64>| MdhRow {
            theta: 0.0,
            d: 0.0,
            ..*row
        };
        let first = chain
            .rows
            .first()
            .map_or_else(Pose::identity, |row| row_transform(&link(row), 0.0));
        let behind = chain.rows.iter().skip(1).map(|next| (next.a, next.alpha));
        // What the last joint carries begins with a link where it can: the rest is the flange.
        let (a, alpha, rest) = last_link(&chain.flange);
        let rows = chain.rows.iter().zip(behind.chain([(a, alpha)]));
        StandardChain {
            base: compose(&chain.base, &first),
            rows: rows
                .map(|(row, (a, alpha))| DhRow {
                    theta: row.theta,
                    d: row.d,
                    a,
                    alpha,
                })
                .collect(),
            flange: rest,
        }
    }
}

/// A flange as `Tx(a) Rx(alpha)` and the rest: the whole where it is nothing else, none of it otherwise.
fn last_link(flange: &Pose<f64>) -> (f64, f64, Pose<f64>) {
    let (a, alpha) = (
        flange.position.x,
        flange.rotation[(2, 1)].atan2(flange.rotation[(2, 2)]),
    );
    let link = DhRow {
        a,
        alpha,
        ..DhRow::default()
    };
    let rest = compose(&inverse(&link.transform(0.0)), flange);
    if super::frames::distance(&rest, &Pose::identity()) < 1e-12 {
        (a, alpha, Pose::identity())
    } else {
        (0.0, 0.0, *flange)
    }
}
