//! Joint origins as YAML, in and out: the calibration that ROS descriptions load.
//!
//! Two forms of vendors and a plain one are read and written, see
//! the module `vendor`. A file holds joint origins only: no masses, no limits.
//! [`write_offsets_yaml`] writes the differences to the nominal origins, for a
//! xacro that adds them itself.

use std::fmt::Write as _;

use sha2::{Digest, Sha256};
use spherecal_shared::robot::{MdhRow, Pose};

use super::error::RobotFileError;
use super::frames::{compose, row_transform, to_rpy_near};
use super::model::{Origin, RobotModel};
use super::urdf::JointMotion;
use super::urdf_out::{SAME, corrected};
use super::vendor::{self, Form, JointOrigin, UR_KEYS, Z};
use super::yaml_entries::{AXIS, MOST_JOINTS, NUMBERS, entries};
use super::{frames, urdf_in};
use crate::printable;

/// Key of the tip in the last joint's link; left out where they are the same.
const TIP: &str = "tool0";
/// Tips closer to the last joint's link than this (m, or an entry of the rotation) are the same: vendors write angles
/// with ten digits.
const SAME_TIP: f64 = 1e-9;

/// Writes the joint origins of `rows` in the vendor's form; `notes` become comments.
///
/// The key `tool0` holds the tip in the last joint's link where the form knows no place for it; vendors' descriptions
/// read past it.
pub fn write_kinematics_yaml(model: &RobotModel, rows: &[MdhRow<f64>], notes: &[String]) -> String {
    let (form, root, origins) = calibrated(model, rows);
    let mut body = String::new();
    let pad = match form {
        Form::Franka => "",
        _ => "  ",
    };
    for (_, origin) in &origins {
        let _ = writeln!(body, "{pad}{}:", yaml_key(&origin.key));
        if form == Form::Franka {
            body.push_str("  kinematic:\n");
        }
        for (key, value) in NUMBERS.iter().zip(origin.xyz.iter().chain(&origin.rpy)) {
            let _ = writeln!(body, "    {key}: {}", value + 0.0);
        }
        if origin.axis != Z {
            for (key, value) in AXIS.iter().zip(origin.axis) {
                let _ = writeln!(body, "    {key}: {}", value + 0.0);
            }
        }
    }
    let mut hash = String::new();
    for byte in Sha256::digest(body.as_bytes()).iter().take(8) {
        let _ = write!(hash, "{byte:02x}");
    }
    let head = head(notes, form, &root, "Joint origins with all joints at zero.");
    match form {
        Form::Franka => format!("{head}{body}"),
        _ => format!("{head}kinematics:\n{body}  hash: calib_{hash}\n"),
    }
}

/// Writes what to add to the nominal joint origins, number by number, by the names
/// of the joints.
///
/// In a xacro: `<xacro:property name="o" value="${xacro.load_yaml('offsets.yaml')['joint_offsets']}"/>`,
/// then `<origin xyz="${x + o['JOINT']['x']} .." rpy="${roll + o['JOINT']['roll']} .."/>`.
pub fn write_offsets_yaml(model: &RobotModel, rows: &[MdhRow<f64>], notes: &[String]) -> String {
    let (form, root, origins) = calibrated(model, rows);
    let (_, _, nominal) = calibrated(model, &model.nominal_rows());
    let mut out = head(
        notes,
        form,
        &root,
        "Corrections: add each number to the nominal one of the joint's origin (x, y, z, roll, pitch, yaw).",
    );
    out.push_str("joint_offsets:\n");
    for ((name, is), (_, was)) in origins.iter().zip(&nominal).filter(|((_, is), _)| is.key != TIP) {
        let _ = writeln!(out, "  {}:", yaml_key(name));
        let pairs = is.xyz.iter().zip(&was.xyz).chain(is.rpy.iter().zip(&was.rpy));
        for (key, (is, was)) in NUMBERS.iter().zip(pairs) {
            let _ = writeln!(out, "    {key}: {}", is - was + 0.0);
        }
    }
    out
}

fn head(notes: &[String], form: Form, root: &str, what: &str) -> String {
    let mut out = String::new();
    for line in notes.iter().flat_map(|n| n.lines()) {
        let _ = writeln!(out, "# {}", printable(line));
    }
    let _ = writeln!(
        out,
        "# {what} Lengths in m, angles in rad; R = Rz(yaw) Ry(pitch) Rx(roll)."
    );
    let _ = writeln!(out, "# {}", printable(&vendor::base_words(form, root)));
    out
}

/// The origins of `rows` in the form of the robot's description: form, root link,
/// and by joint its name and its origin.
fn calibrated(model: &RobotModel, rows: &[MdhRow<f64>]) -> (Form, String, Vec<(String, JointOrigin)>) {
    let vendor = vendor::description_of(model);
    // The vendor's description ends at the table's last frame.
    let own_flange = vendor.as_ref().map_or_else(Pose::identity, |_| model.flange);
    let model = vendor.as_ref().unwrap_or(model);
    let root = model.frame_names.0.clone();
    // A chain that goes up has no origins of joints in one line: those of the table.
    let source = match &model.origin {
        Origin::Urdf(source) if source.1.up == 0 => source,
        _ => {
            let mut out = from_table(model, rows);
            out.extend(tip(&model.flange));
            return (Form::Plain, root, out);
        }
    };
    let (urdf, chain) = source.as_ref();
    let form = vendor::form(urdf, chain);
    let mut out = Vec::new();
    for (k, (i, frame)) in corrected(model, urdf, chain, rows).origins.into_iter().enumerate() {
        let joint = &urdf.joints[i];
        let near = if frames::distance(&frame, &joint.origin) < SAME {
            (joint.origin, joint.rpy)
        } else {
            (frame, to_rpy_near(&frame.rotation, joint.rpy))
        };
        out.push((
            joint.name.clone(),
            JointOrigin {
                key: vendor::key(form, k, &joint.name),
                xyz: near.0.position.into(),
                rpy: near.1,
                axis: joint.axis.into(),
            },
        ));
    }
    let last = chain
        .path
        .iter()
        .rposition(|&i| urdf.joints[i].motion != JointMotion::Fixed);
    let mut rigid = chain.path.get(last.map_or(0, |k| k + 1)..).unwrap_or_default();
    // Franka's eighth joint is the flange.
    if form == Form::Franka
        && let Some((&flange, behind)) = rigid.split_first()
        && let flange = &urdf.joints[flange]
        && flange.name.ends_with("joint8")
    {
        out.push((
            flange.name.clone(),
            JointOrigin {
                key: "joint8".to_owned(),
                xyz: flange.origin.position.into(),
                rpy: flange.rpy,
                axis: Z,
            },
        ));
        rigid = behind;
    }
    let behind = rigid
        .iter()
        .fold(Pose::identity(), |at, &i| compose(&at, &urdf.joints[i].origin));
    out.extend(tip(&compose(&behind, &own_flange)));
    (form, root, out)
}

/// The tip behind the last joint of a form, where it is anywhere else.
fn tip(frame: &Pose<f64>) -> Option<(String, JointOrigin)> {
    let origin = JointOrigin {
        key: TIP.to_owned(),
        xyz: frame.position.into(),
        rpy: frames::to_rpy(&frame.rotation),
        axis: Z,
    };
    (frames::distance(frame, &Pose::identity()) > SAME_TIP).then(|| (TIP.to_owned(), origin))
}

/// The origins of a table that came without a description: those of its own frames.
fn from_table(model: &RobotModel, rows: &[MdhRow<f64>]) -> Vec<(String, JointOrigin)> {
    let name = |k: usize| {
        let known = model.joint_names.get(k).filter(|name| !name.is_empty());
        known.cloned().unwrap_or_else(|| format!("joint_{}", k + 1))
    };
    let origin = |(k, row): (usize, &MdhRow<f64>)| {
        let own = row_transform(row, 0.0);
        let frame: Pose<f64> = if k == 0 { compose(&model.base, &own) } else { own };
        let origin = JointOrigin {
            key: name(k),
            xyz: frame.position.into(),
            rpy: frames::to_rpy(&frame.rotation),
            axis: Z,
        };
        (name(k), origin)
    };
    rows.iter().enumerate().map(origin).collect()
}

/// A key of YAML, quoted where a bare one could mean something else.
fn yaml_key(name: &str) -> String {
    let plain = name.len() > 3
        && name.starts_with(|c: char| c.is_ascii_alphabetic())
        && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
        && !["true", "false", "null"].contains(&name.to_lowercase().as_str());
    if plain {
        name.to_owned()
    } else {
        serde_json::Value::String(name.to_owned()).to_string()
    }
}

/// Reads joint origins as a robot without masses; `path` is for messages.
///
/// # Errors
/// Text that is not YAML of one of the forms, missing or impossible numbers.
pub fn load(path: &str, text: &str) -> Result<RobotModel, RobotFileError> {
    let entries = entries(path, text)?;
    let refuse = |field: &str, value: &str, remedy: &str| RobotFileError::Value {
        path: path.to_owned(),
        field: field.to_owned(),
        value: value.to_owned(),
        remedy: remedy.to_owned(),
    };
    let mut form = Form::Plain;
    let mut origins: Vec<JointOrigin> = Vec::new();
    for entry in &entries {
        let words: Vec<&str> = entry.keys.iter().map(String::as_str).collect();
        let (joint, number) = match words.as_slice() {
            ["kinematics", "hash"] => continue,
            ["kinematics", joint, number] => (*joint, *number),
            [joint, "kinematic", number] => {
                form = Form::Franka;
                (*joint, *number)
            }
            other => {
                return Err(refuse(
                    &format!("line {}: key", entry.line),
                    &other.join(": "),
                    "write kinematics: JOINT: x, y, z, roll, pitch, yaw, or (Franka) JOINT: kinematic: x, y, ..",
                ));
            }
        };
        let field = format!("line {}: {joint}: {number}", entry.line);
        let Some(slot) = NUMBERS.iter().chain(&AXIS).position(|known| *known == number) else {
            return Err(refuse(
                &field,
                &entry.value,
                "write x, y, z (m), roll, pitch and yaw (rad)",
            ));
        };
        let value = entry.number().filter(|v| v.is_finite() && v.abs() < 100.0);
        let Some(value) = value else {
            return Err(refuse(
                &field,
                &entry.value,
                "write a finite number in m or rad, below 100",
            ));
        };
        let at = match origins.iter().position(|o| o.key == joint) {
            Some(at) => at,
            None if origins.len() == MOST_JOINTS => {
                return Err(refuse(&field, joint, &format!("list at most {MOST_JOINTS} joints")));
            }
            None => {
                origins.push(JointOrigin {
                    key: joint.to_owned(),
                    xyz: [f64::NAN; 3],
                    rpy: [f64::NAN; 3],
                    axis: [f64::NAN; 3],
                });
                origins.len() - 1
            }
        };
        let origin = &mut origins[at];
        let slot = origin
            .xyz
            .iter_mut()
            .chain(&mut origin.rpy)
            .chain(&mut origin.axis)
            .nth(slot);
        if let Some(slot) = slot {
            if !slot.is_nan() {
                return Err(refuse(&field, &entry.value, "stands twice: keep one"));
            }
            *slot = value;
        }
    }
    for origin in &mut origins {
        if origin.axis.iter().all(|v| v.is_nan()) {
            origin.axis = Z;
        }
        if origin.axis.iter().any(|v| v.is_nan()) {
            return Err(refuse(
                &format!("{}: axis", origin.key),
                "",
                "give axis_x, axis_y and axis_z, or none of them",
            ));
        }
        let missing = NUMBERS
            .iter()
            .zip(origin.xyz.iter().chain(&origin.rpy))
            .find(|pair| pair.1.is_nan());
        if let Some((number, _)) = missing {
            return Err(refuse(
                &format!("{}: {number}", origin.key),
                "",
                "give all six numbers of every joint",
            ));
        }
    }
    let tip = origins.iter().position(|o| o.key == TIP).map(|at| origins.remove(at));
    if origins.is_empty() {
        return Err(refuse(
            "joints",
            "none",
            "list the joints under kinematics:, each with x, y, z, roll, pitch and yaw",
        ));
    }
    if form == Form::Plain
        && origins.len() == UR_KEYS.len()
        && origins.iter().all(|o| UR_KEYS.contains(&o.key.as_str()))
    {
        form = Form::UniversalRobots;
        origins.sort_by_key(|o| UR_KEYS.iter().position(|key| *key == o.key));
    }
    if form == Form::Franka {
        let expected = |k: usize| format!("joint{}", k + 1);
        origins.sort_by(|a, b| a.key.cmp(&b.key));
        if origins.len() != 8 || origins.iter().enumerate().any(|(k, o)| o.key != expected(k)) {
            return Err(refuse(
                "joints",
                &origins.len().to_string(),
                "list joint1 to joint7, and joint8 for the flange",
            ));
        }
    }
    let name = std::path::Path::new(path)
        .file_stem()
        .map_or("robot".into(), |stem| stem.to_string_lossy());
    urdf_in::load(path, &vendor::urdf_text(form, &name, &origins, tip.as_ref()), None)
}
