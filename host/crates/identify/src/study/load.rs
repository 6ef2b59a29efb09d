//! From a request to plain data: robot, tool, plate and samples, checked
//! against each other.

use std::path::PathBuf;
use std::time::Instant;

use spherecal_shared::robot::{Inertia, Tool};

use super::StudyError;
use super::checks::{check_judges, check_label, check_places, check_unit, no_plate};
use super::sources::{Sources, TableSource, plate};
use super::torques::understand_torques;
use crate::recordings::{Recordings, RowNames, RowSource, ValidationRows};
use crate::{Experiment, Observation, Options, Set, Target};
use spherecal_model::WorkBox;
use spherecal_model::input::{InputError, Labels, ReadingProgress, Table, TableFormat, TableRow};
use spherecal_model::robots::{self, RobotModel};

/// What the user asks for.
#[derive(Clone, Debug, Default)]
pub struct StudyRequest {
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
    /// Where the robot is to work; where the rows are without it.
    pub work: Option<WorkBox>,
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
    /// When the reading began.
    pub begun: Instant,
}

/// The files that a request names, for its robot; tables are read later.
///
/// # Errors
/// A plate that cannot be read.
pub fn sources(request: &StudyRequest, model: RobotModel) -> Result<Sources<'_>, StudyError> {
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
pub fn load(request: &StudyRequest, progress: &mut dyn FnMut(ReadingProgress)) -> Result<Loaded, StudyError> {
    assemble(request, sources(request, robots::load(&request.robot)?)?, progress)
}

/// The same from what a caller has in memory: the request's own robot, plate and tables
/// are not read. Both ways meet the same checks.
///
/// # Errors
/// As [`load`].
pub fn assemble(
    request: &StudyRequest,
    sources: Sources<'_>,
    progress: &mut dyn FnMut(ReadingProgress),
) -> Result<Loaded, StudyError> {
    let begun = Instant::now();
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
    let (others, carriers) = model.other_joints()?;
    let mut format = TableFormat {
        joints: model.robot.dof(),
        joint_names: model.joint_names.clone(),
        joint_columns: request.joint_columns.clone(),
        ignore: request.ignore_columns.clone(),
        others,
        carriers,
        label: request.holdout.clone(),
        units: Vec::new(),
    };
    let mut places = Labels::default();
    let mut labels = Labels::default();
    let named_by = match data {
        TableSource::File(_) => RowNames::Line,
        TableSource::Text { .. } => RowNames::Number,
    };
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
    let mut validation = ValidationRows::default();
    if let Some(source) = validate {
        format.label = None;
        let table = source.read(&format, &mut places, progress)?;
        validation = rows(table, None, &places, &mut labels, false);
        check_judges(&data, &validation)?;
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
        named_by,
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
        begun,
    })
}

/// The tool and payload of the request into the model.
fn set_tool(model: &mut RobotModel, request: &StudyRequest) -> Result<(), StudyError> {
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
fn rows(table: Table, label: Option<&str>, places: &Labels, labels: &mut Labels, keep_set: bool) -> ValidationRows {
    let label = label.map(str::to_lowercase);
    let set = |row: &TableRow<'_>| {
        if keep_set {
            row.set.unwrap_or_default()
        } else {
            Set::Validate
        }
    };
    let mut number = |row: &TableRow<'_>| match label.as_deref() {
        Some("sphere") => labels.number(&row.sphere.map(|s| s.to_string()).unwrap_or_default()),
        Some("place") => labels.number(places.name(row.place)),
        Some("set") => labels.number(match set(row) {
            Set::Calibrate => "calibrate",
            Set::Validate => "validate",
        }),
        Some(_) => labels.number(row.label.map_or("", |label| table.labels.name(label))),
        None => 0,
    };
    let samples = table.rows().map(|row| RowSource {
        number: row.line,
        place: row.place,
        label: number(&row),
    });
    let samples = samples.collect();
    let observations = table.rows().map(|row| Observation {
        seat: None,
        q: row.q.to_vec(),
        tau: row.tau.map(<[f64]>::to_vec),
        target: row.target(),
        set: set(&row),
    });
    ValidationRows {
        observations: observations.collect(),
        samples,
        file: table.file,
    }
}
