//! Robots of the field, in and out: built-in names, TOML, URDF, kinematics YAML.
//!
//! Vocabulary: the *root* is the first frame of a file, the *flange* the frame
//! that tools are given in; the *table* is the modified DH table between them.
//! Whatever the source, the result is one [`RobotModel`]; everything beyond
//! this module computes with its table.
//!
//! ```text
//!   NAME ─────┐                              ┌─▶ TOML
//!   FILE.toml ┼─▶ RobotModel ─(calibrated)───┼─▶ URDF (the input, its joint origins corrected)
//!   FILE.urdf ┤                              ├─▶ kinematics.yaml (the vendor's keys)
//!   FILE.yaml ┤                              └─▶ offsets.yaml
//!   FILE.conf ┘ (Universal Robots)
//! ```

mod chain_words;
mod compare;
mod compensator;
mod error;
mod frame_tree;
pub mod frames;
pub mod kinematics_yaml;
mod limbs;
pub mod mdh;
mod model;
mod path;
mod standard_dh;
pub mod toml_file;
mod toml_text;
mod ur_parameters;
pub mod urdf;
mod urdf_in;
mod urdf_out;
mod vendor;
mod yaml_entries;

use std::path::Path;

use spherecal_shared::robot::{BUILT_IN, Pose, Tool, iiwa7_tool};

use crate::read_text;
use urdf::Srdf;

pub use compare::{LinkDifference, RobotDifference, compare};
pub use compensator::read_compensator;
pub use error::RobotFileError;
pub use frame_tree::{FrameInParent, FrameTree};
pub use kinematics_yaml::{write_kinematics_yaml, write_offsets_yaml};
pub use limbs::{Limb, Trunk, write_urdf_of_limbs};
pub use model::{Origin, RobotModel, Tolerances, moved, near, table_frames};
pub use path::{JointKind, JointPath, PathFrames, PathJoint, Twist};
pub use standard_dh::{DhRow, StandardChain};
pub use ur_parameters::UrParameters;
pub use urdf_in::{load as load_urdf_text, load_any as load_urdf_text_path};
pub use urdf_out::{write_urdf, write_urdf_with_tcp};
pub use vendor::{UR_MOTOR_KG_M2, ur_lengths};

/// Largest URDF, in bytes: one without meshes has some 100 kB.
const MOST_URDF_BYTES: u64 = 8 << 20;
/// Largest TOML or YAML file, in bytes: a robot has some 10 kB.
const MOST_TABLE_BYTES: u64 = 1 << 20;

/// A built-in robot with its nominal tool, by name: on the iiwa 7 the
/// calibration tool of the paper, on the others a bare flange.
pub fn built_in(name: &str) -> Option<RobotModel> {
    let robot = spherecal_shared::robot::built_in(name)?;
    let tool = if name == "iiwa7" { iiwa7_tool() } else { Tool::default() };
    Some(RobotModel {
        robot,
        base: Pose::identity(),
        flange: Pose::identity(),
        tool,
        frame_names: ("base_link".to_owned(), "tool0".to_owned()),
        joint_names: vendor::joint_names(name),
        slides: Vec::new(),
        tolerances: Tolerances::default(),
        origin: Origin::BuiltIn,
        notes: Vec::new(),
    })
}

/// The largest mass at the flange of a built-in robot by its maker's data sheet, in kg. `None` for
/// another robot.
pub fn payload_kg(name: &str) -> Option<f64> {
    match name {
        "panda" | "fr3" | "irb120" | "ur3" | "ur3e" => Some(3.0),
        "ur5" | "ur5e" => Some(5.0),
        "iiwa7" => Some(7.0),
        "ur10" => Some(10.0),
        "ur10e" => Some(12.5),
        "iiwa14" => Some(14.0),
        "ur16e" => Some(16.0),
        // The first data sheets' figures; newer software permits 25 and 35 kg.
        "ur20" => Some(20.0),
        "ur30" => Some(30.0),
        _ => None,
    }
}

/// The built-in name that a wrong one is nearest to, if it is near and begins with the same letter.
fn nearest(spec: &str) -> Option<&'static str> {
    let spec = spec.trim().to_lowercase();
    BUILT_IN
        .iter()
        .filter(|known| known.chars().next() == spec.chars().next())
        .map(|known| (strsim::levenshtein(&spec, known), *known))
        .min_by_key(|(distance, _)| *distance)
        .filter(|(distance, known)| *distance <= 2 && *distance < known.len().min(spec.len()))
        .map(|(_, known)| known)
}

/// Loads a robot: a built-in name, `FILE.toml`, `FILE.urdf`, `FILE.urdf#TIP` or `FILE.urdf#BASE:TIP` for the chain to
/// or between these links, `FILE.yaml` (joint origins as ROS descriptions load them), or `FILE.conf#ROBOT` (a controller's calibration of a built-in
/// arm of Universal Robots). An SRDF of the same name beside
/// the URDF says where its arm ends.
///
/// Files are regular files (a link to one is followed) of at most 8 MiB (URDF) or
/// 1 MiB (TOML, YAML); a URDF with a document type, with more than 64 levels, 64
/// attributes of an element or 2,000 joints is refused.
///
/// # Errors
/// Names that are neither built in nor a file, what the file's reader refuses, and chains that are not
/// [plain](RobotModel::plain).
pub fn load(spec: &str) -> Result<RobotModel, RobotFileError> {
    load_path(spec)?.plain()
}

/// The same, for an arm that a controller is to drive.
///
/// # Errors
/// As [`load`], and for more than [`MAX_JOINTS`](spherecal_shared::MAX_JOINTS) joints.
pub fn load_driven(spec: &str) -> Result<RobotModel, RobotFileError> {
    let model = load(spec)?;
    match model.robot.driven() {
        Ok(_) => Ok(model),
        Err(source) => Err(RobotFileError::Robot {
            path: spec.to_owned(),
            source,
        }),
    }
}

/// The same as [`load`], also for a chain with joints that slide or follow others ([`RobotModel::joint_path`]).
///
/// # Errors
/// As [`load`].
pub fn load_path(spec: &str) -> Result<RobotModel, RobotFileError> {
    if let Some(model) = built_in(spec) {
        return Ok(model);
    }
    let (path, tip) = match spec.rsplit_once('#') {
        Some((path, tip)) if !Path::new(spec).exists() => (path, Some(tip)),
        _ => (spec, None),
    };
    let extension = Path::new(path)
        .extension()
        .map(|e| e.to_string_lossy().to_lowercase())
        .unwrap_or_default();
    let looks_like_a_file = !extension.is_empty() || path.contains(['/', '\\']) || Path::new(path).exists();
    if !looks_like_a_file {
        return Err(RobotFileError::Unknown {
            spec: spec.to_owned(),
            nearest: nearest(spec).map_or_else(String::new, |name| format!("did you mean {name}? Else ")),
            known: BUILT_IN.join(", "),
        });
    }
    let (limit, remedy) = match extension.as_str() {
        "toml" | "yaml" | "yml" | "conf" => (MOST_TABLE_BYTES, "give the description of one robot"),
        "urdf" | "xml" | "xacro" => (MOST_URDF_BYTES, "give the URDF of the arm without meshes inside"),
        _ => return Err(RobotFileError::Extension { path: path.to_owned() }),
    };
    let text = read_text(Path::new(path), limit, remedy)?;
    match extension.as_str() {
        "toml" => toml_file::load(path, &text),
        "yaml" | "yml" => kinematics_yaml::load(path, &text),
        "conf" => ur_parameters::load(path, &text, tip),
        _ => urdf_in::load_path(path, &text, tip, srdf_beside(path)?.as_ref()),
    }
}

/// The SRDF of the same name beside a URDF, if there is one.
fn srdf_beside(path: &str) -> Result<Option<Srdf>, RobotFileError> {
    let path = Path::new(path).with_extension("srdf");
    if !path.exists() {
        return Ok(None);
    }
    let text = read_text(&path, MOST_TABLE_BYTES, "give the groups of one robot")?;
    Srdf::parse(&path.display().to_string(), &text).map(Some)
}

#[cfg(test)]
mod tests;
