//! `calibration.conf` of a controller of Universal Robots: what the factory measured of one arm, as corrections of the
//! maker's standard Denavit-Hartenberg table.
//!
//! The form (section `[mounting]`, four lists of six numbers in m and rad that are added to the table) is described by the
//! maker's staff and users at <https://forum.universal-robots.com/t/ur10-calibration-conf-dh-model-generation/1638> and
//! <https://github.com/ros-industrial/universal_robot/issues/357>; the table at
//! <https://www.universal-robots.com/articles/ur/application-installation/dh-parameters-for-calculations-of-kinematics-and-dynamics/>.

use std::f64::consts::FRAC_PI_2;

use spherecal_shared::robot::Pose;

use super::built_in;
use super::error::RobotFileError;
use super::frames::{compose, distance, inverse};
use super::model::{Origin, RobotModel};
use super::standard_dh::{DhRow, StandardChain};

/// Built-in arms of Universal Robots.
const ARMS: [&str; 2] = ["ur5e", "ur10e"];
/// Twists of the maker's table, in rad.
const ALPHA: [f64; 6] = [FRAC_PI_2, 0.0, 0.0, FRAC_PI_2, -FRAC_PI_2, 0.0];
/// Largest distance (m, and rad times m) of a calibrated flange from the nominal one: makers correct some mm. Beyond it the file
/// is of another arm.
const LARGEST_M: f64 = 0.03;

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

/// The maker's table of a built-in arm.
fn nominal(model: &RobotModel) -> Vec<DhRow> {
    let own = model.rows();
    let length = |k: usize| own.get(k + 1).map_or(0.0, |next| -next.a);
    let row = |(k, row): (usize, &spherecal_shared::robot::MdhRow<f64>)| DhRow {
        theta: 0.0,
        d: row.d,
        a: length(k),
        alpha: ALPHA.get(k).copied().unwrap_or_default(),
    };
    own.iter().enumerate().map(row).collect()
}

/// The flange at joint angles, from frame 0.
fn flange(rows: &[DhRow], q: f64) -> Pose<f64> {
    rows.iter()
        .fold(Pose::identity(), |at, row| compose(&at, &row.transform(q)))
}

/// The built-in arm `name` with the calibration of a controller; `path` is for messages.
///
/// # Errors
/// An arm that is not built in, lists that are missing or have not six numbers, and corrections of more than some cm.
pub(super) fn load(path: &str, text: &str, name: Option<&str>) -> Result<RobotModel, RobotFileError> {
    let known = name.filter(|name| ARMS.contains(name)).and_then(built_in);
    let Some(mut model) = known else {
        let remedy = format!(
            "name the arm that it corrects as {path}#NAME, with one of {}",
            ARMS.join(", ")
        );
        return Err(refuse(path, "arm", name.unwrap_or("not named"), &remedy));
    };
    let [theta, a, d, alpha] = ["delta_theta", "delta_a", "delta_d", "delta_alpha"].map(|name| list(path, text, name));
    let (theta, a, d, alpha) = (theta?, a?, d?, alpha?);
    let before = nominal(&model);
    let add = |(k, row): (usize, &DhRow)| DhRow {
        theta: row.theta + theta[k],
        d: row.d + d[k],
        a: row.a + a[k],
        alpha: row.alpha + alpha[k],
    };
    let rows: Vec<DhRow> = before.iter().enumerate().map(add).collect();
    let far = [0.0, 0.7, -1.1]
        .map(|q| distance(&flange(&before, q), &flange(&rows, q)))
        .into_iter()
        .fold(0.0, f64::max);
    if far.is_nan() || far > LARGEST_M {
        let remedy = format!(
            "a factory corrects some mm: is it the calibration of another arm than {}?",
            model.robot.name
        );
        return Err(refuse(
            path,
            "correction of the flange",
            &format!("{:.0} mm", far * 1e3),
            &remedy,
        ));
    }
    let chain = StandardChain {
        // The maker's base is turned against that of its ROS description.
        base: compose(&model.flange_at(&[0.0; 6]), &inverse(&flange(&before, 0.0))),
        rows,
        flange: Pose::identity(),
    };
    let table = chain.modified();
    for (joint, row) in model.robot.joints.iter_mut().zip(&table.rows) {
        joint.mdh = *row;
    }
    (model.base, model.flange, model.origin) = (table.base, table.flange, Origin::Controller);
    model.robot.check().map_err(|source| RobotFileError::Robot {
        path: path.to_owned(),
        source,
    })?;
    Ok(model)
}
