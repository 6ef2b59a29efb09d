//! Plans, tables of runs, and the command line.

use std::ffi::OsString;
use std::io::Write as _;
use std::path::PathBuf;

use numpy::PyArray1;
use pyo3::prelude::*;
use spherecal::export::{Column, ExportError, ExportTable};
use spherecal::job::{Config, JobError, open_store, run_telemetry};
use spherecal::simulated::prepare;
use spherecal::store::{StoreError, StoreLocation, UnknownScheme};

use crate::error::{Failure, guarded};

impl From<JobError> for Failure {
    fn from(error: JobError) -> Self {
        Self::new(if error.is_input() { "InputError" } else { "JobFailed" }, error)
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        Self::new(if error.is_input() { "InputError" } else { "JobFailed" }, error)
    }
}

impl From<ExportError> for Failure {
    fn from(error: ExportError) -> Self {
        match error {
            ExportError::Store(error) => error.into(),
            ExportError::Telemetry { path, what } => Self::input(
                "telemetry",
                format!("{path}: {what}"),
                "give another file, or telemetry=None to read the database alone",
            ),
            error => Self::failed(error),
        }
    }
}

/// The plan of a configuration, as JSON; the configuration is TOML text.
#[pyfunction]
#[pyo3(signature = (config, *, robot, poses, accuracy_mm, seed))]
pub(crate) fn plan(
    py: Python<'_>,
    config: String,
    robot: Option<String>,
    poses: Option<usize>,
    accuracy_mm: Option<f64>,
    seed: Option<u64>,
) -> PyResult<String> {
    guarded(py, move || {
        let mut config = Config::parse("config", &config).map_err(JobError::from)?;
        if let Some(robot) = robot {
            config.robot = robot;
        }
        if let Some(poses) = poses {
            if poses == 0 {
                return Err(Failure::input("poses", 0, "give at least 1"));
            }
            config.plan.poses = poses;
            config.plan.paper = false;
            config.plan.accuracy_mm = None;
        }
        if accuracy_mm.is_some() {
            config.plan.accuracy_mm = accuracy_mm;
            config.plan.paper = false;
        }
        if let Some(seed) = seed {
            config.seed = seed;
        }
        let prepared = prepare(&config)?;
        serde_json::to_string(&prepared.plan).map_err(Failure::failed)
    })
}

/// A table: its name, and its columns as arrays or lists of text.
type Frame<'py> = (&'static str, Vec<(String, Bound<'py, PyAny>)>);

fn frame(py: Python<'_>, table: ExportTable) -> PyResult<Frame<'_>> {
    let columns = table.columns.into_iter().map(|(name, column)| {
        let values = match column {
            Column::Real(values) => PyArray1::from_vec(py, values).into_any(),
            Column::Whole(values) => PyArray1::from_vec(py, values).into_any(),
            Column::Text(values) => values.into_pyobject(py)?,
        };
        Ok((name, values))
    });
    Ok((table.name, columns.collect::<PyResult<_>>()?))
}

/// The tables of a run, that of the telemetry in pieces, the number of the run, and the telemetry files that end in the
/// middle of a record. The telemetry is the file `telemetry`, or else the run's own files in the folder `beside`.
#[pyfunction]
#[pyo3(signature = (store, run, telemetry, beside))]
pub(crate) fn tables(
    py: Python<'_>,
    store: String,
    run: Option<i64>,
    telemetry: Option<PathBuf>,
    beside: Option<PathBuf>,
) -> PyResult<(Vec<Frame<'_>>, i64, Vec<PathBuf>)> {
    let (tables, run, torn) = guarded(py, move || {
        let location: StoreLocation = store.parse().map_err(|unknown: UnknownScheme| {
            let remedy = "give the path of a database, or postgres://USER@HOST/DATABASE";
            Failure::input("store", format!("{}://...", unknown.scheme), remedy)
        })?;
        let mut store = open_store(&location, false)?;
        let last = store.require_last_run()?.run;
        let run = run.unwrap_or(last);
        let Some(info) = store.runs()?.into_iter().find(|info| info.run == run) else {
            return Err(Failure::input("run", run, &format!("give a number from 1 to {last}")));
        };
        let files = match (telemetry, beside) {
            (Some(file), _) => vec![file],
            (None, Some(beside)) => run_telemetry(&beside, &info),
            (None, None) => Vec::new(),
        };
        let (tables, torn) = spherecal::export::tables(store.as_mut(), &info, &files)?;
        let torn = torn.into_iter().map(|torn| torn.file).collect();
        Ok((tables, run, torn))
    })?;
    let frames = tables.into_iter().map(|table| frame(py, table));
    Ok((frames.collect::<PyResult<_>>()?, run, torn))
}

/// The command `spherecal` with these arguments; its exit code.
#[pyfunction]
pub(crate) fn main(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<u8> {
    guarded(py, move || {
        let exit = spherecal::cli::main_with(arguments);
        // Rust flushes at the end of its own `main`, which this process does not have.
        let _ = std::io::stdout().flush();
        Ok(exit.code())
    })
}
