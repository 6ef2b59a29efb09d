//! One joint of a URDF.

use std::ops::Range;

use nalgebra::Vector3;
use spherecal_shared::robot::Pose;

use super::{child, limits, number, origin_numbers, triple, value_error};
use crate::robots::error::RobotFileError;
use crate::robots::frames::from_rpy;

/// What a joint does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointMotion {
    /// Turns (`revolute` and `continuous`).
    Turns,
    /// Slides (`prismatic`).
    Slides,
    /// Never moves.
    Fixed,
    /// Moves in a way that this program cannot calibrate (`planar`, `floating`), or is of a type that URDF does not have.
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

/// Where a joint's origin or axis stands in the text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum OriginPlace {
    /// The whole `<origin .../>` or `<axis .../>` element.
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
    /// Where the axis is written.
    pub axis_place: OriginPlace,
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
    /// The name of a joint that carries a tool centre point which this program wrote.
    pub fn name_of_tcp(parent: &str, child: &str) -> String {
        format!("{parent}-{child}")
    }

    /// Whether it carries a tool centre point that this program wrote into a calibrated file.
    pub fn carries_own_tcp(&self) -> bool {
        self.motion == JointMotion::Fixed
            && self.child.ends_with("_tcp")
            && self.name == Self::name_of_tcp(&self.parent, &self.child)
    }

    /// Whether it is the joint of a base that drives or floats.
    pub(super) fn is_base(&self) -> bool {
        matches!(self.kind.as_str(), "floating" | "planar")
    }

    /// Whether it moves by a position of its own.
    pub(in super::super) fn is_driven(&self) -> bool {
        self.mimic.is_none() && matches!(self.motion, JointMotion::Turns | JointMotion::Slides)
    }
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
pub(super) fn read(
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
    let axis_node = child(node, "axis");
    let axis = match axis_node.and_then(|n| n.attribute("xyz")) {
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
    let place = |element: Option<roxmltree::Node<'_, '_>>| {
        let absent = || OriginPlace::Absent(after_start_tag(text, node));
        element.map_or_else(absent, |n| OriginPlace::Element(n.range()))
    };
    Ok(UrdfJoint {
        parent: link_of("parent")?,
        child: link_of("child")?,
        origin: Pose {
            rotation: from_rpy(rpy),
            position: xyz.into(),
        },
        rpy,
        place: place(origin_node),
        axis_place: place(axis_node),
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
