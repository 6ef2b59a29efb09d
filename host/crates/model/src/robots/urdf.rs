//! A URDF as far as a calibration needs it: links with their inertias, joints
//! with their origins, axes and limits, and the chain from base to flange.
//!
//! Joints remember where their `<origin>` stands in the text, so that a
//! calibrated URDF is the input with only those numbers changed.

use std::collections::{HashMap, HashSet};
use std::ops::Range;

use nalgebra::{Matrix3, Vector3};
use spherecal_shared::robot::Pose;

use super::error::RobotFileError;
use super::frames::from_rpy;

mod bounds;
mod chain;
mod limits;
mod prefixes;
mod srdf;
mod tip;

pub use chain::UrdfChain;
pub use srdf::Srdf;

/// Most joints (fixed ones included) that a file may have, and most links.
const MOST_JOINTS: usize = 2000;
/// Most nodes (elements, texts, comments) of a file.
const MOST_NODES: u32 = 1_000_000;
/// Longest distance of two links, in m.
const LARGEST_M: f64 = 100.0;
/// Largest angle of an origin, in rad: beyond a full turn it is in degrees.
const LARGEST_RAD: f64 = 7.0;

/// What a joint does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointMotion {
    /// Turns (`revolute` and `continuous`).
    Turns,
    /// Slides (`prismatic`).
    Slides,
    /// Never moves.
    Fixed,
    /// Moves in a way that this program cannot calibrate (`planar`, `floating`).
    Other,
}

/// The law of a joint that follows another: `multiplier * leader + offset`.
#[derive(Clone, Debug, PartialEq)]
pub struct Mimic {
    /// Name of the joint that leads.
    pub leader: String,
    /// Own motion (rad or m) per motion of the leader.
    pub multiplier: f64,
    /// Own position with the leader at zero, in rad or m.
    pub offset: f64,
}

/// Where a joint's origin stands in the text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum OriginPlace {
    /// The whole `<origin .../>` element.
    Element(Range<usize>),
    /// There is none: one may be put here, right after the joint's start tag.
    Absent(usize),
}

/// One `<joint>`.
#[derive(Clone, Debug)]
pub struct UrdfJoint {
    /// Its name.
    pub name: String,
    /// What it does.
    pub motion: JointMotion,
    /// The type as written.
    pub kind: String,
    /// Parent and child link.
    pub parent: String,
    /// Child link.
    pub child: String,
    /// Child frame in the parent's frame, joint at zero.
    pub origin: Pose<f64>,
    /// Roll, pitch and yaw (rad) of the origin as the file writes them.
    pub rpy: [f64; 3],
    /// Where the origin is written.
    pub place: OriginPlace,
    /// Unit axis in the child's frame.
    pub axis: Vector3<f64>,
    /// Smallest and largest position, in rad or m.
    pub range: (f64, f64),
    /// Largest speed, in rad/s or m/s; 0 where the file does not say.
    pub velocity: f64,
    /// Largest torque or force, in N m or N; 0 where the file does not say.
    pub effort: f64,
    /// The joint that it follows, where it does.
    pub mimic: Option<Mimic>,
}

impl UrdfJoint {
    /// Whether it moves by a position of its own.
    pub(super) fn is_driven(&self) -> bool {
        self.mimic.is_none() && matches!(self.motion, JointMotion::Turns | JointMotion::Slides)
    }
}

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

/// A value error of this file.
fn value_error(path: &str, field: String, value: &str, remedy: &str) -> RobotFileError {
    RobotFileError::Value {
        path: path.to_owned(),
        field,
        value: value.chars().take(80).collect(),
        remedy: remedy.to_owned(),
    }
}

/// One finite number.
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
    let mut out = [0.0; 3];
    let mut words = text.split_whitespace();
    for slot in &mut out {
        *slot = if let Some(word) = words.next() {
            number(path, &field, word)?
        } else {
            let remedy = "write three numbers separated by spaces";
            return Err(value_error(path, field(), text, remedy));
        };
        if slot.abs() > largest {
            let remedy = format!("write numbers of at most {largest}: lengths are in m, angles in rad");
            return Err(value_error(path, field(), text, &remedy));
        }
    }
    if words.next().is_some() {
        return Err(value_error(
            path,
            field(),
            text,
            "write three numbers separated by spaces",
        ));
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
    let (xx, yy, zz) = (
        read("inertia", "ixx")?,
        read("inertia", "iyy")?,
        read("inertia", "izz")?,
    );
    let (xy, xz, yz) = (
        read("inertia", "ixy")?,
        read("inertia", "ixz")?,
        read("inertia", "iyz")?,
    );
    let inertia = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    Ok(UrdfBody {
        mass_kg: read("mass", "value")?,
        com: frame.position,
        inertia: frame.rotation * inertia * frame.rotation.transpose(),
    })
}

/// Where a node's start tag ends (just after its `>`).
fn after_start_tag(text: &str, node: roxmltree::Node<'_, '_>) -> usize {
    let range = node.range();
    let end_of_attributes = node.attributes().map(|a| a.range().end).max().unwrap_or(range.start);
    text.get(end_of_attributes..range.end)
        .and_then(|rest| rest.find('>'))
        .map_or(range.end, |k| end_of_attributes + k + 1)
}

fn mimic(path: &str, owner: &str, node: roxmltree::Node<'_, '_>) -> Result<Mimic, RobotFileError> {
    let read = |what: &'static str, default: f64| match node.attribute(what) {
        Some(text) => number(path, || format!("{owner}: mimic {what}"), text),
        None => Ok(default),
    };
    Ok(Mimic {
        leader: node.attribute("joint").unwrap_or_default().to_owned(),
        multiplier: read("multiplier", 1.0)?,
        offset: read("offset", 0.0)?,
    })
}

/// Reads a joint; limits that cannot be meant are named in `odd`.
fn joint(
    path: &str,
    text: &str,
    node: roxmltree::Node<'_, '_>,
    odd: &mut Vec<String>,
) -> Result<UrdfJoint, RobotFileError> {
    let name = node.attribute("name").unwrap_or_default().to_owned();
    let owner = format!("joint \"{name}\"");
    let link_of = |tag: &str| {
        child(node, tag)
            .and_then(|n| n.attribute("link"))
            .map(str::to_owned)
            .ok_or_else(|| {
                value_error(
                    path,
                    format!("{owner}: <{tag} link>"),
                    "",
                    "every joint names its parent and its child link",
                )
            })
    };
    let kind = node.attribute("type").unwrap_or_default().to_owned();
    let motion = match kind.as_str() {
        "revolute" | "continuous" => JointMotion::Turns,
        "prismatic" => JointMotion::Slides,
        "fixed" => JointMotion::Fixed,
        _ => JointMotion::Other,
    };
    let axis = match child(node, "axis").and_then(|n| n.attribute("xyz")) {
        Some(text) => triple(path, || format!("{owner}: axis xyz"), text, 1e6)?.into(),
        None => Vector3::x(),
    };
    let length = axis.norm();
    if matches!(motion, JointMotion::Turns | JointMotion::Slides) && length < 1e-9 {
        return Err(value_error(
            path,
            format!("{owner}: axis xyz"),
            "0 0 0",
            "give the direction of the axis",
        ));
    }
    let limits = limits::read(path, &owner, &kind, child(node, "limit"))?;
    let mimic = child(node, "mimic").map(|m| mimic(path, &owner, m)).transpose()?;
    let origin_node = child(node, "origin");
    let (xyz, rpy) = origin_numbers(path, &owner, origin_node)?;
    odd.extend(limits.odd.iter().map(|what| format!("{owner}: {what}")));
    Ok(UrdfJoint {
        parent: link_of("parent")?,
        child: link_of("child")?,
        origin: Pose {
            rotation: from_rpy(rpy),
            position: xyz.into(),
        },
        rpy,
        place: origin_node.map_or_else(
            || OriginPlace::Absent(after_start_tag(text, node)),
            |n| OriginPlace::Element(n.range()),
        ),
        axis: if length > 0.0 { axis / length } else { axis },
        range: limits.range,
        velocity: limits.velocity,
        effort: limits.effort,
        mimic,
        name,
        motion,
        kind,
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
                urdf.joints.push(joint(path, text, node, &mut odd)?);
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
