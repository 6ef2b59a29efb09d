//! Reads the compensator of a controller from `calibrated.toml`.

use serde::Deserialize;
use spherecal_shared::MAX_CHAIN;
use spherecal_shared::robot::MdhRow;
use spherecal_shared::robot::compensator::{CompensatedJoint, Compensator, MAX_ORDERS};

use super::error::RobotFileError;
use crate::read_toml;

#[derive(Deserialize)]
struct CompensatorFile {
    calibration: Option<CalibrationTable>,
}

/// The numbers that are needed; the others of `[calibration]` say what the result is.
#[derive(Deserialize)]
struct CalibrationTable {
    #[serde(flatten)]
    rows: MdhColumns,
    compliance_rad_per_nm: Vec<f64>,
    bending_rad_per_nm: Vec<[f64; 2]>,
    tilt_rad_per_nm: [f64; 2],
    harmonics_rad: Vec<Vec<[f64; 2]>>,
    nominal: Option<NominalTable>,
}

#[derive(Deserialize)]
struct NominalTable {
    #[serde(flatten)]
    rows: MdhColumns,
    mass_kg: Vec<f64>,
    com_m: Vec<[f64; 3]>,
}

#[derive(Deserialize)]
struct MdhColumns {
    alpha_rad: Vec<f64>,
    a_m: Vec<f64>,
    theta_rad: Vec<f64>,
    d_m: Vec<f64>,
    beta_rad: Vec<f64>,
    tcp_m: [f64; 3],
}

impl MdhColumns {
    fn row(&self, j: usize) -> Option<MdhRow<f64>> {
        Some(MdhRow {
            alpha: *self.alpha_rad.get(j)?,
            a: *self.a_m.get(j)?,
            beta: *self.beta_rad.get(j)?,
            theta: *self.theta_rad.get(j)?,
            d: *self.d_m.get(j)?,
        })
    }
}

/// Reads the compensator from the text of a `calibrated.toml`; `path` is for messages.
///
/// # Errors
/// A file that no calibration wrote, or one in which a number is missing.
pub fn read_compensator(path: &str, text: &str) -> Result<Compensator, RobotFileError> {
    let file: CompensatorFile = read_toml(text).map_err(|source| RobotFileError::Toml {
        path: path.to_owned(),
        source,
    })?;
    let refuse = |field: &str, value: &str, remedy: &str| RobotFileError::Value {
        path: path.to_owned(),
        field: field.to_owned(),
        value: value.to_owned(),
        remedy: remedy.to_owned(),
    };
    let again = "give the calibrated.toml of `spherecal run` or `spherecal identify`; older ones are written anew by \
                 identifying again";
    let table = file
        .calibration
        .ok_or_else(|| refuse("[calibration]", "missing", again))?;
    let Some(nominal) = table.nominal.as_ref() else {
        return Err(refuse("[calibration.nominal]", "missing", again));
    };
    let count = table.rows.alpha_rad.len();
    if !(1..=MAX_CHAIN).contains(&count) {
        return Err(refuse("calibration.alpha_rad", &format!("{count} joints"), again));
    }
    let joint = |j: usize| {
        let own = table.harmonics_rad.get(j)?;
        let mut harmonics_rad = [[0.0; 2]; MAX_ORDERS];
        harmonics_rad.iter_mut().zip(own).for_each(|(slot, h)| *slot = *h);
        Some(CompensatedJoint {
            nominal: nominal.rows.row(j)?,
            calibrated: table.rows.row(j)?,
            mass_kg: *nominal.mass_kg.get(j)?,
            com_m: *nominal.com_m.get(j)?,
            compliance_rad_per_nm: *table.compliance_rad_per_nm.get(j)?,
            bending_rad_per_nm: *table.bending_rad_per_nm.get(j)?,
            harmonics_rad,
        })
    };
    let mut joints = Vec::with_capacity(count);
    for j in 0..count {
        let found = joint(j).filter(finite);
        joints.push(found.ok_or_else(|| {
            refuse(
                "[calibration]",
                &format!(
                    "joint {} has a list that is too short, or a number that is not finite",
                    j + 1
                ),
                again,
            )
        })?);
    }
    Ok(Compensator::new(
        &joints,
        nominal.rows.tcp_m,
        table.rows.tcp_m,
        table.tilt_rad_per_nm,
    ))
}

fn finite(joint: &CompensatedJoint) -> bool {
    let rows = [joint.nominal, joint.calibrated];
    let rows = rows.iter().flat_map(|r| [r.alpha, r.a, r.beta, r.theta, r.d]);
    let effects = joint.harmonics_rad.iter().chain([&joint.bending_rad_per_nm]).flatten();
    let mut all = rows
        .chain(effects.copied())
        .chain(joint.com_m)
        .chain([joint.mass_kg, joint.compliance_rad_per_nm]);
    all.all(f64::is_finite)
}
