//! From a request to plain data: robot, tool, plate and samples, checked
//! against each other.

use std::path::PathBuf;

use spherecal_shared::robot::{Inertia, Tool};

use super::StudyError;
use crate::{Experiment, Observation, Options, Set, Sphere, Target, paper_plate};
use spherecal_model::input::{InputError, Labels, Row, Table, read_csv_file, read_plate_file};
use spherecal_model::robots::{self, RobotModel};

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
    /// How to identify.
    pub options: Options,
}

/// One row of the user's tables, ready to use.
#[derive(Clone, Debug)]
pub struct Sample {
    /// File and line, for messages.
    pub source: String,
    /// Joint angles, targets and set as identification takes them.
    pub observation: Observation,
    /// Placement of the plate: also for points given in the plate's frame.
    pub place: u32,
    /// Value of the hold-out column.
    pub label: String,
}

/// Everything that a study is made from.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The robot with its files' frames.
    pub model: RobotModel,
    /// Nominal robot, tool (in the last frame of the table) and plate, with
    /// every sample of the data file.
    pub experiment: Experiment,
    /// The same samples with their origin, in the same order.
    pub samples: Vec<Sample>,
    /// Samples that judge the result: the validation file's.
    pub validation: Vec<Sample>,
    /// Names of the placements.
    pub places: Labels,
    /// Whether the data are closed-loop.
    pub closed_loop: bool,
    /// Whether the user gave the plate.
    pub plate_given: bool,
    /// What the user should know about how the data were taken.
    pub notes: Vec<String>,
}

/// Loads what a request names.
///
/// # Errors
/// Files that cannot be read or used, with field, value and remedy.
pub fn load(request: &Request) -> Result<Loaded, StudyError> {
    let mut model = robots::load(&request.robot)?;
    let mut notes = Vec::new();
    set_tool(&mut model, request)?;
    borrow_masses(&mut model, &mut notes);
    let joints = model.robot.dof();
    let label = request.holdout.as_deref();
    let mut places = Labels::default();
    let table = read_csv_file(&request.data, joints, label, &mut places)?;
    let known = ["sphere", "place", "set"];
    if let Some(name) = label
        && !known.contains(&name.to_lowercase().as_str())
        && table.rows.iter().all(|r| r.label.is_none())
    {
        return Err(InputError::Columns {
            file: table.file.clone(),
            what: format!("--holdout names column \"{name}\", which is not in the table"),
            remedy: "name a column of the table, such as place, sphere or set".to_owned(),
        }
        .into());
    }
    let samples = samples(&table, label, &places, true);
    let closed_loop = samples
        .iter()
        .any(|s| matches!(s.observation.target, Target::Sphere { .. }));
    let mut validation = Vec::new();
    if let Some(path) = &request.validate {
        let table = read_csv_file(path, joints, None, &mut places)?;
        validation = self::samples(&table, None, &places, false);
    }
    let plate_given = request.plate.is_some();
    let spheres: Vec<Sphere> = match &request.plate {
        Some(path) => read_plate_file(path)?,
        None if closed_loop => paper_plate(),
        None => Vec::new(),
    };
    let experiment = Experiment {
        robot: model.robot.clone(),
        tool: model.tool_in_table(),
        spheres,
        observations: samples.iter().map(|s| s.observation.clone()).collect(),
    };
    Ok(Loaded {
        model,
        experiment,
        samples,
        validation,
        places,
        closed_loop,
        plate_given,
        notes,
    })
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
        if !same_arm(model, &known) {
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

/// Whether the joint axes lie alike: the link frames agree within 5 mm and
/// 10 mrad at a few poses.
fn same_arm(model: &RobotModel, known: &spherecal_shared::robot::Robot) -> bool {
    let rows: Vec<_> = known.joints.iter().map(|j| j.mdh).collect();
    if rows.len() != model.robot.dof() {
        return false;
    }
    [0.0, 0.7, -1.1].iter().all(|&s| {
        let q: Vec<f64> = (0..rows.len()).map(|k| s * (1.0 - 0.2 * k as f64)).collect();
        let own = robots::table_frames(&model.rows(), &q);
        let other = robots::table_frames(&rows, &q);
        let last = rows.len() - 1;
        own.iter().zip(&other).enumerate().all(|(k, (a, b))| {
            // The last frame may sit anywhere along its axis: that is the flange's business.
            let off = a.origin - b.origin;
            let off = if k == last { off - a.z() * off.dot(&a.z()) } else { off };
            off.norm() < 5e-3 && (a.rotation - b.rotation).amax() < 1e-2
        })
    })
}

/// The rows of a table as samples.
fn samples(table: &Table, label: Option<&str>, places: &Labels, keep_set: bool) -> Vec<Sample> {
    let label = label.map(str::to_lowercase);
    table
        .rows
        .iter()
        .map(|row| Sample {
            source: format!("{} line {}", table.file, row.line),
            observation: Observation {
                q: row.q.clone(),
                tau: row.tau.clone(),
                target: target(row),
                set: if keep_set {
                    row.set.unwrap_or_default()
                } else {
                    Set::Validate
                },
            },
            place: row.place,
            label: match label.as_deref() {
                Some("sphere") => row.sphere.map(|s| s.to_string()).unwrap_or_default(),
                Some("place") => places.name(row.place).to_owned(),
                Some("set") => format!("{:?}", row.set.unwrap_or_default()).to_lowercase(),
                Some(_) => row.label.clone().unwrap_or_default(),
                None => String::new(),
            },
        })
        .collect()
}

/// A measured point where the row has one, else the sphere.
fn target(row: &Row) -> Target {
    match (row.point, row.sphere) {
        (Some(point), _) => Target::Point(point),
        (None, sphere) => Target::Sphere {
            sphere: sphere.unwrap_or_default(),
            place: row.place,
        },
    }
}
