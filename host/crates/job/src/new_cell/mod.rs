//! A first cell: from what its user states to a checked configuration, as files.
//!
//! ```text
//!   NewCell ─▶ checks (robot, plate, tool, reach) ─▶ cell.toml, plate.toml, poses.csv
//! ```
//!
//! Nothing is written here. The configuration that is checked is read back from the text of
//! `cell.toml`, so the file says what was checked.

mod plate;
mod text;

use std::path::Path;
use std::str::FromStr;

use spherecal_model::robots::{self, Origin, RobotModel};
use spherecal_model::{MAX_SPHERES, Placement};
use spherecal_shared::robot::iiwa7_tool;

use super::{Config, JobError, check_reach};

use plate::CertifiedPlate;
pub use plate::StatedPlate;

/// Largest part of a tool or of a plate, in mm.
pub const LARGEST_MM: f64 = 2000.0;
/// Farthest place of a plate, in mm.
pub const FARTHEST_MM: f64 = 5000.0;
/// Largest serial number, in characters.
const LONGEST_SERIAL: usize = 60;

/// What is wrong with a stated value. The message names the option, the value and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum NewCellError {
    /// A value that cannot be used.
    #[error("{option} is {value}: {remedy}")]
    Value {
        /// Option of the command line.
        option: &'static str,
        /// Its value.
        value: String,
        /// What to give instead.
        remedy: String,
    },
    /// The robot, the plate's file or the whole cell was refused.
    #[error(transparent)]
    Job(#[from] JobError),
    /// The file of the plate was refused.
    #[error(transparent)]
    Plate(#[from] spherecal_model::input::InputError),
}

fn refuse(option: &'static str, value: impl std::fmt::Display, remedy: impl Into<String>) -> NewCellError {
    NewCellError::Value {
        option,
        value: value.to_string(),
        remedy: remedy.into(),
    }
}

/// What measures the poses of `poses.csv`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Instrument {
    /// None but the plate: a pose is on a sphere.
    #[default]
    None,
    /// A laser tracker.
    Tracker,
    /// Another instrument that measures points.
    Points,
}

impl Instrument {
    /// All, with their names.
    pub const ALL: [(&'static str, Self); 3] = [
        ("none", Self::None),
        ("tracker", Self::Tracker),
        ("points", Self::Points),
    ];
}

impl FromStr for Instrument {
    type Err = NewCellError;

    fn from_str(text: &str) -> Result<Self, NewCellError> {
        let found = Self::ALL.into_iter().find(|(name, _)| *name == text);
        found.map(|(_, instrument)| instrument).ok_or_else(|| {
            refuse(
                "--instrument",
                format!("\"{}\"", spherecal_model::excerpt(text)),
                "give none (the plate alone), tracker, or points (another instrument that measures points)",
            )
        })
    }
}

/// What the user states of a cell.
#[derive(Clone, Debug, PartialEq)]
pub struct NewCell {
    /// Robot: a built-in name, or a file.
    pub robot: String,
    /// Serial number of this very arm.
    pub serial: String,
    /// The plate.
    pub plate: StatedPlate,
    /// Number of the plate's certificate; may be empty.
    pub plate_certificate: String,
    /// Expanded uncertainty (k = 2) of each certified coordinate, in mm. `None`: as the plate's file
    /// says, or that of the paper's plate.
    pub plate_u_mm: Option<f64>,
    /// Diameter of the spheres, in mm.
    pub sphere_diameter_mm: f64,
    /// Mass of everything at the flange, in kg.
    pub tool_mass_kg: f64,
    /// Centre of a seated sphere in the flange frame, in mm. `None`: from the robot's file, or that of
    /// the paper's nest.
    pub tool_mm: Option<[f64; 3]>,
    /// Centre of the tool's mass in the flange frame, in mm. `None`: half-way to the TCP.
    pub tool_com_mm: Option<[f64; 3]>,
    /// Sphere 1 in the robot's base frame F0, in mm. `None`: a place within reach.
    pub plate_at_mm: Option<[f64; 3]>,
    /// Turn of the plate about the vertical, in degrees. `None`: 150.
    pub plate_yaw_deg: Option<f64>,
    /// What measures the poses.
    pub instrument: Instrument,
    /// Whether the joint columns of `poses.csv` are in degrees.
    pub degrees: bool,
}

/// The texts of a new cell.
#[derive(Clone, Debug, PartialEq)]
pub struct NewCellFiles {
    /// `cell.toml`, for `run`, `plan` and `measure`.
    pub cell_toml: String,
    /// `plate.toml`, for `identify --plate`.
    pub plate_toml: String,
    /// `poses.csv`, for `identify --data`: the header row.
    pub poses_csv: String,
    /// Options of `identify` for this robot and tool.
    pub identify_options: String,
    /// What was assumed, in sentences.
    pub assumed: Vec<String>,
}

/// A cell with every value decided.
struct Decided<'a> {
    stated: &'a NewCell,
    /// The robot, as the configuration names it.
    robot: String,
    model: RobotModel,
    plate: CertifiedPlate,
    tool_mm: [f64; 3],
    com_mm: [f64; 3],
    placement: Placement,
    assumed: Vec<String>,
}

/// Loads the robot; checks its name.
///
/// # Errors
/// A robot that is neither built in nor a file that can be read.
pub fn check_robot(robot: &str) -> Result<(), NewCellError> {
    robots::load_driven(robot)
        .map(drop)
        .map_err(|e| JobError::from(e).into())
}

/// Checks a serial number.
///
/// # Errors
/// An empty one, a longer one than 60 characters, control characters.
pub fn check_serial(serial: &str) -> Result<(), NewCellError> {
    let length = serial.trim().chars().count();
    if length == 0 || length > LONGEST_SERIAL || serial.chars().any(char::is_control) {
        return Err(refuse(
            "--serial",
            format!("\"{}\"", spherecal_model::excerpt(serial)),
            "give the serial number on the arm's name plate, 1 to 60 characters",
        ));
    }
    Ok(())
}

/// Checks a mass at the flange of a robot.
///
/// # Errors
/// A mass that is not positive, or beyond the robot's payload where that is known.
pub fn check_mass(robot: &str, mass_kg: f64) -> Result<(), NewCellError> {
    let most = robots::payload_kg(robot).unwrap_or(1000.0);
    if mass_kg > 0.0 && mass_kg <= most {
        return Ok(());
    }
    let remedy = match robots::payload_kg(robot) {
        Some(most) => format!(
            "give the mass of everything at the flange in kg, above 0 and at most {robot}'s payload of {most} kg"
        ),
        None => "give the mass of everything at the flange in kg, above 0".to_owned(),
    };
    Err(refuse("--tool-mass-kg", mass_kg, remedy))
}

/// Checks a TCP in the flange frame, in mm, with spheres of a diameter.
///
/// # Errors
/// A point that is too far away, or at which the sphere would be inside of the flange.
pub fn check_tcp(tool_mm: [f64; 3], sphere_diameter_mm: f64) -> Result<(), NewCellError> {
    let [x, y, z] = tool_mm;
    let distance = (x * x + y * y + z * z).sqrt();
    if distance >= sphere_diameter_mm / 2.0 && distance <= LARGEST_MM {
        return Ok(());
    }
    Err(refuse(
        "--tool-mm",
        text::list(tool_mm, 3),
        format!(
            "give the centre of a seated sphere in the flange frame in mm: {} (a sphere's radius) to {LARGEST_MM} from its origin",
            sphere_diameter_mm / 2.0
        ),
    ))
}

impl NewCell {
    /// Checks everything that can be checked without a robot, and writes the texts of the files.
    ///
    /// # Errors
    /// The first value that cannot be used.
    pub fn files(&self) -> Result<NewCellFiles, NewCellError> {
        let mut decided = self.decide()?;
        let cell_toml = self.placed(&mut decided)?;
        Ok(NewCellFiles {
            cell_toml,
            plate_toml: decided.plate_toml(),
            poses_csv: decided.poses_csv(),
            identify_options: decided.identify_options(),
            assumed: decided.assumed,
        })
    }

    fn decide(&self) -> Result<Decided<'_>, NewCellError> {
        let model = robots::load_driven(&self.robot).map_err(JobError::from)?;
        check_serial(&self.serial)?;
        check_mass(&self.robot, self.tool_mass_kg)?;
        let diameter = self.sphere_diameter_mm;
        if !(2.0..=200.0).contains(&diameter) {
            return Err(refuse(
                "--sphere-diameter-mm",
                diameter,
                "give millimetres, from 2 to 200",
            ));
        }
        let mut plate = self.plate.spheres(diameter)?;
        if plate.spheres_mm.len() > MAX_SPHERES {
            return Err(refuse(
                "--plate",
                format!("{} spheres", plate.spheres_mm.len()),
                format!("give at most {MAX_SPHERES}"),
            ));
        }
        let mut assumed = Vec::new();
        if let Some(u) = self.plate_u_mm {
            if !(u > 0.0 && u <= 1.0) {
                return Err(refuse(
                    "--plate-u-mm",
                    u,
                    "give the certificate's expanded uncertainty (k = 2) in mm, above 0 and at most 1",
                ));
            }
            plate.sigma_mm = u / 2.0;
        } else if matches!(self.plate, StatedPlate::Distances(_) | StatedPlate::Centres(_)) {
            assumed.push(format!(
                "the certified coordinates have a standard uncertainty of {} mm, as those of the paper's plate: give --plate-u-mm from your certificate",
                text::number(plate.sigma_mm, 5)
            ));
        }
        let own = model.tool.tcp_m.map(|m| m * 1e3);
        let tool_mm = match self.tool_mm {
            Some(tool_mm) => tool_mm,
            None if check_tcp(own, diameter).is_ok() => own,
            None => {
                let paper = iiwa7_tool().tcp_m.map(|m| m * 1e3);
                assumed.push(format!(
                    "the TCP is at {} mm in the flange frame, as with the paper's nest: give --tool-mm from your drawing",
                    text::list(paper, 3)
                ));
                paper
            }
        };
        check_tcp(tool_mm, diameter)?;
        let com_mm = self.tool_com_mm.unwrap_or_else(|| {
            let half = tool_mm.map(|mm| mm / 2.0);
            assumed.push(format!(
                "the tool's centre of mass is half-way to the TCP, at {} mm: give --tool-com-mm if you know it",
                text::list(half, 3)
            ));
            half
        });
        Ok(Decided {
            stated: self,
            robot: in_any_folder(&self.robot, &model),
            model,
            plate,
            tool_mm,
            com_mm,
            placement: self.placement()?,
            assumed,
        })
    }

    /// The stated placement, or the default one.
    fn placement(&self) -> Result<Placement, NewCellError> {
        let mut placement = Placement::default();
        if let Some(at) = self.plate_at_mm {
            placement.origin_m = at.map(|mm| mm * 1e-3);
        }
        if let Some(yaw) = self.plate_yaw_deg {
            if !(-360.0..=360.0).contains(&yaw) {
                return Err(refuse("--plate-yaw-deg", yaw, "give degrees, from -360 to 360"));
            }
            placement.rpy_rad = [0.0, 0.0, yaw.to_radians()];
        }
        Ok(placement)
    }

    /// The configuration's text, with a placement within reach: the stated one, or one that is found.
    fn placed(&self, decided: &mut Decided<'_>) -> Result<String, NewCellError> {
        let checked = |decided: &Decided<'_>| -> Result<String, JobError> {
            let text = decided.cell_toml();
            let config = Config::parse("cell.toml", &text)?;
            config.check()?;
            check_reach(&config)?;
            Ok(text)
        };
        match (checked(decided), self.plate_at_mm) {
            (Ok(text), Some(_)) => Ok(text),
            (Ok(text), None) => {
                decided.assumed.push(decided.place_words());
                Ok(text)
            }
            (Err(JobError::PlateOutOfReach { origin_m, rpy_rad, .. }), None) => {
                decided.placement = Placement { origin_m, rpy_rad };
                decided.assumed.push(decided.place_words());
                Ok(checked(decided)?)
            }
            (
                Err(JobError::PlateOutOfReach {
                    source,
                    origin_m,
                    rpy_rad: [_, _, yaw],
                }),
                Some(at),
            ) => Err(refuse(
                "--plate-at-mm",
                text::list(at, 3),
                format!(
                    "{source}. With --plate-at-mm {} --plate-yaw-deg {} the arm reaches the whole plate",
                    text::list(origin_m.map(|m| m * 1e3), 1),
                    text::number(yaw.to_degrees(), 1)
                ),
            )),
            (Err(error), _) => Err(error.into()),
        }
    }
}

/// The robot as a configuration in any folder names it: a file by its whole path.
fn in_any_folder(robot: &str, model: &RobotModel) -> String {
    if matches!(model.origin, Origin::BuiltIn) {
        return robot.to_owned();
    }
    std::path::absolute(Path::new(robot)).map_or_else(|_| robot.to_owned(), |path| path.display().to_string())
}

#[cfg(test)]
mod tests;
