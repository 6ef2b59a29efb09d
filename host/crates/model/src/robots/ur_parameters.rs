//! The Denavit-Hartenberg parameters that a controller of Universal Robots computes with, as a robot.
//!
//! Each joint turns about z by its angle and `theta`, then the frame moves by `d` along z, by `a` along x, and turns by
//! `alpha` about x. Joints 2, 3 and 4 are near parallel, and the factory calibration may put their frames hundreds of metres
//! apart along their axes. Here those frames are moved back along their axes, as the maker's tool `ur_calibration` does, so
//! that a joint origin tells what it seems to tell. The kinematics stay.

use std::f64::consts::FRAC_PI_2;

use nalgebra::Vector3;
use spherecal_shared::robot::Pose;

use super::error::RobotFileError;
use super::frames::{compose, inverse, rot_x, rot_z, to_rpy};
use super::model::RobotModel;
use super::vendor::{self, Form, JointOrigin, UR_KEYS, UR_ROBOTS, Z, ur_lengths};
use super::{built_in, urdf_in};

/// Joints of every arm of Universal Robots.
const JOINTS: usize = 6;
/// A joint origin that is farther from a built-in robot's than this (m) belongs to another robot: the lengths of two robots
/// of the maker differ by more, and a calibration changes them by less.
const SAME_ROBOT_M: f64 = 0.015;

/// The parameters of all joints, base to flange.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UrParameters {
    /// Joint offsets, rad.
    pub theta: [f64; JOINTS],
    /// Lengths along x, m.
    pub a: [f64; JOINTS],
    /// Lengths along z, m.
    pub d: [f64; JOINTS],
    /// Twists, rad.
    pub alpha: [f64; JOINTS],
}

fn along_z(way: f64) -> Vector3<f64> {
    Vector3::new(0.0, 0.0, way)
}

/// Where the axis of `frame` crosses the plane z = 0 of `parent`, given there. `None` for an axis along that plane.
fn crossing(parent: &Pose<f64>, frame: &Pose<f64>) -> Option<Vector3<f64>> {
    let local = compose(&inverse(parent), frame);
    let axis = local.z();
    (axis.z.abs() > 0.5).then(|| local.position - axis * (local.position.z / axis.z))
}

/// `frame` turned about its z axis so that `point`, given in it, lies on its negative x axis, as in the maker's nominal
/// robots.
fn turned(frame: &Pose<f64>, point: &Vector3<f64>) -> Pose<f64> {
    let angle = (-point.y).atan2(-point.x);
    Pose {
        rotation: frame.rotation * rot_z(angle),
        position: frame.position,
    }
}

impl UrParameters {
    /// The nominal parameters of a robot with these lengths d1, a2, a3, d4, d5, d6 (m).
    pub fn of_lengths([d1, a2, a3, d4, d5, d6]: [f64; JOINTS]) -> Self {
        Self {
            theta: [0.0; JOINTS],
            a: [0.0, -a2, -a3, 0.0, 0.0, 0.0],
            d: [d1, 0.0, 0.0, d4, d5, d6],
            alpha: [FRAC_PI_2, 0.0, 0.0, FRAC_PI_2, -FRAC_PI_2, 0.0],
        }
    }

    /// The frames of the joints in the robot's base, all joints at zero, and the flange.
    fn frames(&self) -> ([Pose<f64>; JOINTS], Pose<f64>) {
        let mut at = Pose::identity();
        let frames = std::array::from_fn(|j| {
            let frame = compose(
                &at,
                &Pose {
                    rotation: rot_z(self.theta[j]),
                    position: along_z(self.d[j]),
                },
            );
            at = compose(
                &frame,
                &Pose {
                    rotation: rot_x(self.alpha[j]),
                    position: Vector3::new(self.a[j], 0.0, 0.0),
                },
            );
            frame
        });
        (frames, at)
    }

    /// Joint origins with the frames of the upper arm and the forearm where the maker's nominal robots have them, and the
    /// flange in the last one.
    fn origins(&self) -> (Vec<JointOrigin>, Pose<f64>) {
        let (mut frames, flange) = self.frames();
        // Back to where the first link ends.
        frames[1].position -= frames[1].z() * self.d[1];
        for k in [1, 2] {
            let Some(point) = crossing(&frames[k], &frames[k + 1]) else {
                continue;
            };
            if k == 1 {
                frames[2].position = frames[1].point(&point);
            }
            frames[k] = turned(&frames[k], &point);
        }
        let mut before = Pose::identity();
        let origins = UR_KEYS.iter().zip(&frames).map(|(key, frame)| {
            let local = compose(&inverse(&before), frame);
            before = *frame;
            JointOrigin {
                key: (*key).to_owned(),
                xyz: local.position.into(),
                rpy: to_rpy(&local.rotation),
                axis: Z,
            }
        });
        let origins = origins.collect();
        (origins, compose(&inverse(&frames[JOINTS - 1]), &flange))
    }

    /// The robot that computes with these parameters. If it is a built-in one, it has the name, the masses and the limits of
    /// that one; else the name `ur` and no masses.
    ///
    /// # Errors
    /// Parameters that are not those of a robot.
    pub fn robot(&self) -> Result<RobotModel, RobotFileError> {
        let (origins, flange) = self.origins();
        let known = nearest(&origins);
        let name = known.unwrap_or("ur");
        let tip = JointOrigin {
            key: "tool0".to_owned(),
            xyz: flange.position.into(),
            rpy: to_rpy(&flange.rotation),
            axis: Z,
        };
        let tip = (tip.xyz != [0.0; 3] || tip.rpy != [0.0; 3]).then_some(&tip);
        let text = vendor::urdf_text(Form::UniversalRobots, name, &origins, tip);
        let mut model = urdf_in::load(name, &text, None)?;
        if let Some(known) = known.and_then(built_in) {
            for (own, source) in model.robot.joints.iter_mut().zip(&known.robot.joints) {
                (own.link, own.limits) = (source.link, source.limits);
            }
        }
        Ok(model)
    }
}

/// The built-in robot of the maker whose joint origins are all within 15 mm of these.
fn nearest(origins: &[JointOrigin]) -> Option<&'static str> {
    let off = |known: &[JointOrigin]| {
        let pairs = known.iter().zip(origins);
        pairs.fold(0.0_f64, |most, (a, b)| {
            most.max((Vector3::from(a.xyz) - Vector3::from(b.xyz)).norm())
        })
    };
    vendor::UR_ROBOTS
        .iter()
        .filter_map(|name| Some((*name, off(&vendor::ur(ur_lengths(name)?)))))
        .filter(|(_, off)| *off < SAME_ROBOT_M)
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(name, _)| name)
}

// `calibration.conf` of a controller of Universal Robots: what the factory measured of one arm, as corrections of the
// maker's standard Denavit-Hartenberg table.
//
// The form (section `[mounting]`, four lists of six numbers in m and rad that are added to the table) is described by the
// maker's staff and users at <https://forum.universal-robots.com/t/ur10-calibration-conf-dh-model-generation/1638> and
// <https://github.com/ros-industrial/universal_robot/issues/357>; the table at
// <https://www.universal-robots.com/articles/ur/application-installation/dh-parameters-for-calculations-of-kinematics-and-dynamics/>.

fn refuse(path: &str, field: &str, value: &str, remedy: &str) -> RobotFileError {
    RobotFileError::Value {
        path: path.to_owned(),
        field: field.to_owned(),
        value: value.to_owned(),
        remedy: remedy.to_owned(),
    }
}

/// The six numbers of a list.
fn list(path: &str, text: &str, name: &str) -> Result<[f64; 6], RobotFileError> {
    let remedy =
        "give the calibration.conf of a controller: lists delta_theta, delta_a, delta_d and delta_alpha of six numbers";
    let value = text.lines().find_map(|line| {
        let (key, value) = line.split('#').next()?.split_once('=')?;
        (key.trim() == name).then(|| value.trim())
    });
    let value = value.ok_or_else(|| refuse(path, name, "missing", remedy))?;
    let inner = value.strip_prefix('[').and_then(|v| v.strip_suffix(']'));
    let numbers: Option<Vec<f64>> = inner.and_then(|v| v.split(',').map(|n| n.trim().parse().ok()).collect());
    let six = numbers.and_then(|n| <[f64; 6]>::try_from(n).ok());
    six.filter(|six| six.iter().all(|v| v.is_finite()))
        .ok_or_else(|| refuse(path, name, value, remedy))
}

/// The built-in arm `name` with the calibration of a controller; `path` is for messages.
/// Errors: an arm that is not built in, lists that are missing or have not six numbers, and corrections of more than
/// some cm.
pub(super) fn load(path: &str, text: &str, name: Option<&str>) -> Result<RobotModel, RobotFileError> {
    let Some((name, lengths)) = name.and_then(|name| Some((name, ur_lengths(name)?))) else {
        let remedy = format!(
            "name the arm that it corrects as {path}#NAME, with one of {}",
            UR_ROBOTS.join(", ")
        );
        return Err(refuse(path, "arm", name.unwrap_or("not named"), &remedy));
    };
    let mut dh = UrParameters::of_lengths(lengths);
    for (list_name, numbers) in [
        ("delta_theta", &mut dh.theta),
        ("delta_a", &mut dh.a),
        ("delta_d", &mut dh.d),
        ("delta_alpha", &mut dh.alpha),
    ] {
        let delta = list(path, text, list_name)?;
        numbers
            .iter_mut()
            .zip(delta)
            .for_each(|(number, delta)| *number += delta);
    }
    let model = dh.robot()?;
    if model.robot.name.as_str() != name {
        let remedy = format!("a factory corrects some mm: is it the calibration of another arm than {name}?");
        return Err(refuse(path, "arm", name, &remedy));
    }
    Ok(model)
}
