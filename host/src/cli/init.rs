//! `spherecal init`: a first cell, from questions or options.

use std::fs::File;
use std::io::{ErrorKind, IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};

use clap::Args;

use super::exit::{CliError, Exit};
use super::init_questions::Questions;
use super::out::outln;
use super::run::shell_word;
use spherecal_job::JobError;
use spherecal_job::new_cell::{self, Instrument, NewCell, NewCellError, NewCellFiles, StatedPlate};
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

/// Names of the files, and what they are for.
const CELL: &str = "cell.toml";
const PLATE: &str = "plate.toml";
const POSES: &str = "poses.csv";

/// A refusal of what was stated.
fn refused(error: NewCellError) -> CliError {
    match error {
        NewCellError::Job(error) => error.into(),
        error => CliError::input(error),
    }
}

/// `spherecal init`
pub(super) fn run(args: &InitArgs) -> Result<Exit, CliError> {
    let there: Vec<String> = [CELL, PLATE, POSES]
        .into_iter()
        .map(|name| args.out.join(name))
        .filter(|path| path.symlink_metadata().is_ok())
        .map(|path| path.display().to_string())
        .collect();
    if !there.is_empty() {
        return Err(already(&there.join(", ")));
    }
    let mut given = Given::of(args)?;
    let asks = !args.yes && std::io::stdin().is_terminal() && std::io::stderr().is_terminal();
    let missing = given.missing();
    if asks {
        let stdin = std::io::stdin().lock();
        Questions::new(stdin, std::io::stderr().lock()).ask(&mut given)?;
    } else if !missing.is_empty() {
        let why = if args.yes {
            "--yes asks nothing"
        } else {
            "there is no terminal to ask at"
        };
        return Err(CliError::input(format!(
            "{why}, and these options are missing:\n  {}",
            missing.join("\n  ")
        )));
    }
    let cell = given.cell(args)?;
    let files = cell.files().map_err(refused)?;
    if asks && !missing.is_empty() {
        let stdin = std::io::stdin().lock();
        let mut questions = Questions::new(stdin, std::io::stderr().lock());
        if !questions.confirm(&files.assumed, &args.out)? {
            return Err(CliError::input("nothing is written"));
        }
    }
    write(&args.out, &files)?;
    say(args, &cell, &files);
    Ok(Exit::Done)
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
    fn of(args: &InitArgs) -> Result<Self, CliError> {
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
    fn missing(&self) -> Vec<&'static str> {
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
    fn cell(self, args: &InitArgs) -> Result<NewCell, CliError> {
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

fn already(files: &str) -> CliError {
    CliError::input(format!(
        "{files}: there already, and nothing is overwritten: give another --out, or move the old files away"
    ))
}

/// Writes the files, all or none. A file that is there is never replaced.
fn write(folder: &Path, files: &NewCellFiles) -> Result<(), CliError> {
    let failed = |path: &Path, source: std::io::Error| -> CliError {
        JobError::Write {
            path: path.display().to_string(),
            source,
        }
        .into()
    };
    std::fs::create_dir_all(folder).map_err(|e| failed(folder, e))?;
    let mut made: Vec<PathBuf> = Vec::new();
    for (name, text) in [
        (CELL, &files.cell_toml),
        (PLATE, &files.plate_toml),
        (POSES, &files.poses_csv),
    ] {
        let path = folder.join(name);
        let written = File::create_new(&path).and_then(|mut file| {
            made.push(path.clone());
            file.write_all(text.as_bytes())?;
            file.sync_all()
        });
        if let Err(error) = written {
            for path in &made {
                // What is left of a full disk is named by the error.
                let _ = std::fs::remove_file(path);
            }
            return Err(match error.kind() {
                ErrorKind::AlreadyExists => already(&path.display().to_string()),
                _ => failed(&path, error),
            });
        }
    }
    Ok(())
}

/// Says what was written, what was assumed, and what to type next.
fn say(args: &InitArgs, cell: &NewCell, files: &NewCellFiles) {
    let here = args.out == Path::new(".");
    let path = |name: &str| {
        let path = if here { PathBuf::from(name) } else { args.out.join(name) };
        shell_word(&path.display().to_string())
    };
    outln!("Files:\n  {}\n  {}\n  {}", path(CELL), path(PLATE), path(POSES));
    if !files.assumed.is_empty() {
        outln!("\nAssumed:");
        for words in &files.assumed {
            outln!("  {words}");
        }
    }
    let plate = match cell.instrument {
        Instrument::None => format!(" --plate {}", path(PLATE)),
        Instrument::Tracker | Instrument::Points => String::new(),
    };
    let identify = format!(
        "spherecal identify --robot {} --data {}{plate} {} --certificate {} --out {}",
        shell_word(&cell.robot),
        path(POSES),
        files.identify_options,
        path(CELL),
        path("identified")
    );
    let out = if here {
        String::new()
    } else {
        format!(" --out {}", shell_word(&args.out.display().to_string()))
    };
    let run = format!("spherecal run --config {}{out}", path(CELL));
    match cell.instrument {
        Instrument::None => outln!(
            "\nFrom poses of your own, once {POSES} has rows:\n  {identify}\n\nThe whole job on a simulated arm in this cell, \
             and with --link on the robot.\nNext: {run}"
        ),
        Instrument::Tracker | Instrument::Points => outln!(
            "\nThe whole job on a simulated arm in this cell, and with --link on the robot:\n  {run}\n\nWrite one row per \
             measured pose into {POSES}.\nNext: {identify}"
        ),
    }
}
