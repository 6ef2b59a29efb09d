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
//!   FILE.urdf ┘                              └─▶ kinematics.yaml
//! ```

mod error;
pub mod frames;
pub mod mdh;
mod model;
pub mod toml_file;
pub mod urdf;
mod urdf_in;
mod urdf_out;

use std::path::Path;

use spherecal_shared::robot::{BUILT_IN, Frame, Tool, iiwa7_tool};

pub use error::RobotFileError;
pub use model::{Origin, RobotModel, moved, table_frames};
pub use urdf_in::load as load_urdf_text;
pub use urdf_out::{write_kinematics_yaml, write_urdf};

/// Largest file that is read, in bytes: a URDF without meshes has some 100 kB.
const MAX_FILE_BYTES: u64 = 8 << 20;

/// A built-in robot with its nominal tool, by name: on the iiwa 7 the
/// calibration tool of the paper, on the others a bare flange.
pub fn built_in(name: &str) -> Option<RobotModel> {
    let robot = spherecal_shared::robot::built_in(name)?;
    let tool = if name == "iiwa7" { iiwa7_tool() } else { Tool::default() };
    Some(RobotModel {
        robot,
        base: Frame::identity(),
        flange: Frame::identity(),
        tool,
        frame_names: ("base_link".to_owned(), "tool0".to_owned()),
        origin: Origin::BuiltIn,
    })
}

/// Loads a robot: a built-in name, `FILE.toml`, `FILE.urdf`, or `FILE.urdf#LINK`
/// for the chain to that link.
///
/// # Errors
/// Names that are neither built in nor a file, and what the file's reader refuses.
pub fn load(spec: &str) -> Result<RobotModel, RobotFileError> {
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
            known: BUILT_IN.join(", "),
        });
    }
    let text = read(path)?;
    match extension.as_str() {
        "toml" => toml_file::load(path, &text),
        "urdf" | "xml" | "xacro" => load_urdf_text(path, &text, tip),
        _ => Err(RobotFileError::Extension { path: path.to_owned() }),
    }
}

fn read(path: &str) -> Result<String, RobotFileError> {
    let failed = |source| RobotFileError::Read {
        path: path.to_owned(),
        source,
    };
    let bytes = std::fs::metadata(path).map_err(failed)?.len();
    if bytes > MAX_FILE_BYTES {
        return Err(RobotFileError::TooLarge {
            path: path.to_owned(),
            bytes,
            limit: MAX_FILE_BYTES,
        });
    }
    std::fs::read_to_string(path).map_err(failed)
}

#[cfg(test)]
mod tests;
