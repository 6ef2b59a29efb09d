//! From a request to plain data: robot, tool, plate and samples, checked
//! against each other.

use std::collections::HashSet;
use std::path::PathBuf;

use nalgebra::Vector3;
use spherecal_shared::robot::{Inertia, Tool};

use super::StudyError;
use super::sources::{Sources, TableSource, plate};
use super::torques::understand_torques;
use crate::flange::Flange;
use crate::recordings::{Recordings, Rows, Sample};
use crate::{Experiment, Observation, Options, Set, Target};
use spherecal_model::input::{InputError, Labels, Progress, Row, Table, TableFormat};
use spherecal_model::robots::{self, RobotModel};

/// Most placements of the plate in one table: each has six unknowns of its own,
/// and time and memory of the identification grow with their square.
const MOST_PLACES: usize = 200;
/// Most spheres in one table, as on one plate.
const MOST_SPHERES: usize = 100;

/// What the user asks for.
#[derive(Clone, Debug, Default)]
pub struct Request {
    /// Built-in name, `FILE.toml` or `FILE.urdf`.
    pub robot: String,
    /// Table of poses.
    pub data: PathBuf,
    /// The plate's certificate: a file, or [`PAPER_PLATE`](super::PAPER_PLATE).
    pub plate: Option<PathBuf>,
    /// Nominal TCP in the flange frame, in mm; the robot's own without it.
    pub tool_mm: Option<[f64; 3]>,
    /// Mass at the flange, in kg.
    pub payload_kg: Option<f64>,
    /// Its centre of mass in the flange frame, in mm.
    pub payload_com_mm: Option<[f64; 3]>,
    /// Table of poses that judge the result.
    pub validate: Option<PathBuf>,
    /// Column whose values are held out one after the other.
    pub holdout: Option<String>,
    /// Columns that hold the joint angles, base to flange, in place of q1..; or none.
    pub joint_columns: Vec<String>,
    /// Columns that are left out.
    pub ignore_columns: Vec<String>,
    /// Mean error of the TCP that is asked for, in mm: a worse result is refused.
    pub accuracy_mm: Option<f64>,
    /// Try a map of the residuals, and keep it where it predicts rows better that it has not seen.
    pub residual_map: bool,
    /// How to identify.
    pub options: Options,
}

/// Everything that a study is made from.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The robot with its files' frames.
    pub model: RobotModel,
    /// The rows of the files.
    pub recordings: Recordings,
    /// What the user should know about how the data were taken.
    pub notes: Vec<String>,
}

/// The files that a request names, for its robot; tables are read later.
///
/// # Errors
/// A plate that cannot be read.
pub fn sources(request: &Request, model: RobotModel) -> Result<Sources<'_>, StudyError> {
    Ok(Sources {
        model,
        plate: request.plate.as_deref().map(plate).transpose()?,
        data: TableSource::File(&request.data),
        validate: request.validate.as_deref().map(TableSource::File),
        notes: Vec::new(),
    })
}

/// Loads what a request names; `progress` is called while tables are read.
///
/// # Errors
/// Files that cannot be read or used, with field, value and remedy.
pub fn load(request: &Request, progress: &mut dyn FnMut(Progress)) -> Result<Loaded, StudyError> {
    assemble(request, sources(request, robots::load(&request.robot)?)?, progress)
}

/// The same from what a caller has in memory: the request's own robot, plate and tables
/// are not read. Both ways meet the same checks.
///
/// # Errors
/// As [`load`].
pub fn assemble(
    request: &Request,
    sources: Sources<'_>,
    progress: &mut dyn FnMut(Progress),
) -> Result<Loaded, StudyError> {
    let Sources {
        mut model,
        plate,
        data,
        validate,
        mut notes,
    } = sources;
    set_tool(&mut model, request)?;
    borrow_masses(&mut model, &mut notes);
    let certified = plate.is_some();
    let plate = plate.unwrap_or_default();
    notes.extend(plate.notes);
    let spheres = plate.spheres;
    let mut format = TableFormat {
        joints: model.robot.dof(),
        joint_names: model.joint_names.clone(),
        joint_columns: request.joint_columns.clone(),
        ignore: request.ignore_columns.clone(),
        label: request.holdout.clone(),
    };
    let mut places = Labels::default();
    let mut labels = Labels::default();
    let table = data.read(&format, &mut places, progress)?;
    check_label(&table, request.holdout.as_deref())?;
    let data = rows(table, request.holdout.as_deref(), &places, &mut labels, true);
    check_places(&data)?;
    let closed_loop = data
        .observations
        .iter()
        .any(|o| matches!(o.target, Target::Sphere { .. }));
    if closed_loop && !certified {
        return Err(no_plate());
    }
    let mut validation = Rows::default();
    if let Some(source) = validate {
        format.label = None;
        let table = source.read(&format, &mut places, progress)?;
        validation = rows(table, None, &places, &mut labels, false);
    }
    let mut experiment = Experiment {
        robot: model.robot.clone(),
        tool: model.tool_in_table(),
        spheres,
        observations: data.observations,
    };
    understand_torques(
        &mut experiment,
        &mut validation.observations,
        request.payload_kg,
        &mut notes,
    );
    if !closed_loop {
        check_unit(&experiment, &data.file)?;
    }
    let recordings = Recordings {
        file: data.file,
        samples: data.samples,
        validation,
        places,
        labels,
        holdout: request.holdout.clone(),
        ..Recordings::new(experiment)
    };
    Ok(Loaded {
        model,
        recordings,
        notes,
    })
}

/// Contacts without a plate: nothing gives them a scale.
fn no_plate() -> StudyError {
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
fn check_label(table: &Table, label: Option<&str>) -> Result<(), StudyError> {
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

/// The rows do not touch more spheres, in more places, than can be identified together.
fn check_places(data: &Rows) -> Result<(), StudyError> {
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
fn check_unit(experiment: &Experiment, file: &str) -> Result<(), StudyError> {
    let flange = Flange::new(&experiment.robot);
    let tool = experiment.tool.tcp();
    let observations = &experiment.observations;
    let step = observations.len().div_ceil(1000).max(1);
    let (mut moved, mut measured) = (Vec::new(), Vec::new());
    for o in observations.iter().step_by(step) {
        if let Target::Point(p) = o.target {
            moved.push(flange.at(&o.q).point(&tool));
            measured.push(Vector3::from(p));
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

/// The tool and payload of the request into the model.
fn set_tool(model: &mut RobotModel, request: &Request) -> Result<(), StudyError> {
    if let Some(mm) = request.tool_mm {
        model.tool.tcp_m = mm.map(|x| x / 1e3);
    }
    let refuse = |field: &str, value: String, remedy: &str| {
        StudyError::Input(InputError::Field {
            file: "command line".to_owned(),
            field: field.to_owned(),
            value,
            remedy: remedy.to_owned(),
        })
    };
    match (request.payload_kg, request.payload_com_mm) {
        (Some(kg), com) => {
            if !(0.0..=1000.0).contains(&kg) {
                return Err(refuse(
                    "--payload-kg",
                    kg.to_string(),
                    "give a mass in kg from 0 to 1000",
                ));
            }
            model.tool.body = Inertia {
                mass_kg: kg,
                com_m: com.unwrap_or_default().map(|x| x / 1e3),
                inertia_kg_m2: [0.0; 6],
            };
        }
        (None, Some(com)) => {
            return Err(refuse(
                "--payload-com-mm",
                format!("{com:?}"),
                "give --payload-kg with it",
            ));
        }
        // The user's own tool: the mass of the description's is another one's.
        (None, None) if request.tool_mm.is_some() => model.tool.body = Inertia::default(),
        (None, None) => {}
    }
    let _: &Tool = &model.tool;
    model
        .tool
        .check()
        .map_err(|source| StudyError::from(spherecal_model::DataError::from(source)))
}

/// A robot without masses whose geometry is a built-in one's takes the masses
/// from there, so that its joints' compliance can be identified.
fn borrow_masses(model: &mut RobotModel, notes: &mut Vec<String>) {
    if model.robot.joints.iter().any(|j| j.link.mass_kg > 0.0) {
        return;
    }
    for name in spherecal_shared::robot::BUILT_IN {
        let Some(known) = spherecal_shared::robot::built_in(name) else {
            continue;
        };
        let rows: Vec<_> = known.joints.iter().map(|j| j.mdh).collect();
        if !robots::near(&model.rows(), &rows) {
            continue;
        }
        for (own, source) in model.robot.joints.iter_mut().zip(&known.joints) {
            own.link = source.link;
        }
        notes.push(format!(
            "the file gives no masses; they are taken from the built-in {name}, whose geometry is the same"
        ));
        return;
    }
}

/// The rows of a table as observations; rows of a validation file judge only.
fn rows(table: Table, label: Option<&str>, places: &Labels, labels: &mut Labels, keep_set: bool) -> Rows {
    let label = label.map(str::to_lowercase);
    let set = |row: &Row<'_>| {
        if keep_set {
            row.set.unwrap_or_default()
        } else {
            Set::Validate
        }
    };
    let mut number = |row: &Row<'_>| match label.as_deref() {
        Some("sphere") => labels.number(&row.sphere.map(|s| s.to_string()).unwrap_or_default()),
        Some("place") => labels.number(places.name(row.place)),
        Some("set") => labels.number(match set(row) {
            Set::Calibrate => "calibrate",
            Set::Validate => "validate",
        }),
        Some(_) => labels.number(row.label.map_or("", |label| table.labels.name(label))),
        None => 0,
    };
    let samples = table.rows().map(|row| Sample {
        line: row.line,
        place: row.place,
        label: number(&row),
    });
    let samples = samples.collect();
    let observations = table.rows().map(|row| Observation {
        q: row.q.to_vec(),
        tau: row.tau.map(<[f64]>::to_vec),
        target: row.target(),
        set: set(&row),
    });
    Rows {
        observations: observations.collect(),
        samples,
        file: table.file,
    }
}
