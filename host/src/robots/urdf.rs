//! A URDF as far as a calibration needs it: links with their inertias, joints
//! with their origins, axes and limits, and the chain from base to flange.
//!
//! Joints remember where their `<origin>` stands in the text, so that a
//! calibrated URDF is the input with only those numbers changed.

use std::collections::{HashMap, HashSet};
use std::ops::Range;

use nalgebra::{Matrix3, Vector3};
use spherecal_shared::robot::Frame;

use super::error::RobotFileError;
use super::frames::from_rpy;

/// Most joints (fixed ones included) that a file may have.
const MOST_JOINTS: usize = 2000;

/// What a joint does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Turns (`revolute` and `continuous`).
    Turns,
    /// Never moves.
    Fixed,
    /// Moves in a way that this program cannot calibrate.
    Other,
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
    pub motion: Motion,
    /// The type as written.
    pub kind: String,
    /// Parent and child link.
    pub parent: String,
    /// Child link.
    pub child: String,
    /// Child frame in the parent's frame, joint at zero.
    pub origin: Frame<f64>,
    /// Where the origin is written.
    pub place: OriginPlace,
    /// Unit axis in the child's frame.
    pub axis: Vector3<f64>,
    /// Smallest and largest angle, in rad.
    pub range_rad: (f64, f64),
    /// Largest speed, in rad/s; 0 where the file does not say.
    pub velocity_rad_s: f64,
    /// Largest torque, in N m; 0 where the file does not say.
    pub effort_nm: f64,
    /// Follows another joint.
    pub mimics: bool,
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
}

/// The joints from root to tip (indices into [`Urdf::joints`]).
#[derive(Clone, Debug)]
pub struct UrdfChain {
    /// The root link.
    pub root: String,
    /// The last link: the flange.
    pub tip: String,
    /// Every joint on the way, fixed ones included.
    pub path: Vec<usize>,
    /// What hangs rigidly beyond the tip, as the tip's frame sees its end: a
    /// tool that the file knows.
    pub beyond: Option<(String, Frame<f64>)>,
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

/// Three finite numbers separated by spaces.
fn triple(path: &str, field: impl Fn() -> String, text: &str) -> Result<[f64; 3], RobotFileError> {
    let mut out = [0.0; 3];
    let mut words = text.split_whitespace();
    for slot in &mut out {
        *slot = number(path, &field, words.next().unwrap_or(""))?;
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

/// The frame that an `<origin>` writes; the identity where there is none.
fn origin(path: &str, owner: &str, node: Option<roxmltree::Node<'_, '_>>) -> Result<Frame<f64>, RobotFileError> {
    let Some(node) = node else {
        return Ok(Frame::identity());
    };
    let read = |what: &'static str| match node.attribute(what) {
        Some(text) => triple(path, || format!("{owner}: origin {what}"), text),
        None => Ok([0.0; 3]),
    };
    Ok(Frame {
        rotation: from_rpy(read("rpy")?),
        origin: read("xyz")?.into(),
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
        com: frame.origin,
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

fn joint(path: &str, text: &str, node: roxmltree::Node<'_, '_>) -> Result<UrdfJoint, RobotFileError> {
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
        "revolute" | "continuous" => Motion::Turns,
        "fixed" => Motion::Fixed,
        _ => Motion::Other,
    };
    let axis = match child(node, "axis").and_then(|n| n.attribute("xyz")) {
        Some(text) => triple(path, || format!("{owner}: axis xyz"), text)?.into(),
        None => Vector3::x(),
    };
    let length = axis.norm();
    if motion == Motion::Turns && length < 1e-9 {
        return Err(value_error(
            path,
            format!("{owner}: axis xyz"),
            "0 0 0",
            "give the direction of the axis",
        ));
    }
    let limit = child(node, "limit");
    let read = |what: &'static str, default: f64| match limit.and_then(|n| n.attribute(what)) {
        Some(text) => number(path, || format!("{owner}: limit {what}"), text),
        None => Ok(default),
    };
    let turn = std::f64::consts::TAU;
    let range_rad = if kind == "continuous" {
        (-turn, turn)
    } else {
        (
            read("lower", -std::f64::consts::PI)?,
            read("upper", std::f64::consts::PI)?,
        )
    };
    let origin_node = child(node, "origin");
    Ok(UrdfJoint {
        parent: link_of("parent")?,
        child: link_of("child")?,
        origin: origin(path, &owner, origin_node)?,
        place: origin_node.map_or_else(
            || OriginPlace::Absent(after_start_tag(text, node)),
            |n| OriginPlace::Element(n.range()),
        ),
        axis: if length > 0.0 { axis / length } else { axis },
        range_rad,
        velocity_rad_s: read("velocity", 0.0)?,
        effort_nm: read("effort", 0.0)?,
        mimics: child(node, "mimic").is_some(),
        name,
        motion,
        kind,
    })
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
        let document = roxmltree::Document::parse(text).map_err(|e| syntax(format!("not well-formed XML: {e}")))?;
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
        };
        for node in root.children() {
            if node.has_tag_name("link") {
                let name = node.attribute("name").unwrap_or_default().to_owned();
                if let Some(inertial) = child(node, "inertial") {
                    urdf.bodies.insert(name.clone(), body(path, &name, inertial)?);
                }
                urdf.links.push(name);
            } else if node.has_tag_name("joint") {
                urdf.joints.push(joint(path, text, node)?);
            }
        }
        if urdf.joints.len() > MOST_JOINTS {
            return Err(syntax(format!(
                "holds {} joints: at most {MOST_JOINTS} are read; give the arm alone",
                urdf.joints.len()
            )));
        }
        if urdf.links.is_empty() {
            return Err(syntax(
                "holds no <link>: expand a xacro file first (xacro FILE.xacro > FILE.urdf)".to_owned(),
            ));
        }
        Ok(urdf)
    }

    /// The chain to `tip`, or, without one, the longest chain of turning joints
    /// and its flange: `tool0` or `flange` where the file names one, else the
    /// last link.
    ///
    /// # Errors
    /// A tip that does not exist, several equally long chains, a loop, or a
    /// joint on the way that does not turn.
    pub fn chain(&self, tip: Option<&str>) -> Result<UrdfChain, RobotFileError> {
        let error = |field: &str, value: &str, remedy: String| RobotFileError::Value {
            path: self.path.clone(),
            field: field.to_owned(),
            value: value.to_owned(),
            remedy,
        };
        let into: HashMap<&str, usize> = self
            .joints
            .iter()
            .enumerate()
            .map(|(i, j)| (j.child.as_str(), i))
            .collect();
        let tip = match tip {
            Some(tip) if self.links.iter().any(|l| l == tip) => tip.to_owned(),
            Some(tip) => {
                return Err(error(
                    "tip link",
                    tip,
                    format!("name one of the file's links: {}", self.links.join(", ")),
                ));
            }
            None => self.guess_tip(&into)?,
        };
        let path = self.path_to(&tip, &into)?;
        for &i in &path {
            let joint = &self.joints[i];
            if joint.motion == Motion::Other || joint.mimics {
                return Err(error(
                    &format!("joint \"{}\": type", joint.name),
                    if joint.mimics { "mimic" } else { &joint.kind },
                    format!(
                        "only chains of revolute joints can be calibrated; name another tip as {}#LINK",
                        self.path
                    ),
                ));
            }
        }
        let root = path
            .first()
            .map_or_else(|| tip.clone(), |&i| self.joints[i].parent.clone());
        let beyond = self.beyond(&tip);
        Ok(UrdfChain {
            root,
            tip,
            path,
            beyond,
        })
    }

    /// The joints from the root to a link.
    fn path_to(&self, tip: &str, into: &HashMap<&str, usize>) -> Result<Vec<usize>, RobotFileError> {
        let mut path = Vec::new();
        let mut seen = HashSet::new();
        let mut link = tip;
        while let Some(&i) = into.get(link) {
            if !seen.insert(i) {
                return Err(value_error(
                    &self.path,
                    format!("joint \"{}\": parent", self.joints[i].name),
                    &self.joints[i].parent,
                    "the links form a loop; a URDF is a tree",
                ));
            }
            path.push(i);
            link = &self.joints[i].parent;
        }
        path.reverse();
        Ok(path)
    }

    /// The flange of the longest chain of turning joints.
    fn guess_tip(&self, into: &HashMap<&str, usize>) -> Result<String, RobotFileError> {
        // Each turning joint and how many lie on the way to it, itself included;
        // a way through a sliding joint does not count.
        let mut best: Vec<usize> = Vec::new();
        let mut most = 0;
        for (i, joint) in self.joints.iter().enumerate() {
            if joint.motion != Motion::Turns || joint.mimics {
                continue;
            }
            let path = self.path_to(&joint.child, into)?;
            if path
                .iter()
                .any(|&k| self.joints[k].motion == Motion::Other || self.joints[k].mimics)
            {
                continue;
            }
            let turns = path.iter().filter(|&&k| self.joints[k].motion == Motion::Turns).count();
            if turns > most {
                (most, best) = (turns, vec![i]);
            } else if turns == most {
                best.push(i);
            }
        }
        let &[last] = best.as_slice() else {
            let tips: Vec<&str> = best.iter().map(|&i| self.joints[i].child.as_str()).collect();
            return Err(value_error(
                &self.path,
                "chain of turning joints".to_owned(),
                if tips.is_empty() {
                    "none"
                } else {
                    "several equally long"
                },
                &format!(
                    "name the tip as {}#LINK{}{}",
                    self.path,
                    if tips.is_empty() { "" } else { ", for example one of " },
                    tips.join(", ")
                ),
            ));
        };
        // Everything rigid behind the last turning joint, in breadth.
        let mut rigid = vec![self.joints[last].child.as_str()];
        let mut k = 0;
        while let Some(&link) = rigid.get(k) {
            for joint in self
                .joints
                .iter()
                .filter(|j| j.motion == Motion::Fixed && j.parent == link)
            {
                if !rigid.contains(&joint.child.as_str()) {
                    rigid.push(&joint.child);
                }
            }
            k += 1;
        }
        let named = |suffixes: &[&str]| {
            rigid.iter().find(|l| {
                let lower = l.to_lowercase();
                suffixes
                    .iter()
                    .any(|s| lower == *s || lower.ends_with(&format!("_{s}")))
            })
        };
        let tip = named(&["tool0"])
            .or_else(|| named(&["flange", "link8"]))
            .or_else(|| named(&["link_ee", "ee_link", "ee"]))
            .or(rigid.last())
            .copied()
            .unwrap_or_default();
        Ok(tip.to_owned())
    }

    /// What hangs rigidly beyond a link in one unbranched line.
    fn beyond(&self, tip: &str) -> Option<(String, Frame<f64>)> {
        let mut frame = Frame::identity();
        let mut link = tip;
        for _ in 0..self.joints.len() {
            let mut next = self.joints.iter().filter(|j| j.parent == link);
            match (next.next(), next.next()) {
                (Some(joint), None) if joint.motion == Motion::Fixed => {
                    frame = super::frames::compose(&frame, &joint.origin);
                    link = &joint.child;
                }
                _ => break,
            }
        }
        (link != tip).then(|| (link.to_owned(), frame))
    }
}
