//! `calibration.conf` of a controller of Universal Robots: what the factory measured of one arm, as corrections of the
//! maker's standard Denavit-Hartenberg table.
//!
//! The form (section `[mounting]`, four lists of six numbers in m and rad that are added to the table) is described by the
//! maker's staff and users at <https://forum.universal-robots.com/t/ur10-calibration-conf-dh-model-generation/1638> and
//! <https://github.com/ros-industrial/universal_robot/issues/357>; the table at
//! <https://www.universal-robots.com/articles/ur/application-installation/dh-parameters-for-calculations-of-kinematics-and-dynamics/>.

use super::error::RobotFileError;
use super::model::RobotModel;
use super::ur_parameters::UrParameters;
use super::vendor::{UR_ROBOTS, ur_lengths};

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
            UR_ROBOTS.map(|(known, _)| known).join(", ")
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
