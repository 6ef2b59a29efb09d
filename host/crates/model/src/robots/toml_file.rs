//! Robots as TOML: the table, masses and limits of every joint, the two
//! constant frames, and the tool.
//!
//! Numbers may be given in SI or, with the suffix, in mm and degrees:
//! `a = 0.4` or `a_mm = 400`, `alpha = 1.5708` or `alpha_deg = 90`. What is
//! written by this program is SI and reads back to the same bits. A table is modified (`mdh`) or standard (`dh`).

use serde::Deserialize;
use spherecal_shared::MAX_CHAIN;
use spherecal_shared::robot::{Inertia, Joint, JointLimits, MdhRow, Pose, Robot, Tool};

use super::error::RobotFileError;
use super::frames::{compose, from_rpy, inverse};
use super::model::{Origin, RobotModel, Tolerances, moved, table_frames};
use super::standard_dh::{DhRow, StandardChain};
pub use super::toml_text::{write, write_standard};
use crate::read_toml;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RobotFile {
    name: String,
    #[serde(default)]
    joint: Vec<JointTable>,
    tool: Option<ToolTable>,
    base: Option<FrameTable>,
    flange: Option<FrameTable>,
    #[serde(default)]
    tolerances: TolerancesTable,
    #[serde(default)]
    calibration: Option<toml::Table>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JointTable {
    /// Name of the joint in the robot's description; columns of data may be named by it.
    #[serde(default)]
    name: String,
    /// A row of a modified table,
    mdh: Option<MdhTable>,
    dh: Option<MdhTable>,
    link: Option<BodyTable>,
    limits: Option<LimitsTable>,
    #[serde(default)]
    rotor_kg_m2: f64,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct MdhTable {
    alpha: Option<f64>,
    alpha_deg: Option<f64>,
    a: Option<f64>,
    a_mm: Option<f64>,
    beta: Option<f64>,
    beta_deg: Option<f64>,
    theta: Option<f64>,
    theta_deg: Option<f64>,
    d: Option<f64>,
    d_mm: Option<f64>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct BodyTable {
    mass_kg: f64,
    com_m: [f64; 3],
    inertia_kg_m2: [f64; 6],
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct LimitsTable {
    min_rad: Option<f64>,
    min_deg: Option<f64>,
    max_rad: Option<f64>,
    max_deg: Option<f64>,
    velocity_rad_s: Option<f64>,
    velocity_deg_s: Option<f64>,
    torque_nm: Option<f64>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct ToolTable {
    tcp_m: Option<[f64; 3]>,
    tcp_mm: Option<[f64; 3]>,
    body: Option<BodyTable>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct TolerancesTable {
    length_m: Option<f64>,
    length_mm: Option<f64>,
    twist_rad: Option<f64>,
    twist_mrad: Option<f64>,
    offset_rad: Option<f64>,
    offset_mrad: Option<f64>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct FrameTable {
    name: Option<String>,
    xyz_m: [f64; 3],
    rpy_rad: [f64; 3],
}

/// SI, or the scaled twin; both at once are refused.
fn either(
    path: &str,
    field: &str,
    si: Option<f64>,
    scaled: Option<f64>,
    scale: impl Fn(f64) -> f64,
) -> Result<Option<f64>, RobotFileError> {
    match (si, scaled) {
        (Some(_), Some(v)) => Err(RobotFileError::Value {
            path: path.to_owned(),
            field: field.to_owned(),
            value: v.to_string(),
            remedy: "is given twice, in SI and in mm or degrees: keep one".to_owned(),
        }),
        (Some(v), None) => Ok(Some(v)),
        (None, Some(v)) => Ok(Some(scale(v))),
        (None, None) => Ok(None),
    }
}

fn milli(v: f64) -> f64 {
    v / 1000.0
}

impl From<BodyTable> for Inertia {
    fn from(b: BodyTable) -> Self {
        Self {
            mass_kg: b.mass_kg,
            com_m: b.com_m,
            inertia_kg_m2: b.inertia_kg_m2,
        }
    }
}

fn joint(path: &str, number: usize, standard: bool, table: JointTable) -> Result<Joint, RobotFileError> {
    let field = |name: &str| format!("joint {number}: {name}");
    let m = match (table.mdh, table.dh) {
        (Some(mdh), None) if !standard => mdh,
        (None, Some(dh)) if standard && dh.beta.is_none() && dh.beta_deg.is_none() => dh,
        (_, dh) => {
            return Err(RobotFileError::Value {
                path: path.to_owned(),
                field: field(if dh.is_some() { "dh" } else { "mdh" }),
                value: "not of one convention".to_owned(),
                remedy: "give each joint mdh = {..} (modified), or each dh = {..} (standard, without beta)".to_owned(),
            });
        }
    };
    let read = |name: &str, si, scaled, scale: fn(f64) -> f64| either(path, &field(name), si, scaled, scale);
    let mdh = MdhRow {
        alpha: read("alpha", m.alpha, m.alpha_deg, f64::to_radians)?.unwrap_or(0.0),
        a: read("a", m.a, m.a_mm, milli)?.unwrap_or(0.0),
        beta: read("beta", m.beta, m.beta_deg, f64::to_radians)?.unwrap_or(0.0),
        theta: read("theta", m.theta, m.theta_deg, f64::to_radians)?.unwrap_or(0.0),
        d: read("d", m.d, m.d_mm, milli)?.unwrap_or(0.0),
    };
    let l = table.limits.unwrap_or_default();
    let pi = std::f64::consts::PI;
    let limits = JointLimits {
        min_rad: read("limits.min", l.min_rad, l.min_deg, f64::to_radians)?.unwrap_or(-pi),
        max_rad: read("limits.max", l.max_rad, l.max_deg, f64::to_radians)?.unwrap_or(pi),
        velocity_rad_s: read("limits.velocity", l.velocity_rad_s, l.velocity_deg_s, f64::to_radians)?.unwrap_or(1.0),
        torque_nm: l.torque_nm.unwrap_or(100.0),
    };
    Ok(Joint {
        mdh,
        link: table.link.unwrap_or_default().into(),
        limits,
        rotor_kg_m2: table.rotor_kg_m2,
    })
}

/// Largest tolerance (m and rad, 1 sigma): beyond it the table is that of another arm.
const MOST_TOLERANCE: f64 = 0.1;

fn tolerances(path: &str, t: &TolerancesTable) -> Result<Tolerances, RobotFileError> {
    let read = |name: &str, si: Option<f64>, scaled: Option<f64>| {
        let field = format!("tolerances.{name}");
        let value = either(path, &field, si, scaled, milli)?;
        match value {
            Some(v) if !(v > 0.0 && v <= MOST_TOLERANCE) => Err(RobotFileError::Value {
                path: path.to_owned(),
                field,
                value: v.to_string(),
                remedy: "give one standard deviation, more than 0 and at most 100 mm or 100 mrad".to_owned(),
            }),
            value => Ok(value),
        }
    };
    Ok(Tolerances {
        length_m: read("length", t.length_m, t.length_mm)?,
        twist_rad: read("twist", t.twist_rad, t.twist_mrad)?,
        offset_rad: read("offset", t.offset_rad, t.offset_mrad)?,
    })
}

fn frame(
    path: &str,
    name: &str,
    default_name: &str,
    table: Option<FrameTable>,
) -> Result<(String, Pose<f64>), RobotFileError> {
    let table = table.unwrap_or_default();
    for value in table.xyz_m.iter().chain(&table.rpy_rad) {
        if !value.is_finite() {
            return Err(RobotFileError::Value {
                path: path.to_owned(),
                field: name.to_owned(),
                value: value.to_string(),
                remedy: "give finite numbers".to_owned(),
            });
        }
    }
    Ok((
        table.name.unwrap_or_else(|| default_name.to_owned()),
        Pose {
            rotation: from_rpy(table.rpy_rad),
            position: table.xyz_m.into(),
        },
    ))
}

/// Joints are named all or none, each by a name of its own.
fn check_names(path: &str, names: &[String]) -> Result<(), RobotFileError> {
    let refuse = |k: usize, remedy: &str| RobotFileError::Value {
        path: path.to_owned(),
        field: format!("joint {}: name", k + 1),
        value: names.get(k).cloned().unwrap_or_default(),
        remedy: remedy.to_owned(),
    };
    if names.iter().all(String::is_empty) {
        return Ok(());
    }
    for (k, name) in names.iter().enumerate() {
        if name.is_empty() || name.chars().count() > 100 {
            return Err(refuse(k, "name every joint or none, with at most 100 letters"));
        }
        if names.iter().take(k).any(|other| other.eq_ignore_ascii_case(name)) {
            return Err(refuse(k, "stands twice: give each joint a name of its own"));
        }
    }
    Ok(())
}

/// Turns the rows of a standard table, read as those of a modified one, into these, and the links into their frames; returns base
/// and flange.
fn modified(robot: &mut Robot, base: Pose<f64>, flange: Pose<f64>) -> (Pose<f64>, Pose<f64>) {
    let row = |joint: &Joint| DhRow {
        theta: joint.mdh.theta,
        d: joint.mdh.d,
        a: joint.mdh.a,
        alpha: joint.mdh.alpha,
    };
    let chain = StandardChain {
        base,
        rows: robot.joints.iter().map(row).collect(),
        flange,
    };
    let table = chain.modified();
    let own = table_frames(&table.rows, &vec![0.0; table.rows.len()]);
    let frames = chain.frames();
    for (((joint, row), own), far) in robot.joints.iter_mut().zip(&table.rows).zip(&own).zip(&frames) {
        joint.mdh = *row;
        joint.link = moved(&joint.link, &compose(&inverse(&compose(&table.base, own)), far));
    }
    (table.base, table.flange)
}

/// Reads a robot from TOML text; `path` is for messages.
///
/// # Errors
/// Text that is not TOML, unknown or doubled fields, impossible values.
pub fn load(path: &str, text: &str) -> Result<RobotModel, RobotFileError> {
    let file: RobotFile = read_toml(text).map_err(|source| RobotFileError::Toml {
        path: path.to_owned(),
        source,
    })?;
    let refused = |source| RobotFileError::Robot {
        path: path.to_owned(),
        source,
    };
    let mut robot = Robot {
        name: heapless::String::new(),
        joints: heapless::Vec::new(),
    };
    if robot.name.push_str(&file.name).is_err() {
        return Err(RobotFileError::Value {
            path: path.to_owned(),
            field: "name".to_owned(),
            value: file.name,
            remedy: "use at most 32 bytes".to_owned(),
        });
    }
    let count = file.joint.len();
    let mut joint_names: Vec<String> = file.joint.iter().map(|j| j.name.clone()).collect();
    check_names(path, &joint_names)?;
    if joint_names.iter().all(String::is_empty) {
        joint_names.clear();
    }
    let standard = file.joint.first().is_some_and(|joint| joint.dh.is_some());
    for (k, table) in file.joint.into_iter().enumerate() {
        if robot.joints.push(joint(path, k + 1, standard, table)?).is_err() {
            return Err(RobotFileError::Value {
                path: path.to_owned(),
                field: "[[joint]]".to_owned(),
                value: count.to_string(),
                remedy: format!("list at most {MAX_CHAIN} joints"),
            });
        }
    }
    // The rows of a standard table may be as long as they like.
    if !standard {
        robot.check().map_err(refused)?;
    }
    let tool = file.tool.unwrap_or_default();
    let tcp_m = match (tool.tcp_m, tool.tcp_mm) {
        (Some(m), None) => m,
        (None, Some(mm)) => mm.map(milli),
        (None, None) => [0.0; 3],
        (Some(_), Some(mm)) => {
            return Err(RobotFileError::Value {
                path: path.to_owned(),
                field: "tool.tcp".to_owned(),
                value: format!("{mm:?}"),
                remedy: "is given twice, in m and in mm: keep one".to_owned(),
            });
        }
    };
    let tool = Tool {
        tcp_m,
        body: tool.body.unwrap_or_default().into(),
    };
    tool.check().map_err(refused)?;
    let (root, mut base) = frame(path, "base", "base", file.base)?;
    let (tip, mut flange) = frame(path, "flange", "flange", file.flange)?;
    if standard {
        (base, flange) = modified(&mut robot, base, flange);
        robot.check().map_err(refused)?;
    }
    let tolerances = tolerances(path, &file.tolerances)?;
    // A calibrated file carries its history; it changes no number here.
    drop(file.calibration);
    Ok(RobotModel {
        robot,
        base,
        flange,
        tool,
        frame_names: (root, tip),
        joint_names,
        slides: Vec::new(),
        tolerances,
        origin: Origin::Toml,
        notes: Vec::new(),
    })
}
