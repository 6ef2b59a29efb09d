//! What is stated of a first cell: by options, and by the answers to questions.

use std::path::PathBuf;

use clap::Args;

use super::exit::CliError;
use spherecal_job::new_cell::{self, Instrument, NewCell, NewCellError, StatedPlate};
use spherecal_model::input::triple;

/// Write the files of a first cell: cell.toml, plate.toml and poses.csv.
///
/// On a terminal it asks for what the options do not say. Everything that can be checked without
/// the robot is checked before anything is written: the robot's name, the plate's triangle, the
/// tool's mass against the robot's payload, and whether the arm reaches the plate. No file is
/// overwritten.
///
/// cell.toml is for run, plan and measure. plate.toml and poses.csv are for identify: poses.csv has
/// the columns that it takes for this robot and instrument, and no row yet.
#[derive(Args, Clone, Debug)]
#[command(after_help = "Examples:\n  \
    spherecal init                              asks\n  \
    spherecal init --robot fr3 --serial FR3-0042 --plate 300.009,300.244,300.117 --tool-mass-kg 0.8 --yes --out cell\n  \
    spherecal run --config cell/cell.toml --out cell\n\n\
    Exit codes: 0 written; 1 a file could not be written; 2 wrong or missing input, or a file is there already.")]
pub struct InitArgs {
    /// Robot: a built-in name (`spherecal robot list`), FILE.toml, FILE.urdf or FILE.yaml.
    #[arg(long, help_heading = "Robot", value_name = "NAME|FILE")]
    pub robot: Option<String>,
    /// Serial number of the arm.
    #[arg(long, help_heading = "Robot", value_name = "NAME")]
    pub serial: Option<String>,
    /// Plate by its certificate: distances of the centres 1-2, 1-3 and 2-3 in mm; or the centres in mm, as
    /// X,Y,Z;X,Y,Z;X,Y,Z; or a plate file; or `paper` for Table 1 of the paper.
    #[arg(long, help_heading = "Plate", value_name = "D12,D13,D23|CENTRES|FILE|paper")]
    pub plate: Option<String>,
    /// Number of the plate's certificate.
    #[arg(long, help_heading = "Plate", value_name = "NAME")]
    pub plate_certificate: Option<String>,
    /// Expanded uncertainty (k = 2) of the certified coordinates, in mm.
    #[arg(long, help_heading = "Plate", value_name = "MM", allow_hyphen_values = true)]
    pub plate_u_mm: Option<f64>,
    /// Diameter of the spheres, in mm.
    #[arg(
        long,
        help_heading = "Plate",
        value_name = "MM",
        default_value_t = 50.8,
        allow_hyphen_values = true
    )]
    pub sphere_diameter_mm: f64,
    /// Position of sphere 1 in the robot's base frame, in mm. Default: a place within reach.
    #[arg(long, help_heading = "Plate", value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub plate_at_mm: Option<String>,
    /// Turn of the plate about the vertical, in degrees. Default: 150.
    #[arg(long, help_heading = "Plate", value_name = "DEG", allow_hyphen_values = true)]
    pub plate_yaw_deg: Option<f64>,
    /// Mass of everything at the flange, in kg.
    #[arg(long, help_heading = "Tool", value_name = "KG", allow_hyphen_values = true)]
    pub tool_mass_kg: Option<f64>,
    /// Tool offset: the centre of a seated sphere in the flange frame, in mm. Default: from the robot's
    /// file, or that of the paper's nest.
    #[arg(long, help_heading = "Tool", value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub tool_mm: Option<String>,
    /// Centre of the tool's mass in the flange frame, in mm. Default: half-way to the seated sphere.
    #[arg(long, help_heading = "Tool", value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub tool_com_mm: Option<String>,
    /// What measures the poses: none (the plate alone), tracker, or points (another instrument that
    /// measures points). Default: none.
    #[arg(long, help_heading = "Instrument", value_name = "none|tracker|points")]
    pub instrument: Option<Instrument>,
    /// Name the joint columns of poses.csv in degrees instead of rad.
    #[arg(long, help_heading = "Instrument")]
    pub degrees: bool,
    /// Do not ask: take the defaults for what is not given.
    #[arg(long)]
    pub yes: bool,
    /// Folder of the files.
    #[arg(long, value_name = "DIR", default_value = ".")]
    pub out: PathBuf,
}

/// What is stated so far.
#[derive(Clone, Debug, Default)]
pub(super) struct Given {
    pub(super) robot: Option<String>,
    pub(super) serial: Option<String>,
    pub(super) plate: Option<StatedPlate>,
    pub(super) plate_certificate: Option<String>,
    pub(super) plate_u_mm: Option<f64>,
    pub(super) sphere_diameter_mm: f64,
    pub(super) tool_mass_kg: Option<f64>,
    pub(super) tool_mm: Option<[f64; 3]>,
    pub(super) instrument: Option<Instrument>,
}

impl Given {
    pub(super) fn of(args: &InitArgs) -> Result<Self, CliError> {
        Ok(Self {
            robot: args.robot.clone(),
            serial: args.serial.clone(),
            plate: args.plate.as_deref().map(str::parse).transpose().map_err(refused)?,
            plate_certificate: args.plate_certificate.clone(),
            plate_u_mm: args.plate_u_mm,
            sphere_diameter_mm: args.sphere_diameter_mm,
            tool_mass_kg: args.tool_mass_kg,
            tool_mm: point("--tool-mm", args.tool_mm.as_deref(), new_cell::LARGEST_MM)?,
            instrument: args.instrument,
        })
    }

    /// The options that must be given and are not, each with what it takes.
    pub(super) fn missing(&self) -> Vec<&'static str> {
        let required = [
            (
                self.robot.is_none(),
                "--robot NAME|FILE             a built-in robot (`spherecal robot list`) or its file",
            ),
            (
                self.serial.is_none(),
                "--serial NAME                 serial number of the arm",
            ),
            (
                self.plate.is_none(),
                "--plate D12,D13,D23           distances of the plate's spheres in mm, by its certificate; or `paper`",
            ),
            (
                self.tool_mass_kg.is_none(),
                "--tool-mass-kg KG             mass of everything at the flange",
            ),
        ];
        let missing = required.into_iter().filter(|(missing, _)| *missing);
        missing.map(|(_, words)| words).collect()
    }

    /// The cell, with the options that nobody asks for.
    pub(super) fn cell(self, args: &InitArgs) -> Result<NewCell, CliError> {
        let (Some(robot), Some(serial), Some(plate), Some(tool_mass_kg)) =
            (self.robot, self.serial, self.plate, self.tool_mass_kg)
        else {
            return Err(CliError::input("robot, serial number, plate and tool mass are needed"));
        };
        Ok(NewCell {
            robot,
            serial,
            plate,
            plate_certificate: self.plate_certificate.unwrap_or_default(),
            plate_u_mm: self.plate_u_mm,
            sphere_diameter_mm: self.sphere_diameter_mm,
            tool_mass_kg,
            tool_mm: self.tool_mm,
            tool_com_mm: point("--tool-com-mm", args.tool_com_mm.as_deref(), new_cell::LARGEST_MM)?,
            plate_at_mm: point("--plate-at-mm", args.plate_at_mm.as_deref(), new_cell::FARTHEST_MM)?,
            plate_yaw_deg: args.plate_yaw_deg,
            instrument: self.instrument.unwrap_or_default(),
            degrees: args.degrees,
        })
    }
}

fn point(option: &str, text: Option<&str>, largest: f64) -> Result<Option<[f64; 3]>, CliError> {
    text.map(|text| triple(option, text, largest))
        .transpose()
        .map_err(CliError::input)
}

/// A refusal of what was stated.
pub(super) fn refused(error: NewCellError) -> CliError {
    match error {
        NewCellError::Job(error) => error.into(),
        error => CliError::input(error),
    }
}
