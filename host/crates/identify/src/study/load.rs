//! From a request to plain data: robot, tool, plate and samples, checked
//! against each other.

use std::collections::HashSet;
use std::path::PathBuf;

use nalgebra::Vector3;
use spherecal_shared::robot::{Inertia, Tool};

use super::StudyError;
use super::align::{Flange, reference_of};
use super::judge::Judge;
use crate::{Experiment, Observation, Options, Reference, Set, Target, paper_plate};
use spherecal_model::input::{InputError, Labels, Progress, Row, Table, TableFormat, read_csv_file, read_plate_file};
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
    /// The plate's certificate; Table 1 of the paper without it.
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
    /// How to identify.
    pub options: Options,
}

/// Where one row of the user's tables came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// Line of the file, from 1.
    pub line: u64,
    /// Placement of the plate: also for points given in the plate's frame.
    pub place: u32,
    /// Value of the hold-out column: its number in [`Loaded::labels`].
    pub label: u32,
}

/// The rows of a table of validation points.
#[derive(Clone, Debug, Default)]
pub struct Rows {
    /// File, for messages.
    pub file: String,
    /// Joint angles and targets.
    pub observations: Vec<Observation>,
    /// Where each came from.
    pub samples: Vec<Sample>,
}

/// Everything that a study is made from.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The robot with its files' frames.
    pub model: RobotModel,
    /// Nominal robot, tool (in the last frame of the table) and plate, with
    /// every row of the data file.
    pub experiment: Experiment,
    /// The data file.
    pub file: String,
    /// Where each observation came from, in the same order.
    pub samples: Vec<Sample>,
    /// Rows that judge the result: the validation file's.
    pub validation: Rows,
    /// Names of the placements.
    pub places: Labels,
    /// Values of the hold-out column.
    pub labels: Labels,
    /// Whether the data are closed-loop.
    pub closed_loop: bool,
    /// Whether the user gave the plate.
    pub plate_given: bool,
    /// What the user should know about how the data were taken.
    pub notes: Vec<String>,
}

impl Loaded {
    /// Name of row `i` of the data file for people: its line, and place and sphere
    /// where it has them.
    pub fn describe(&self, i: usize) -> String {
        let (Some(observation), Some(sample)) = (self.experiment.observations.get(i), self.samples.get(i)) else {
            return String::new();
        };
        let row = format!("{} line {}", self.file, sample.line);
        let Target::Sphere { sphere, place } = observation.target else {
            return row;
        };
        match self.places.name(place) {
            "" => format!("{row} (sphere {sphere})"),
            place => format!("{row} (sphere {sphere}, place {place})"),
        }
    }
}

impl Loaded {
    /// Row `i` of the data file as a judge that the result calls `index`.
    pub(super) fn judge(&self, index: usize, i: usize) -> Judge<'_> {
        Judge {
            index,
            observation: &self.experiment.observations[i],
            place: self.samples[i].place,
        }
    }

    /// The rows that no fit sees: those of the data file that are set aside, then
    /// the validation file's.
    pub(super) fn set_aside(&self) -> impl Iterator<Item = Judge<'_>> {
        let data = self
            .experiment
            .observations
            .iter()
            .zip(&self.samples)
            .filter(|(o, _)| o.set == Set::Validate);
        let file = self.validation.observations.iter().zip(&self.validation.samples);
        data.chain(file)
            .enumerate()
            .map(|(index, (observation, sample))| Judge {
                index,
                observation,
                place: sample.place,
            })
    }

    /// The rows that judge a result: all of the data file's in a cross-validation,
    /// else those that no fit sees.
    pub(super) fn judges(&self, cross_validated: bool) -> Box<dyn Iterator<Item = Judge<'_>> + '_> {
        if cross_validated {
            Box::new((0..self.samples.len()).map(|i| self.judge(i, i)))
        } else {
            Box::new(self.set_aside())
        }
    }
}

/// Loads what a request names; `progress` is called while tables are read.
///
/// # Errors
/// Files that cannot be read or used, with field, value and remedy.
pub fn load(request: &Request, progress: &mut dyn FnMut(Progress)) -> Result<Loaded, StudyError> {
    let mut model = robots::load(&request.robot)?;
    let mut notes = Vec::new();
    set_tool(&mut model, request)?;
    borrow_masses(&mut model, &mut notes);
    let mut spheres = Vec::new();
    if let Some(path) = &request.plate {
        let plate = read_plate_file(path)?;
        notes.extend(plate.notes);
        spheres = plate.spheres;
    }
    let mut format = TableFormat {
        joints: model.robot.dof(),
        joint_names: model.joint_names.clone(),
        joint_columns: request.joint_columns.clone(),
        ignore: request.ignore_columns.clone(),
        label: request.holdout.clone(),
    };
    let mut places = Labels::default();
    let mut labels = Labels::default();
    let table = read_csv_file(&request.data, &format, &mut places, progress)?;
    check_label(&table, request.holdout.as_deref())?;
    let data = rows(table, request.holdout.as_deref(), &places, &mut labels, true);
    check_places(&data)?;
    let closed_loop = data
        .observations
        .iter()
        .any(|o| matches!(o.target, Target::Sphere { .. }));
    let mut validation = Rows::default();
    if let Some(path) = &request.validate {
        format.label = None;
        let table = read_csv_file(path, &format, &mut places, progress)?;
        validation = rows(table, None, &places, &mut labels, false);
    }
    if request.plate.is_none() && closed_loop {
        spheres = paper_plate();
    }
    let experiment = Experiment {
        robot: model.robot.clone(),
        tool: model.tool_in_table(),
        spheres,
        observations: data.observations,
    };
    if !closed_loop {
        check_unit(&experiment, &data.file)?;
    }
    Ok(Loaded {
        model,
        experiment,
        file: data.file,
        samples: data.samples,
        validation,
        places,
        labels,
        closed_loop,
        plate_given: request.plate.is_some(),
        notes,
    })
}

/// The hold-out names a column that the table has.
fn check_label(table: &Table, label: Option<&str>) -> Result<(), StudyError> {
    let known = ["sphere", "place", "set"];
    match label {
        Some(name) if !known.contains(&name.to_lowercase().as_str()) && table.labels.is_empty() => {
            Err(InputError::Columns {
                file: table.file.clone(),
                what: format!(
                    "--holdout names column \"{}\", which is not in the table",
                    spherecal_model::excerpt(name)
                ),
                remedy: "name a column of the table, such as place, sphere or set".to_owned(),
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

/// The frame that a row's target is given in: points of closed-loop data live in
/// the plate's frame.
pub(super) fn frame_of(target: &Target, place: u32, closed_loop: bool) -> Reference {
    match (reference_of(target), closed_loop) {
        (Reference::Tracker, true) => Reference::Place(place),
        (reference, _) => reference,
    }
}
