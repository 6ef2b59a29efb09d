//! What the columns of a table are, and how a caller names them.

/// Most measured points in one row.
pub const MOST_TARGETS: usize = 6;

/// How a table is to be read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TableFormat {
    /// Joints of the robot.
    pub joints: usize,
    /// Names of the robot's joints, base to flange: columns of these names (or
    /// with `_deg`) are joint angles. May be empty.
    pub joint_names: Vec<String>,
    /// Columns that the caller names as the joint angles, base to flange; they are
    /// taken instead of `q1..`. Empty where the caller names none.
    pub joint_columns: Vec<String>,
    /// Columns that the caller wants left out.
    pub ignore: Vec<String>,
    /// Joints of the robot's description that are not on its chain: columns of these names (or with `_deg`) are left
    /// out.
    pub others: Vec<String>,
    /// Those of them that carry the base of the chain.
    pub carriers: Vec<String>,
    /// A further column whose values name groups of rows.
    pub label: Option<String>,
    /// Factor of each joint column beside the unit of its name; a missing one is 1.
    pub units: Vec<f64>,
}

impl TableFormat {
    /// The format for a robot with `joints` joints and nothing else known.
    pub fn new(joints: usize) -> Self {
        Self {
            joints,
            ..Self::default()
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum ColumnRole {
    /// Angle of a joint (from 0), times `scale` in rad.
    Angle {
        joint: usize,
        scale: f64,
    },
    /// Torque of a joint (from 0), in N m.
    Torque {
        joint: usize,
    },
    /// Coordinate of a measured point, times `scale` in m; `target` 0 where the row
    /// has one point, else from 1.
    Coordinate {
        target: usize,
        axis: usize,
        scale: f64,
    },
    /// Part w, x, y or z of the tool's orientation.
    Quaternion(usize),
    /// Element of the tool's rotation matrix, row by row.
    Rotation(usize),
    Sphere,
    Place,
    Set,
    Label,
    /// The caller does not want it, or it has no name.
    Ignored,
    /// It has no name and must stay empty.
    Blank,
}

/// The columns of a table and what they are together.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TableHeader {
    pub(super) names: Vec<String>,
    pub(super) columns: Vec<ColumnRole>,
    /// Points in a row: 0, 1, or more where they are numbered.
    pub(super) targets: usize,
    /// Whether the points are numbered.
    pub(super) numbered: bool,
    /// Whether rows hold the orientation of the tool.
    pub(super) orientation: bool,
    pub(super) torques: bool,
}
