//! A robot as the host holds it: the table that everything computes with, and
//! beside it what ties the table to the frames of the file that it came from.

use nalgebra::Vector3;
use spherecal_shared::robot::kinematics::frames_into;
use spherecal_shared::robot::{Inertia, LinkTransform, MdhRow, Pose, Robot, Tool};

use super::frames::{compose, distance, inverse};
use super::urdf::{Urdf, UrdfChain};

/// Where a robot came from.
#[derive(Clone, Debug)]
pub enum Origin {
    /// The built-in table.
    BuiltIn,
    /// A TOML file.
    Toml,
    /// A URDF, kept so that it can be written back with only its numbers changed.
    Urdf(Box<(Urdf, UrdfChain)>),
}

/// How far a robot's lengths, twists and joint offsets may be from its table (1 sigma), as its maker or its
/// history says. What is not known is `None`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tolerances {
    /// Of `a` and `d`, in m.
    pub length_m: Option<f64>,
    /// Of `alpha`, in rad.
    pub twist_rad: Option<f64>,
    /// Of `theta`, in rad.
    pub offset_rad: Option<f64>,
}

/// A robot with its constant frames.
///
/// ```text
///   root ── base ── F0 ── joint 1 ── F1 ── … ── Fn ── flange ── tool ── TCP
/// ```
///
/// The flange of the file at joint angles `q` is `base · T(q) · flange`.
#[derive(Clone, Debug)]
pub struct RobotModel {
    /// Table, masses and limits.
    pub robot: Robot,
    /// F0 in the root frame of the file.
    pub base: Pose<f64>,
    /// The file's flange frame in Fn.
    pub flange: Pose<f64>,
    /// Nominal tool, in the file's flange frame.
    pub tool: Tool,
    /// Name of the root frame and of the flange frame.
    pub frame_names: (String, String),
    /// Names of the joints, base to flange, as the file or the vendor has them;
    /// empty where nobody named them.
    pub joint_names: Vec<String>,
    /// Directions of the chain's sliding joints as they were found, base to tip, in the root frame with all joints at
    /// zero. Empty where they are those of the file.
    pub slides: Vec<Vector3<f64>>,
    /// How far the table may be from the arm.
    pub tolerances: Tolerances,
    /// Where the robot came from.
    pub origin: Origin,
    /// What the user should know about the file: one sentence each.
    pub notes: Vec<String>,
}

/// The frames of a table at joint angles `q` (rad, one per row): F1..Fn in F0.
pub fn table_frames(rows: &[MdhRow<f64>], q: &[f64]) -> Vec<Pose<f64>> {
    let links: Vec<LinkTransform<f64>> = rows.iter().map(LinkTransform::from).collect();
    let mut frames = vec![Pose::identity(); links.len().min(q.len())];
    frames_into(&links, q, &mut frames);
    frames
}

/// Whether two tables have near the same joints, at three configurations. The last
/// frame may sit anywhere along its axis: that is the flange's business.
pub fn near(own: &[MdhRow<f64>], other: &[MdhRow<f64>]) -> bool {
    own.len() == other.len()
        && [0.0, 0.7, -1.1].iter().all(|&s| {
            let q: Vec<f64> = (0..own.len()).map(|k| s * (1.0 - 0.2 * k as f64)).collect();
            let last = own.len().saturating_sub(1);
            table_frames(own, &q)
                .iter()
                .zip(&table_frames(other, &q))
                .enumerate()
                .all(|(k, (a, b))| {
                    let off = a.position - b.position;
                    let off = if k == last { off - a.z() * off.dot(&a.z()) } else { off };
                    off.norm() < 5e-3 && (a.rotation - b.rotation).amax() < 1e-2
                })
        })
}

impl RobotModel {
    /// The built-in robot that this one is, or was before it was calibrated: of the
    /// same name, and with joints within 5 mm and 10 mrad.
    pub(super) fn built_in(&self) -> Option<Robot> {
        let known = spherecal_shared::robot::built_in(&self.robot.name)?;
        let rows: Vec<_> = known.joints.iter().map(|j| j.mdh).collect();
        let same = rows.len() == self.robot.dof()
            && distance(&self.base, &Pose::identity()) < 1e-9
            && near(&self.rows(), &rows);
        same.then_some(known)
    }

    /// The table before it was calibrated, as far as the robot's name says it.
    pub(super) fn nominal_rows(&self) -> Vec<MdhRow<f64>> {
        match (&self.origin, self.built_in()) {
            (Origin::Urdf(_), _) | (_, None) => self.rows(),
            (_, Some(known)) => known.joints.iter().map(|j| j.mdh).collect(),
        }
    }

    /// The rows of the table.
    pub fn rows(&self) -> Vec<MdhRow<f64>> {
        self.robot.joints.iter().map(|j| j.mdh).collect()
    }

    /// The flange in the root frame at joint angles `q` (rad).
    pub fn flange_at(&self, q: &[f64]) -> Pose<f64> {
        self.flange_with(&self.rows(), q)
    }

    /// The same with another table, such as the calibrated one.
    pub fn flange_with(&self, rows: &[MdhRow<f64>], q: &[f64]) -> Pose<f64> {
        let last = table_frames(rows, q).last().copied().unwrap_or_else(Pose::identity);
        compose(&self.base, &compose(&last, &self.flange))
    }

    /// The tool as the table needs it: given in Fn instead of the flange frame.
    pub fn tool_in_table(&self) -> Tool {
        Tool {
            tcp_m: self.flange.point(&self.tool.tcp()).into(),
            body: moved(&self.tool.body, &self.flange),
        }
    }

    /// A TCP (m) of the table, given in the file's flange frame.
    pub fn tcp_in_flange(&self, tcp_in_table_m: [f64; 3]) -> [f64; 3] {
        inverse(&self.flange).point(&Vector3::from(tcp_in_table_m)).into()
    }
}

/// A body given in the frame `at`, seen from where `at` is given.
pub fn moved(body: &Inertia, at: &Pose<f64>) -> Inertia {
    let m = at.rotation * body.matrix() * at.rotation.transpose();
    Inertia {
        mass_kg: body.mass_kg,
        com_m: at.point(&body.com()).into(),
        inertia_kg_m2: [m[(0, 0)], m[(1, 1)], m[(2, 2)], m[(0, 1)], m[(0, 2)], m[(1, 2)]],
    }
}
