//! A URDF as far as a calibration needs it: links with their inertias, joints
//! with their origins, axes and limits, and the chain from base to flange.
//!
//! Joints remember where their `<origin>` stands in the text, so that a
//! calibrated URDF is the input with only those numbers changed.

use nalgebra::{Matrix3, Vector3};
use spherecal_shared::robot::Pose;
use std::collections::{HashMap, HashSet};

use super::error::RobotFileError;
use super::frames::from_rpy;

mod bounds;
mod chain;
mod joint;
mod limits;
mod prefixes;
mod tip;

pub use chain::UrdfChain;
pub use joint::{JointMotion, Mimic, OriginPlace, UrdfJoint};
pub use prefixes::Srdf;

/// Most joints (fixed ones included) that a file may have, and most links.
const MOST_JOINTS: usize = 2000;
/// Most nodes (elements, texts, comments) of a file.
const MOST_NODES: u32 = 1_000_000;
/// Longest distance of two links, in m.
const LARGEST_M: f64 = 100.0;
/// Largest angle of an origin, in rad: beyond a full turn it is in degrees.
const LARGEST_RAD: f64 = 7.0;

/// Mass distribution of one `<link>`, in the link's frame.
#[derive(Clone, Copy, Debug)]
pub struct UrdfBody {
    /// Mass, in kg.
    pub mass_kg: f64,
    /// Centre of mass, in m.
    pub com: Vector3<f64>,
    /// Inertia about it, axes of the link's frame, in kg m².
    pub inertia: Matrix3<f64>,
}

/// One parsed URDF.
#[derive(Clone, Debug)]
pub struct Urdf {
    /// The robot's name.
    pub name: String,
    /// Where the file came from, for messages.
    pub path: String,
    /// The text itself.
    pub text: String,
    /// Names of the links, in the file's order.
    pub links: Vec<String>,
    /// Inertias by link.
    pub bodies: HashMap<String, UrdfBody>,
    /// Joints, in the file's order.
    pub joints: Vec<UrdfJoint>,
    /// Where the root element starts in the text.
    pub root_at: usize,
    /// What was read although it cannot be meant, for the user: one sentence each.
    pub notes: Vec<String>,
}

fn value_error(path: &str, field: String, value: &str, remedy: &str) -> RobotFileError {
    RobotFileError::Value {
        path: path.to_owned(),
        field,
        value: value.chars().take(80).collect(),
        remedy: remedy.to_owned(),
    }
}

fn number(path: &str, field: impl Fn() -> String, text: &str) -> Result<f64, RobotFileError> {
    match text.trim().parse::<f64>() {
        Ok(v) if v.is_finite() => Ok(v),
        _ => Err(value_error(
            path,
            field(),
            text,
            "write a finite number (a xacro file must be expanded first: xacro FILE.xacro > FILE.urdf)",
        )),
    }
}

/// Three finite numbers separated by spaces, each at most `largest` either way.
fn triple(path: &str, field: impl Fn() -> String, text: &str, largest: f64) -> Result<[f64; 3], RobotFileError> {
    let spaces = "write three numbers separated by spaces";
    if text.contains([',', ';']) {
        return Err(value_error(path, field(), text, spaces));
    }
    let mut out = [0.0; 3];
    let mut words = text.split_whitespace();
    for slot in &mut out {
        *slot = if let Some(word) = words.next() {
            number(path, &field, word)?
        } else {
            return Err(value_error(path, field(), text, spaces));
        };
        if slot.abs() > largest {
            let remedy = format!("write numbers of at most {largest}: lengths are in m, angles in rad");
            return Err(value_error(path, field(), text, &remedy));
        }
    }
    if words.next().is_some() {
        return Err(value_error(path, field(), text, spaces));
    }
    Ok(out)
}

/// Position and roll, pitch, yaw that an `<origin>` writes; zeros where there is none.
fn origin_numbers(
    path: &str,
    owner: &str,
    node: Option<roxmltree::Node<'_, '_>>,
) -> Result<([f64; 3], [f64; 3]), RobotFileError> {
    let Some(node) = node else {
        return Ok(([0.0; 3], [0.0; 3]));
    };
    let read = |what: &'static str, largest: f64| match node.attribute(what) {
        Some(text) => triple(path, || format!("{owner}: origin {what}"), text, largest),
        None => Ok([0.0; 3]),
    };
    Ok((read("xyz", LARGEST_M)?, read("rpy", LARGEST_RAD)?))
}

/// The frame that an `<origin>` writes; the identity where there is none.
fn origin(path: &str, owner: &str, node: Option<roxmltree::Node<'_, '_>>) -> Result<Pose<f64>, RobotFileError> {
    let (xyz, rpy) = origin_numbers(path, owner, node)?;
    Ok(Pose {
        rotation: from_rpy(rpy),
        position: xyz.into(),
    })
}

fn child<'a, 'i>(node: roxmltree::Node<'a, 'i>, tag: &str) -> Option<roxmltree::Node<'a, 'i>> {
    node.children().find(|c| c.has_tag_name(tag))
}

fn body(path: &str, link: &str, node: roxmltree::Node<'_, '_>) -> Result<UrdfBody, RobotFileError> {
    let frame = origin(path, &format!("link \"{link}\": inertial"), child(node, "origin"))?;
    let read = |tag: &str, name: &str| match child(node, tag).and_then(|n| n.attribute(name)) {
        Some(text) => number(path, || format!("link \"{link}\": {tag} {name}"), text),
        None => Ok(0.0),
    };
    // A mass, or a moment of inertia about an axis.
    let positive = |tag: &str, name: &str| {
        let value = read(tag, name)?;
        if value < 0.0 {
            return Err(value_error(
                path,
                format!("link \"{link}\": {tag} {name}"),
                &value.to_string(),
                "give a number that is not negative, in kg or kg m²",
            ));
        }
        Ok(value)
    };
    let (xx, yy, zz) = (
        positive("inertia", "ixx")?,
        positive("inertia", "iyy")?,
        positive("inertia", "izz")?,
    );
    let (xy, xz, yz) = (
        read("inertia", "ixy")?,
        read("inertia", "ixz")?,
        read("inertia", "iyz")?,
    );
    let inertia = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    Ok(UrdfBody {
        mass_kg: positive("mass", "value")?,
        com: frame.position,
        inertia: frame.rotation * inertia * frame.rotation.transpose(),
    })
}

/// How a description is parsed.
fn parsing<'i>() -> roxmltree::ParsingOptions<'i> {
    roxmltree::ParsingOptions {
        // Entities could multiply without bound.
        allow_dtd: false,
        nodes_limit: MOST_NODES,
        ..roxmltree::ParsingOptions::default()
    }
}

/// What is wrong with an XML text, with the line where it is known.
fn xml_words(error: &roxmltree::Error) -> String {
    match error {
        roxmltree::Error::DtdDetected => {
            "holds a document type (<!DOCTYPE ..>), which is not read: remove it, and write its entities out".to_owned()
        }
        roxmltree::Error::NodesLimitReached => {
            format!("holds more than {MOST_NODES} elements and texts: give the arm alone")
        }
        roxmltree::Error::NoRootNode => "holds no element: a URDF starts with <robot name=\"...\">".to_owned(),
        other => format!("line {}: is not well-formed XML: {other}", other.pos().row),
    }
}

/// The first name that stands twice.
fn twice<'a>(mut names: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let mut seen = HashSet::new();
    names.find(|name| !seen.insert(*name))
}

impl Urdf {
    /// Reads a URDF's text; `path` is for messages.
    ///
    /// # Errors
    /// Text that is not XML, is not a `<robot>`, or holds a value that cannot be used.
    pub fn parse(path: &str, text: &str) -> Result<Self, RobotFileError> {
        let syntax = |message: String| RobotFileError::Syntax {
            path: path.to_owned(),
            message,
        };
        bounds::check(text).map_err(|e| {
            syntax(format!(
                "line {}: holds more than {} {}: give the description of the arm alone, without meshes inside",
                e.line, e.limit, e.what
            ))
        })?;
        let mut notes = Vec::new();
        let readable = prefixes::readable(text, &mut notes);
        let document =
            roxmltree::Document::parse_with_options(&readable, parsing()).map_err(|e| syntax(xml_words(&e)))?;
        let root = document.root_element();
        if !root.has_tag_name("robot") {
            return Err(syntax(format!(
                "the root element is <{}>: a URDF starts with <robot name=\"...\">",
                root.tag_name().name()
            )));
        }
        let mut urdf = Self {
            name: root.attribute("name").unwrap_or("robot").to_owned(),
            path: path.to_owned(),
            text: text.to_owned(),
            links: Vec::new(),
            bodies: HashMap::new(),
            joints: Vec::new(),
            root_at: root.range().start,
            notes,
        };
        let mut odd = Vec::new();
        for node in root.children() {
            if node.has_tag_name("link") {
                let name = node.attribute("name").unwrap_or_default().to_owned();
                if let Some(inertial) = child(node, "inertial") {
                    urdf.bodies.insert(name.clone(), body(path, &name, inertial)?);
                }
                urdf.links.push(name);
            } else if node.has_tag_name("joint") {
                urdf.joints.push(joint::read(path, text, node, &mut odd)?);
            }
        }
        urdf.notes.extend(limits::said(&odd));
        urdf.unique()?;
        for (count, what) in [(urdf.joints.len(), "joints"), (urdf.links.len(), "links")] {
            if count > MOST_JOINTS {
                return Err(syntax(format!(
                    "holds {count} {what}: at most {MOST_JOINTS} are read; give the arm alone"
                )));
            }
        }
        if urdf.links.is_empty() {
            return Err(syntax(
                "holds no <link>: expand a xacro file first (xacro FILE.xacro > FILE.urdf)".to_owned(),
            ));
        }
        Ok(urdf)
    }

    /// Links and joints have names of their own, and a link has one parent.
    fn unique(&self) -> Result<(), RobotFileError> {
        for (what, found) in [
            ("a link's name", twice(self.links.iter().map(String::as_str))),
            ("a joint's name", twice(self.joints.iter().map(|j| j.name.as_str()))),
            ("a child link", twice(self.joints.iter().map(|j| j.child.as_str()))),
        ] {
            if let Some(name) = found {
                return Err(value_error(
                    &self.path,
                    what.to_owned(),
                    name,
                    "stands twice: give each its own name, and each link one parent",
                ));
            }
        }
        Ok(())
    }
}
