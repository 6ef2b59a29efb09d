//! `identify`: arrays to a study, and what the study found.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::OnceLock;

use numpy::{PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;
use spherecal_identify::study::{PAPER_PLATE, Sources, Study, StudyRequest, TableSource, study_of};
use spherecal_identify::{Method, Model, Options, paper_plate};
use spherecal_model::input::{InputError, Plate, read_plate, read_plate_file};
use spherecal_model::read_toml;
use spherecal_report::{Certificate, render, study_report};
use spherecal_results::{CalibratedTexts, calibrated, study_certificate, summary_json, summary_text, write_files};

use crate::arrays::{Rows, matrix, of_matrix};
use crate::compensate::StudyCompensator;
use crate::error::{Failure, guarded};
use crate::robot::NativeRobot;
use crate::slides::{SlidesOfPath, robot_of};

/// A calibration with everything that is known about it.
#[pyclass(frozen, module = "spherecal._native")]
pub(crate) struct NativeIdentification {
    study: Study,
    texts: CalibratedTexts,
    /// The calibrated robot: geometry alone, with its tool.
    robot: NativeRobot,
    /// Made when somebody asks: it takes part of a second.
    certificate: OnceLock<Certificate>,
}

impl NativeIdentification {
    fn certificate(&self) -> &Certificate {
        self.certificate.get_or_init(|| study_certificate(&self.study, &|_| {}))
    }
}

/// Rows of a table of poses.
#[derive(FromPyObject)]
pub(crate) struct TableArrays<'py> {
    #[pyo3(item)]
    q: PyReadonlyArray2<'py, f64>,
    #[pyo3(item)]
    tau: Option<PyReadonlyArray2<'py, f64>>,
    /// Measured points, in m: three numbers for each target of the tool; not a number where one was hidden.
    #[pyo3(item)]
    points: Option<PyReadonlyArray2<'py, f64>>,
    /// Measured orientations: a rotation matrix row by row; not a number where there was none.
    #[pyo3(item)]
    orientations: Option<PyReadonlyArray2<'py, f64>>,
    #[pyo3(item)]
    sphere: Option<Vec<i64>>,
    #[pyo3(item)]
    place: Option<Vec<String>>,
    #[pyo3(item)]
    set: Option<Vec<String>>,
}

/// A table as CSV: one reader gives arrays the checks that a file meets. Numbers are written with
/// as many digits as they need to read back to the same bits.
fn csv(table: &TableArrays<'_>, joints: usize) -> PyResult<String> {
    let q = Rows::joints_or_nan(&table.q, joints)?;
    let tau = table.tau.as_ref().map(|a| Rows::of("tau", a)).transpose()?;
    let points = table.points.as_ref().map(|a| Rows::of("points", a)).transpose()?;
    let mut names: Vec<String> = (1..=joints).map(|k| format!("q{k}")).collect();
    if tau.is_some() {
        names.extend((1..=joints).map(|k| format!("tau{k}")));
    }
    let orientations = table.orientations.as_ref();
    let orientations = orientations.map(|a| Rows::of("orientations", a)).transpose()?;
    match points.as_ref().map_or(0, |rows| rows.width / 3) {
        0 => {}
        1 => names.extend(["x_m", "y_m", "z_m"].map(String::from)),
        targets => names.extend((1..=targets).flat_map(|k| ["x", "y", "z"].map(|axis| format!("{axis}{k}_m")))),
    }
    if orientations.is_some() {
        names.extend((1..=3).flat_map(|row| (1..=3).map(move |column| format!("r{row}{column}"))));
    }
    let several = points.as_ref().is_some_and(|rows| rows.width > 3);
    for (name, given) in [
        ("sphere", table.sphere.is_some()),
        ("place", table.place.is_some()),
        ("set", table.set.is_some()),
    ] {
        if given {
            names.push(name.to_owned());
        }
    }
    let mut out = names.join(",") + "\n";
    for (k, row) in q.rows().enumerate() {
        let of = |rows: &Option<Rows>| {
            rows.as_ref()
                .and_then(|rows| rows.rows().nth(k))
                .unwrap_or_default()
                .to_vec()
        };
        for (i, value) in row.iter().chain(&of(&tau)).enumerate() {
            let _ = write!(out, "{}{value}", if i > 0 { "," } else { "" });
        }
        write_seen(&mut out, &of(&points), 3, several);
        write_seen(&mut out, &of(&orientations), 9, true);
        if let Some(sphere) = table.sphere.as_ref().and_then(|s| s.get(k)) {
            let _ = write!(out, ",{sphere}");
        }
        for label in [&table.place, &table.set]
            .into_iter()
            .flatten()
            .filter_map(|l| l.get(k))
        {
            let _ = write!(out, ",\"{}\"", label.replace('"', "\"\""));
        }
        out.push('\n');
    }
    Ok(out)
}

/// Writes cells in groups of `width`; where a group `may_be_hidden` and none of it is a number, its cells are empty.
fn write_seen(out: &mut String, values: &[f64], width: usize, may_be_hidden: bool) {
    for group in values.chunks(width) {
        let hidden = may_be_hidden && group.iter().all(|value| value.is_nan());
        for value in group {
            if hidden {
                out.push(',');
            } else {
                let _ = write!(out, ",{value}");
            }
        }
    }
}

impl Rows {
    /// Rows of joint angles, whose numbers the table's reader checks.
    fn joints_or_nan(array: &PyReadonlyArray2<'_, f64>, joints: usize) -> PyResult<Self> {
        let rows = Self::of("q", array)?;
        if rows.width == joints {
            return Ok(rows);
        }
        let remedy = format!("the robot has {joints} joints: give shape (N, {joints}), in rad");
        Err(Failure::input("q", format!("an array with {} columns", rows.width), &remedy).into())
    }
}

/// A plate: `paper`, a file, or TOML text.
fn plate(file: Option<String>, text: Option<String>) -> Result<Option<Plate>, Failure> {
    Ok(match (file, text) {
        (Some(name), _) if name == PAPER_PLATE => Some(Plate {
            spheres: paper_plate(),
            ..Plate::default()
        }),
        (Some(path), _) => Some(read_plate_file(Path::new(&path))?),
        (None, Some(text)) => Some(read_plate("plate", &text)?),
        (None, None) => None,
    })
}

fn named<T: std::str::FromStr<Err: ToString>>(field: &str, name: &str) -> Result<T, Failure> {
    name.parse()
        .map_err(|e: T::Err| Failure::input(field, format!("\"{name}\""), &e.to_string()))
}

/// Identifies a robot from tables in memory: the path of the command `identify`.
#[pyfunction]
#[pyo3(signature = (robot, data, *, validate, plate_file, plate_text, tool_m, payload_kg, payload_com_m, holdout,
    accuracy_mm, options_toml, method, model, seed))]
pub(crate) fn identify(
    py: Python<'_>,
    robot: &NativeRobot,
    data: TableArrays<'_>,
    validate: Option<TableArrays<'_>>,
    plate_file: Option<String>,
    plate_text: Option<String>,
    tool_m: Option<[f64; 3]>,
    payload_kg: Option<f64>,
    payload_com_m: Option<[f64; 3]>,
    holdout: Option<String>,
    accuracy_mm: Option<f64>,
    options_toml: Option<String>,
    method: Option<String>,
    model: Option<String>,
    seed: Option<u64>,
) -> PyResult<NativeIdentification> {
    let joints = robot.dof();
    let mut data = csv(&data, joints)?;
    let mut validate = validate.map(|table| csv(&table, joints)).transpose()?;
    let mut nominal = robot.model.clone();
    let path = robot.path.clone();
    guarded(py, move || {
        // As with the command: an option that is given stands over the text of the options.
        let mut options = match options_toml {
            None => Options::default(),
            Some(text) => read_toml(&text).map_err(|source| InputError::Toml {
                file: "options".to_owned(),
                source,
                expected: "options of the identification: noise, priors and fixed parameters, harmonics",
            })?,
        };
        if let Some(name) = method {
            options.method = named::<Method>("method", &name)?;
        }
        if let Some(name) = model {
            options.model = named::<Model>("model", &name)?;
        }
        if let Some(seed) = seed {
            options.seed = seed;
        }
        if let Some(tcp) = tool_m {
            nominal.tool.tcp_m = tcp;
            // As the command: the mass of the description's tool is not that of the user's.
            if payload_kg.is_none() {
                nominal.tool.body.mass_kg = 0.0;
            }
        }
        let request = StudyRequest {
            payload_kg,
            payload_com_mm: payload_com_m.map(|com| com.map(|x| x * 1e3)),
            holdout,
            accuracy_mm,
            options,
            ..StudyRequest::default()
        };
        let mut slides = SlidesOfPath::default();
        let mut notes = Vec::new();
        if let Some(path) = &path {
            let label = request.holdout.as_deref();
            notes = slides.take(path, &nominal, "data", &mut data, label)?;
            if let Some(validate) = &mut validate {
                notes.extend(slides.take(path, &nominal, "validate", validate, None)?);
            }
        }
        let sources = Sources {
            model: nominal,
            plate: plate(plate_file, plate_text)?,
            data: TableSource::Text {
                name: "data",
                csv: &data,
            },
            validate: validate
                .as_deref()
                .map(|csv| TableSource::Text { name: "validate", csv }),
            notes,
        };
        let mut study = study_of(&request, sources, &mut |_| {})?;
        slides.tell(&mut study);
        let texts = calibrated(&study);
        let robot = robot_of(&texts, path.is_some())?;
        Ok(NativeIdentification {
            study,
            texts,
            robot,
            certificate: OnceLock::new(),
        })
    })
}

#[pymethods]
impl NativeIdentification {
    /// The document that the command writes as `summary.json`.
    fn summary_json(&self) -> String {
        summary_json(&self.study, self.certificate()).to_string()
    }

    /// The result in words, as the command prints it.
    fn summary_text(&self) -> String {
        summary_text(&self.study)
    }

    /// Names of the free parameters, in the order of the covariance.
    fn free_names(&self) -> Vec<String> {
        let names = self.study.evaluation.calibration.free_names();
        names.into_iter().map(String::from).collect()
    }

    /// Covariance of the free parameters, SI units.
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        of_matrix(py, &self.study.evaluation.calibration.covariance)
    }

    /// Row of the data, error of the TCP (x, y, z, in mm), deviation and weight of each row that
    /// the fit used.
    fn residuals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let evaluation = &self.study.evaluation;
        let mut values = Vec::new();
        for row in &evaluation.calibration.residual.rows {
            let index = evaluation.used.get(row.index).copied().unwrap_or(row.index);
            #[allow(clippy::cast_precision_loss)] // Rows are counted in millions.
            values.push(index as f64);
            values.extend(row.error_mm);
            values.extend([row.deviation, row.weight]);
        }
        matrix(py, 6, values)
    }

    /// Name of each of these rows, as messages and files have it.
    fn residual_names(&self) -> Vec<String> {
        let evaluation = &self.study.evaluation;
        let rows = evaluation.calibration.residual.rows.iter();
        rows.map(|row| {
            let index = evaluation.used.get(row.index).copied().unwrap_or(row.index);
            self.study.recordings.describe(index)
        })
        .collect()
    }

    /// TCP of the full model in the root frame of the robot's file, in m.
    fn predict<'py>(&self, py: Python<'py>, q: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        self.robot.hinges_alone()?;
        let rows = Rows::joints(&q, self.study.model.robot.dof())?;
        let points = guarded(py, || {
            let calibration = &self.study.evaluation.calibration;
            let at = |q: &[f64]| -> [f64; 3] { self.study.model.base.point(&calibration.tcp_m(q, None)).into() };
            Ok(rows.rows().flat_map(at).collect())
        })?;
        matrix(py, 3, points)
    }

    /// Predicted standard deviation of the TCP, in m.
    fn predicted_sigma(&self, py: Python<'_>, q: PyReadonlyArray2<'_, f64>) -> PyResult<Vec<f64>> {
        self.robot.hinges_alone()?;
        let rows = Rows::joints(&q, self.study.model.robot.dof())?;
        guarded(py, || {
            let sigma = |q: &[f64]| self.study.evaluation.predicted_sigma_mm(q) / 1e3;
            Ok(rows.rows().map(sigma).collect())
        })
    }

    /// Joint commands in place of nominal ones.
    fn compensate<'py>(&self, py: Python<'py>, q: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        self.robot.hinges_alone()?;
        let joints = self.study.model.robot.dof();
        let rows = Rows::joints(&q, joints)?;
        let commands = guarded(py, || {
            let compensator = StudyCompensator::new(&self.study)?;
            let mut commands = Vec::with_capacity(rows.values.len());
            for (k, q) in rows.rows().enumerate() {
                commands.extend(compensator.command(k, q)?);
            }
            Ok(commands)
        })?;
        matrix(py, joints, commands)
    }

    /// The calibrated robot: geometry alone, with its tool.
    fn robot(&self) -> NativeRobot {
        self.robot.clone()
    }

    fn toml(&self) -> &str {
        &self.texts.toml
    }

    fn urdf(&self) -> &str {
        &self.texts.urdf
    }

    fn kinematics_yaml(&self) -> &str {
        &self.texts.kinematics_yaml
    }

    fn offsets_yaml(&self) -> &str {
        &self.texts.offsets_yaml
    }

    /// Writes the files that the command writes; their paths. `created` is the time for the report, in words.
    fn write(&self, py: Python<'_>, folder: String, created: String) -> PyResult<Vec<String>> {
        guarded(py, || {
            let certificate = self.certificate();
            let page = render(&study_report(&self.study, &created)).map_err(Failure::failed)?;
            let files =
                write_files(&self.study, Path::new(&folder), certificate, Some(&page)).map_err(Failure::failed)?;
            Ok(files.paths.iter().map(|p| p.display().to_string()).collect())
        })
    }
}
