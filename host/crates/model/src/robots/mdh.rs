//! From joint axes to modified DH: the exact conversion of any serial chain of
//! revolute joints.
//!
//! A chain is known by its joint axes (a point and a direction each, all joints
//! at zero) and by the flange frame. The rows follow axis by axis:
//!
//! - skew or crossing axes i-1 and i: x_{i-1} lies on their common normal, whose
//!   foot on axis i-1 is O_{i-1} (Craig's rule);
//! - near parallel axes (less than [`NEAR_PARALLEL_RAD`] apart), whose common
//!   normal is far away or anywhere: O_{i-1} stays where axis i-1 was met, x_{i-1}
//!   points to where axis i pierces the plane across axis i-1, and Hayati's
//!   `beta` takes up the rest of the angle.
//!
//! What does not fit the table stays beside it as two constant frames:
//! `base` (F0 seen from the file's root) and `flange` (the file's flange seen
//! from Fn). F0 keeps the root's z axis, because gravity pulls along −z of F0;
//! both constants are the identity wherever the table can take them up.

use nalgebra::Vector3;
use spherecal_shared::robot::{MdhRow, Pose};

use super::frames::{compose, inverse, row_transform};

/// Axes closer to parallel than this (rad) get Hayati's `beta`.
pub const NEAR_PARALLEL_RAD: f64 = 0.05;

/// Lengths (m) and angles (rad) under this are round-off and are written as 0.
const ROUND_OFF: f64 = 4e-15;

/// A joint axis with all joints at zero, in the root frame.
#[derive(Clone, Copy, Debug)]
pub struct Axis {
    /// A point on it, in m.
    pub point: Vector3<f64>,
    /// Its unit direction: positive angles turn about it by the right hand.
    pub direction: Vector3<f64>,
}

/// A chain as a table and its two constant frames.
#[derive(Clone, Debug)]
pub struct MdhChain {
    /// One row per joint.
    pub rows: Vec<MdhRow<f64>>,
    /// F0 in the root frame.
    pub base: Pose<f64>,
    /// The flange in Fn.
    pub flange: Pose<f64>,
}

/// The table of a chain with these axes and this flange frame (root frame,
/// joints at zero).
pub fn from_axes(axes: &[Axis], flange: &Pose<f64>) -> MdhChain {
    from_axes_within(axes, flange, NEAR_PARALLEL_RAD)
}

/// The same with another angle (rad) below which axes get `beta`; row 1 keeps [`NEAR_PARALLEL_RAD`].
pub(super) fn from_axes_within(axes: &[Axis], flange: &Pose<f64>, near_rad: f64) -> MdhChain {
    let base = axes.first().map_or_else(Pose::identity, base_frame);
    let mut rows = Vec::with_capacity(axes.len());
    // The last frame with its joint at zero, before its own theta and d are known.
    let mut pending: Option<PendingRow> = None;
    let mut parent = base;
    for (i, axis) in axes.iter().enumerate() {
        let link = if i == 0 {
            from_fixed_frame(&parent, axis)
        } else {
            let turn = pending.as_ref().map_or(parent, |p| p.frame);
            let (theta, d, link) = next_link(&turn, axis, near_rad);
            if let Some(p) = pending.take() {
                let row = p.row(theta, d);
                parent = compose(&parent, &row_transform(&row, 0.0));
                rows.push(row);
            }
            link
        };
        let bare = row_transform(&link, 0.0);
        pending = Some(PendingRow {
            link,
            frame: compose(&parent, &bare),
        });
    }
    if let Some(p) = pending {
        let (theta, d) = last_turn(&p.frame, flange);
        let row = p.row(theta, d);
        parent = compose(&parent, &row_transform(&row, 0.0));
        rows.push(row);
    }
    MdhChain {
        rows,
        base,
        flange: tidy_frame(&compose(&inverse(&parent), flange)),
    }
}

/// A row whose theta and d are still zero, and its frame then.
struct PendingRow {
    link: MdhRow<f64>,
    frame: Pose<f64>,
}

impl PendingRow {
    fn row(&self, theta: f64, d: f64) -> MdhRow<f64> {
        MdhRow {
            alpha: tidy_angle(self.link.alpha),
            a: tidy(self.link.a),
            beta: tidy_angle(self.link.beta),
            theta: tidy_angle(theta),
            d: tidy(d),
        }
    }
}

/// F0: the root itself wherever row 1 can reach axis 1 from there, else the
/// root turned about its z axis and shifted; z stays up for gravity.
fn base_frame(first: &Axis) -> Pose<f64> {
    let (p, z) = (first.point, first.direction);
    let level = z.x.hypot(z.y);
    if level <= NEAR_PARALLEL_RAD {
        // Where axis 1 pierces the root's ground plane: lengths a and d of row 1 then say height alone.
        let ground = p - z * (p.z / z.z);
        return Pose {
            rotation: nalgebra::Matrix3::identity(),
            position: Vector3::new(tidy(ground.x), tidy(ground.y), 0.0),
        };
    }
    // x along the common normal of the root's vertical and axis 1, at its foot.
    let mut x = Vector3::new(-z.y, z.x, 0.0) / level;
    if x.x < 0.0 || (x.x == 0.0 && x.y < 0.0) {
        x = -x;
    }
    let y = Vector3::z().cross(&x);
    // Axis 1 runs in the plane x = a; where it crosses y = 0, the normal meets it.
    let height = (p - z * (p.dot(&y) / z.dot(&y))).z;
    Pose {
        rotation: nalgebra::Matrix3::from_columns(&[x, y, Vector3::z()]),
        position: Vector3::new(0.0, 0.0, tidy(height)),
    }
}

/// Row (theta = d = 0) from a frame that must not turn to an axis.
fn from_fixed_frame(parent: &Pose<f64>, axis: &Axis) -> MdhRow<f64> {
    let local = inverse(parent);
    let z = local.rotation * axis.direction;
    let p = local.point(&axis.point);
    let level = z.x.hypot(z.y);
    let a = if level <= NEAR_PARALLEL_RAD {
        (p - z * (p.z / z.z)).x
    } else {
        p.x
    };
    MdhRow {
        alpha: (-z.y).atan2(z.z),
        a,
        beta: z.x.atan2(z.y.hypot(z.z)),
        theta: 0.0,
        d: 0.0,
    }
}

/// Turn and shift along the axis of `frame` (its joint), and the row from there
/// (theta = d = 0) to `axis`.
fn next_link(frame: &Pose<f64>, axis: &Axis, near_rad: f64) -> (f64, f64, MdhRow<f64>) {
    let local = inverse(frame);
    let z = local.rotation * axis.direction;
    let p = local.point(&axis.point);
    let level = z.x.hypot(z.y);
    if level <= near_rad {
        let pierce = p - z * (p.z / z.z);
        let reach = pierce.x.hypot(pierce.y);
        let theta = if reach > 1e-13 {
            nearest_turn(pierce.y.atan2(pierce.x))
        } else {
            0.0
        };
        let (s, c) = theta.sin_cos();
        let (zx, zy) = (c * z.x + s * z.y, c * z.y - s * z.x);
        let row = MdhRow {
            alpha: (-zy).atan2(z.z),
            a: c * pierce.x + s * pierce.y,
            beta: zx.atan2(zy.hypot(z.z)),
            theta: 0.0,
            d: 0.0,
        };
        return (theta, 0.0, row);
    }
    // The common normal of z (0, 0, 1) and the axis: across both, so level.
    let theta = nearest_turn(z.x.atan2(-z.y));
    let (s, c) = theta.sin_cos();
    // In the turned frame the axis runs in a plane x = a.
    let (px, py) = (c * p.x + s * p.y, c * p.y - s * p.x);
    let zy = c * z.y - s * z.x;
    let d = p.z - z.z * (py / zy);
    let row = MdhRow {
        alpha: (-zy).atan2(z.z),
        a: px,
        beta: 0.0,
        theta: 0.0,
        d: 0.0,
    };
    (theta, d, row)
}

/// Turn and shift of the last joint, so that Fn is the flange or as near as its axis allows.
fn last_turn(frame: &Pose<f64>, flange: &Pose<f64>) -> (f64, f64) {
    let local = compose(&inverse(frame), flange);
    let x = local.rotation.column(0);
    let level = x[0].hypot(x[1]);
    let theta = if level > 0.5 { x[1].atan2(x[0]) } else { 0.0 };
    (theta, local.position.z)
}

/// Of the two turns that lay x along a line, the one nearer to zero.
fn nearest_turn(angle: f64) -> f64 {
    let angle = tidy_angle(angle);
    if angle > std::f64::consts::FRAC_PI_2 {
        angle - std::f64::consts::PI
    } else if angle <= -std::f64::consts::FRAC_PI_2 {
        angle + std::f64::consts::PI
    } else {
        angle
    }
}

/// Round-off as zero.
fn tidy(value: f64) -> f64 {
    if value.abs() < ROUND_OFF { 0.0 } else { value }
}

/// An angle within round-off of a multiple of 90 degrees as that multiple.
fn tidy_angle(value: f64) -> f64 {
    let quarter = std::f64::consts::FRAC_PI_2;
    let near = (value / quarter).round() * quarter;
    // Adding zero turns −0 into 0.
    if (value - near).abs() < ROUND_OFF {
        near + 0.0
    } else {
        value
    }
}

/// Round-off of a constant frame as zeros and ones.
fn tidy_frame(frame: &Pose<f64>) -> Pose<f64> {
    let unit = |v: f64| {
        if (v.abs() - 1.0).abs() < 1e-15 {
            v.signum()
        } else {
            tidy(v)
        }
    };
    Pose {
        rotation: frame.rotation.map(unit),
        position: frame.position.map(tidy),
    }
}
