//! Whether the tables of a request can be identified together, before anything is computed.

use std::collections::HashSet;

use nalgebra::Vector3;
use spherecal_model::input::{InputError, Table};

use super::StudyError;
use crate::flange::Flange;
use crate::recordings::ValidationRows;
use crate::targets::measured_tcp;
use crate::{Experiment, Target};

/// Most placements of the plate in one table: each has six unknowns of its own,
/// and time and memory of the identification grow with their square.
const MOST_PLACES: usize = 200;
/// Most spheres in one table, as on one plate.
const MOST_SPHERES: usize = 100;

/// Contacts without a plate: nothing gives them a scale.
pub(super) fn no_plate() -> StudyError {
    InputError::Field {
        file: "command line".to_owned(),
        field: "--plate".to_owned(),
        value: "missing".to_owned(),
        remedy: "contacts with spheres give the robot no scale without the spheres' certified positions: give \
                 --plate FILE.toml ([[sphere]] tables with id, x_mm, y_mm, z_mm, sigma_mm), or --plate paper for \
                 Table 1 of the paper"
            .to_owned(),
    }
    .into()
}

/// The hold-out names a column that the table has.
pub(super) fn check_label(table: &Table, label: Option<&str>) -> Result<(), StudyError> {
    let known = ["sphere", "place", "set", "coupling", "region"];
    match label {
        Some(name) if !known.contains(&name.to_lowercase().as_str()) && table.labels.is_empty() => {
            Err(InputError::Columns {
                file: table.file.clone(),
                what: format!(
                    "--holdout names column \"{}\", which is not in the table",
                    spherecal_model::excerpt(name)
                ),
                remedy: "name a column of the table, or place, sphere, set, coupling or region".to_owned(),
            }
            .into())
        }
        _ => Ok(()),
    }
}

/// The rows that judge have no targets or orientations that the others leave unknown.
pub(super) fn check_judges(data: &ValidationRows, judges: &ValidationRows) -> Result<(), StudyError> {
    let targets = |rows: &ValidationRows| {
        let most = rows.observations.iter().map(|o| match &o.target {
            Target::Points(all) => all.len(),
            _ => 1,
        });
        most.max().unwrap_or(1)
    };
    let posed = |rows: &ValidationRows| rows.observations.iter().any(|o| matches!(o.target, Target::Frame(_)));
    let (known, asked) = (targets(data), targets(judges));
    let (what, remedy) = if asked > known {
        (
            format!("has target {asked}, and the calibration rows have {known}"),
            format!("leave its columns out (--ignore-columns x{asked}_mm,y{asked}_mm,z{asked}_mm)"),
        )
    } else if posed(judges) && !posed(data) {
        (
            "has orientations, and the calibration rows have none".to_owned(),
            "leave them out (--ignore-columns qw,qx,qy,qz)".to_owned(),
        )
    } else {
        return Ok(());
    };
    Err(InputError::Columns {
        file: judges.file.clone(),
        what,
        remedy,
    }
    .into())
}

/// The rows do not touch more spheres, in more places, than can be identified together.
pub(super) fn check_places(data: &ValidationRows) -> Result<(), StudyError> {
    let (mut spheres, mut places) = (HashSet::new(), HashSet::new());
    for o in &data.observations {
        if let Target::Sphere { sphere, place } = o.target {
            spheres.insert(sphere);
            places.insert(place);
        }
    }
    for (count, most, what, remedy) in [
        (
            spheres.len(),
            MOST_SPHERES,
            "sphere",
            "give the id of the plate's sphere that the tool sat on",
        ),
        (
            places.len(),
            MOST_PLACES,
            "place",
            "give one value per placement of the plate; leave the column out if the plate was not moved \
             (--ignore-columns place)",
        ),
    ] {
        if count > most {
            return Err(InputError::Count {
                file: data.file.clone(),
                found: format!("{count} values in the column {what}, and at most {most} are identified together"),
                remedy: remedy.to_owned(),
            }
            .into());
        }
    }
    Ok(())
}

/// The measured points spread as far as the robot moved, unless their unit is wrong.
pub(super) fn check_unit(experiment: &Experiment, file: &str) -> Result<(), StudyError> {
    let flange = Flange::new(&experiment.robot);
    let tool = experiment.tool.tcp();
    let observations = &experiment.observations;
    let step = observations.len().div_ceil(1000).max(1);
    let (mut moved, mut measured) = (Vec::new(), Vec::new());
    for o in observations.iter().step_by(step) {
        if let Some(p) = measured_tcp(&o.target) {
            moved.push(flange.at(&o.q).point(&tool));
            measured.push(p);
        }
    }
    let (moved, measured) = (spread(&moved), spread(&measured));
    let remedy = match measured / moved {
        ratio if (0.3e-3..3e-3).contains(&ratio) => "name the columns x_m, y_m, z_m: the numbers are metres",
        ratio if (0.3e3..3e3).contains(&ratio) => "name the columns x_mm, y_mm, z_mm: the numbers are millimetres",
        _ => return Ok(()),
    };
    Err(InputError::Field {
        file: file.to_owned(),
        field: "the spread of the measured points".to_owned(),
        value: format!(
            "{:.3} mm, while the robot moved its TCP over {:.0} mm (root mean square)",
            measured * 1e3,
            moved * 1e3
        ),
        remedy: remedy.to_owned(),
    }
    .into())
}

/// Root mean square of the distances from the mean, in m.
fn spread(points: &[Vector3<f64>]) -> f64 {
    let n = points.len().max(1) as f64;
    let mean = points.iter().sum::<Vector3<f64>>() / n;
    (points.iter().map(|p| (p - mean).norm_squared()).sum::<f64>() / n).sqrt()
}
