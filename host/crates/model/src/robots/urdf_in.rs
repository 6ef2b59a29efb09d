//! From a URDF to a [`RobotModel`]: axes to modified DH, fixed links merged
//! into the ones that carry them.

use nalgebra::Vector3;
use spherecal_shared::MAX_CHAIN;
use spherecal_shared::robot::{Inertia, Joint, JointLimits, Pose, Robot, Tool};

use super::error::RobotFileError;
use super::frames::{compose, inverse};
use super::mdh::{Axis, from_axes};
use super::model::{Origin, RobotModel, Tolerances, moved, table_frames};
use super::urdf::{JointMotion, Srdf, Urdf, UrdfBody, UrdfChain};
use crate::excerpt;

/// Speed limit (rad/s) of a joint whose file gives none: slow.
const DEFAULT_VELOCITY_RAD_S: f64 = 1.0;
/// Torque limit (N m) of a joint whose file gives none.
const DEFAULT_TORQUE_NM: f64 = 100.0;

/// The frames of a chain with all joints at zero, in the base frame: that of every joint's child link, and the tip's.
pub(super) fn frames_at_zero(urdf: &Urdf, chain: &UrdfChain) -> (Vec<Pose<f64>>, Pose<f64>) {
    let mut at = Pose::identity();
    let mut frames = Vec::with_capacity(chain.path.len());
    for (k, &i) in chain.path.iter().enumerate() {
        let origin = &urdf.joints[i].origin;
        if k < chain.up {
            frames.push(at);
            at = compose(&at, &inverse(origin));
        } else {
            at = compose(&at, origin);
            frames.push(at);
        }
    }
    (frames, at)
}

/// The axis of a joint of the path in its own frame: it turns or slides towards the tip, seen from the base, so that of a
/// joint that is passed upwards is reversed.
pub(super) fn axis_towards_tip(urdf: &Urdf, chain: &UrdfChain, k: usize, i: usize) -> Vector3<f64> {
    let axis = urdf.joints[i].axis;
    if k < chain.up { -axis } else { axis }
}

/// Reads the chain that `ends` names (`TIP` or `BASE:TIP`, or the arm) of a URDF.
///
/// # Errors
/// What [`Urdf::parse`] and [`Urdf::chain`] refuse, chains of other lengths than 1 to [`MAX_CHAIN`] turning joints, chains that are
/// not plain ([`RobotModel::plain`]), and impossible masses.
pub fn load(path: &str, text: &str, ends: Option<&str>) -> Result<RobotModel, RobotFileError> {
    load_path(path, text, ends, None)?.plain()
}

/// The same, also for a chain whose joints slide or follow others ([`RobotModel::joint_path`]).
///
/// # Errors
/// As [`load`].
pub fn load_any(path: &str, text: &str, ends: Option<&str>) -> Result<RobotModel, RobotFileError> {
    load_path(path, text, ends, None)
}

/// The same with the semantic description beside the file, and also for a chain whose joints slide or follow others:
/// the table is that of its turning joints, with the sliding ones at zero.
/// Errors: as [`load`].
pub(super) fn load_path(
    path: &str,
    text: &str,
    ends: Option<&str>,
    srdf: Option<&Srdf>,
) -> Result<RobotModel, RobotFileError> {
    let urdf = Urdf::parse(path, text)?;
    let chain = urdf.chain(ends, srdf)?;
    let (frames, end) = frames_at_zero(&urdf, &chain);
    let turning: Vec<(usize, usize)> = chain
        .path
        .iter()
        .enumerate()
        .filter(|&(_, &i)| urdf.joints[i].motion == JointMotion::Turns)
        .map(|(k, &i)| (k, i))
        .collect();
    if turning.is_empty() || turning.len() > MAX_CHAIN {
        return Err(RobotFileError::Joints {
            path: path.to_owned(),
            base: chain.root.clone(),
            tip: chain.tip.clone(),
            joints: turning.len(),
        });
    }
    let axes: Vec<Axis> = turning
        .iter()
        .map(|&(k, i)| Axis {
            point: frames[k].position,
            direction: frames[k].rotation * axis_towards_tip(&urdf, &chain, k, i),
        })
        .collect();
    let table = from_axes(&axes, &end);
    let at_zero = table_frames(&table.rows, &vec![0.0; table.rows.len()]);

    let mut robot = Robot {
        name: short_name(&urdf.name),
        joints: heapless::Vec::new(),
    };
    for (n, (&(k, i), row)) in turning.iter().zip(&table.rows).enumerate() {
        let until = turning.get(n + 1).map_or(chain.path.len(), |&(next, _)| next);
        // The bodies between this joint and the next, and all that hangs on them rigidly.
        let in_link = compose(&inverse(&compose(&table.base, &at_zero[n])), &frames[k]);
        // Gravity has no fixed direction in a base that moves, so masses say nothing there.
        let link = if chain.up == 0 {
            rigid_body(&urdf, &chain, k, until, &in_link)
        } else {
            Inertia::default()
        };
        let source = &urdf.joints[i];
        let joint = Joint {
            mdh: *row,
            link,
            limits: JointLimits {
                min_rad: source.range.0,
                max_rad: source.range.1,
                velocity_rad_s: or_default(source.velocity, DEFAULT_VELOCITY_RAD_S),
                torque_nm: or_default(source.effort, DEFAULT_TORQUE_NM),
            },
            rotor_kg_m2: 0.0,
        };
        // At most MAX_CHAIN, checked above.
        let _ = robot.joints.push(joint);
    }
    robot.check().map_err(|source| RobotFileError::Robot {
        path: path.to_owned(),
        source,
    })?;
    let tool = Tool {
        tcp_m: chain.beyond.as_ref().map_or([0.0; 3], |(_, f)| f.position.into()),
        body: Inertia::default(),
    };
    tool.check().map_err(|source| RobotFileError::Robot {
        path: path.to_owned(),
        source,
    })?;
    let mut notes = urdf.notes.clone();
    if chain.up > 0 {
        notes.push(format!(
            "the way from {} to {} goes up the tree and down again: everything is seen from {}, which moves itself, so \
             masses are not used",
            excerpt(&chain.root),
            excerpt(&chain.tip),
            excerpt(&chain.root)
        ));
    }
    Ok(RobotModel {
        robot,
        base: table.base,
        flange: table.flange,
        tool,
        frame_names: (chain.root.clone(), chain.tip.clone()),
        joint_names: turning.iter().map(|&(_, i)| urdf.joints[i].name.clone()).collect(),
        slides: Vec::new(),
        tolerances: Tolerances::default(),
        notes,
        origin: Origin::Urdf(Box::new((urdf, chain))),
    })
}

/// At most 31 bytes of a name, cut between letters.
fn short_name(name: &str) -> heapless::String<32> {
    let mut short = heapless::String::new();
    for letter in name.chars() {
        if short.push(letter).is_err() {
            break;
        }
    }
    short
}

/// A limit, or the default where the file says 0 or nothing (as many do).
fn or_default(value: f64, default: f64) -> f64 {
    if value > 0.0 { value } else { default }
}

/// The bodies that ride on the joint at place `from` of the path, as one body
/// in the table's frame; `in_link` is the joint's child link seen from it.
fn rigid_body(urdf: &Urdf, chain: &UrdfChain, from: usize, until: usize, in_link: &Pose<f64>) -> Inertia {
    let mut total = Inertia::default();
    let Some(&joint) = chain.path.get(from) else {
        return total;
    };
    let next = chain.path.get(until);
    let mut open = vec![(urdf.joints[joint].child.as_str(), *in_link)];
    // A tree has no more links than joints and one; the bound also ends a malformed file.
    for _ in 0..=urdf.joints.len() {
        let Some((link, frame)) = open.pop() else { break };
        if let Some(body) = urdf.bodies.get(link) {
            total = total.combined(&moved(&in_axes(body), &frame));
        }
        // Branches ride along too: a gripper's fingers are taken as they stand at zero.
        for (i, j) in urdf.joints.iter().enumerate() {
            if j.parent == link && Some(&i) != next {
                open.push((&j.child, compose(&frame, &j.origin)));
            }
        }
    }
    total
}

fn in_axes(body: &UrdfBody) -> Inertia {
    let m = body.inertia;
    Inertia {
        mass_kg: body.mass_kg,
        com_m: body.com.into(),
        inertia_kg_m2: [m[(0, 0)], m[(1, 1)], m[(2, 2)], m[(0, 1)], m[(0, 2)], m[(1, 2)]],
    }
}
