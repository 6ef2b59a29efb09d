//! Errors of the host's crates as the exceptions of `spherecal.errors`.

use std::panic::{AssertUnwindSafe, catch_unwind};

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use spherecal_identify::study::StudyError;
use spherecal_model::input::InputError;
use spherecal_model::robots::RobotFileError;

/// An exception of `spherecal.errors`, by its class.
#[derive(Debug)]
pub(crate) struct Failure {
    class: &'static str,
    message: String,
    field: Option<String>,
    value: Option<String>,
    remedy: Option<String>,
}

impl Failure {
    pub(crate) fn new(class: &'static str, message: impl ToString) -> Self {
        Self {
            class,
            message: message.to_string(),
            field: None,
            value: None,
            remedy: None,
        }
    }

    /// An argument that cannot be used.
    pub(crate) fn input(field: &str, value: impl ToString, remedy: &str) -> Self {
        let value = value.to_string();
        Self {
            class: "InputError",
            message: format!("{field} is {value}: {remedy}"),
            field: Some(field.to_owned()),
            value: Some(value),
            remedy: Some(remedy.to_owned()),
        }
    }

    /// Work that failed without a fault of the input.
    pub(crate) fn failed(error: impl ToString) -> Self {
        Self::new("JobFailed", error)
    }

    /// A pose that the arm cannot take.
    pub(crate) fn unreachable(message: impl ToString) -> Self {
        Self::new("Unreachable", message)
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        Python::attach(|py| {
            let made = py
                .import("spherecal.errors")
                .and_then(|module| module.getattr(failure.class))
                .and_then(|class| class.call1((&failure.message, failure.field, failure.value, failure.remedy)));
            match made {
                Ok(exception) => PyErr::from_value(exception),
                Err(_) => PyRuntimeError::new_err(failure.message),
            }
        })
    }
}

/// What the messages about a table's columns say to a caller of arrays.
const REMEDIES: [(&str, &str); 5] = [
    (
        "name the columns q1_deg",
        "joint angles are in rad: give numpy.radians(q) if these are degrees",
    ),
    ("name the columns q1..", "joint angles are in rad"),
    ("name the columns x_m", POINTS),
    ("check the unit in the column's name (x_mm", POINTS),
    (
        "name the column with _deg",
        "joint angles are in rad: give numpy.radians(q) if these are degrees",
    ),
];
const POINTS: &str = "points are in m: divide millimetres by 1000";

fn for_arrays(remedy: String) -> String {
    REMEDIES
        .iter()
        .find(|(words, _)| remedy.contains(words))
        .map_or(remedy, |(_, own)| (*own).to_owned())
}

impl From<InputError> for Failure {
    fn from(error: InputError) -> Self {
        match error {
            InputError::Field {
                file,
                field,
                value,
                remedy,
            } => {
                // The options of the command line are the arguments of `identify`.
                let field = match field.strip_prefix("--") {
                    Some(option) if file == "command line" => option.replace('-', "_"),
                    _ => field,
                };
                Self::input(&field, value, &for_arrays(remedy))
            }
            InputError::Cell {
                file,
                row,
                column,
                value,
                remedy,
                ..
            } => {
                let remedy = for_arrays(remedy);
                Self {
                    message: format!("{file}: row {row}, column {column} is {value}: {remedy}"),
                    ..Self::input(&column, value, &remedy)
                }
            }
            error => Self::new("InputError", error),
        }
    }
}

impl From<RobotFileError> for Failure {
    fn from(error: RobotFileError) -> Self {
        let mut failure = Self::new("InputError", &error);
        match error {
            RobotFileError::Unknown { spec, .. } => {
                failure.field = Some("robot".to_owned());
                failure.value = Some(spec);
            }
            RobotFileError::Value {
                field, value, remedy, ..
            } => {
                (failure.field, failure.value, failure.remedy) = (Some(field), Some(value), Some(remedy));
            }
            _ => {}
        }
        failure
    }
}

impl From<StudyError> for Failure {
    fn from(error: StudyError) -> Self {
        match error {
            StudyError::Input(error) => error.into(),
            StudyError::Robot(error) => error.into(),
            error if error.is_input() => Self::new("InputError", error),
            error => Self::new("JobFailed", error),
        }
    }
}

/// Runs work without the interpreter lock; a panic becomes `InternalError`.
/// Errors: what the work refuses.
pub(crate) fn guarded<T: Send>(py: Python<'_>, work: impl FnOnce() -> Result<T, Failure> + Send) -> PyResult<T> {
    py.detach(|| match catch_unwind(AssertUnwindSafe(work)) {
        Ok(done) => done,
        Err(panic) => {
            let words = panic
                .downcast_ref::<String>()
                .map(String::as_str)
                .or_else(|| panic.downcast_ref::<&str>().copied())
                .unwrap_or("no message");
            Err(Failure::new(
                "InternalError",
                format!("a defect of spherecal, please report it with your input: {words}"),
            ))
        }
    })
    .map_err(PyErr::from)
}
