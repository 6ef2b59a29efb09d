//! `spherecal identify`: a calibration from any robot's files.

use std::path::{Path, PathBuf};

use clap::Args;
use spherecal_model::robots::{self, RobotModel};
use spherecal_model::{WorkBox, read_text, read_toml};

use super::args::{BadValue, StoredArgs};
use super::bag::{BagArgs, BagTables};
use super::exit::{CliError, Exit};
use super::out::{errln, outln};
use super::stages;
use super::study::{StudyProgress, explained, identified, refuse, write_study};
use super::table::{Joints, TableArgs, put_right};
use spherecal_identify::study::{Sources, StudyError, StudyRequest, StudyStep, TableSource, anonymous_csv, sources};
use spherecal_identify::{Method, Model, Options};
use spherecal_job::{CertificateSection, study_certificate};
use spherecal_model::input::{InputError, triple};
use spherecal_results::{summary_json, summary_text, take_slides};

/// Identify a robot from a table of poses, or identify the last run of --out again.
///
/// With --data it reads a table and needs neither simulation nor database. Without --data it reads
/// the database of --out.
///
/// The table is a CSV file with a header row. Joint columns: q1..qn in rad, q1_deg..qn_deg, or the
/// robot's joint names; optionally tau1..taun in N m. Each row also has either a measured point
/// (x_mm,y_mm,z_mm or x_m,y_m,z_m, in any tracker frame), several targets on the tool
/// (x1_mm,y1_mm,z1_mm,x2_mm,..: up to six, target 1 is the TCP; empty where one was hidden), a pose
/// (x_mm,y_mm,z_mm with qw,qx,qy,qz or r11..r33, in the tracker frame), or the sphere on which the tool sat
/// (sphere, and place if the plate was moved). Optional column: set = calibrate | validate. Other
/// columns are refused; exclude them with --ignore-columns or --ignore-rest.
///
/// Accepted formats: commas, semicolons, tabs or blanks; decimal points or commas; UTF-8 or UTF-16; a header in a comment;
/// up to 5 million rows and 2 GiB. Rows without a value (nan) are left out and counted. Any other table is read with
/// --columns (docs/sources.md).
///
/// In place of a table, --data and --validate take a ROS 2 bag (MCAP or SQLite, file or folder) with sensor_msgs/JointState and
/// geometry_msgs/PointStamped: each rest of the arm with a point is a pose. A point in a frame sphere_N is a contact with
/// sphere N. The poses are written to poses-of-bag.csv in --out.
#[derive(Args, Clone, Debug)]
#[command(after_help = "Examples:\n  \
    spherecal identify --robot ur5e --data tracker.csv --tool-mm 0,0,120 --validate check.csv\n  \
    spherecal identify --robot arm.urdf --data spheres.csv --plate plate.toml --holdout place --out result\n  \
    spherecal identify --robot ur5e --data log.csv --joint-columns j1,j2,j3,j4,j5,j6 --ignore-columns time,operator\n  \
    spherecal identify --robot arm.urdf --data my_bag --topics /joint_states,/leica/point\n  \
    spherecal identify --robot robot.urdf#base_link:left_tool,right_tool --data left.csv --data right.csv\n\n\
    Exit codes: 0 done; 1 failed; 2 wrong input; 3 finished, but the result must not be used.")]
pub struct IdentifyArgs {
    /// Built-in name, FILE.toml, FILE.urdf, FILE.urdf#TIP, or FILE.urdf#BASE:TIP for the chain between these links;
    /// FILE.urdf#BASE:TIP,TIP for several tips, such as two arms on a torso, with a table of each.
    #[arg(long, help_heading = "Robot and data", value_name = "NAME|FILE", requires = "data")]
    pub robot: Option<String>,
    /// Table of poses, or a ROS 2 bag. Of several tips: one for each, in their order.
    #[arg(
        long,
        help_heading = "Robot and data",
        value_name = "FILE.csv|BAG",
        requires = "robot"
    )]
    pub data: Vec<PathBuf>,
    /// Estimator: full, geometry, lm or gauss-newton.
    #[arg(long, help_heading = "Identification", value_name = "M", default_value = "full")]
    pub method: Method,
    /// What is modelled: geometry, stiffness or full.
    #[arg(long, help_heading = "Identification", default_value = "full")]
    pub model: Model,
    /// Certificate of the plate, for contacts with spheres: [[sphere]] tables with id, x_mm, y_mm, z_mm, sigma_mm; or `paper` for Table 1 of the paper.
    #[arg(long, help_heading = "Robot and data", value_name = "FILE.toml")]
    pub plate: Option<PathBuf>,
    /// Nominal TCP in the flange frame, in mm. Of several tips: one for all, or one for each.
    #[arg(
        long,
        help_heading = "Robot and data",
        value_name = "X,Y,Z",
        allow_hyphen_values = true
    )]
    pub tool_mm: Vec<String>,
    /// Mass at the flange, in kg.
    #[arg(long, help_heading = "Robot and data", value_name = "M")]
    pub payload_kg: Option<f64>,
    /// Its centre of mass in the flange frame, in mm.
    #[arg(
        long,
        help_heading = "Robot and data",
        value_name = "X,Y,Z",
        allow_hyphen_values = true
    )]
    pub payload_com_mm: Option<String>,
    /// Table of poses, or a ROS 2 bag, that judges the result.
    #[arg(long, help_heading = "Robot and data", value_name = "FILE.csv|BAG")]
    pub validate: Option<PathBuf>,
    /// Hold each value of this column out in turn: place, coupling (rows on one sphere that follow each other), region
    /// (of the joints), a column of your own, or sphere where the plate has four or more.
    #[arg(long, help_heading = "Identification", value_name = "COLUMN")]
    pub holdout: Option<String>,
    /// Mean error of the TCP over the work region that is asked for, in mm: a worse result is refused.
    #[arg(long, help_heading = "Identification", value_name = "MM", requires = "data", value_parser = accuracy)]
    pub accuracy_mm: Option<f64>,
    /// Box in the robot's base frame, in mm, in which the robot is to work: expected error, verdict and files are for it.
    /// Without it, they are for where the rows are.
    #[arg(long, help_heading = "Identification", value_name = "X0:X1,Y0:Y1,Z0:Z1", requires = "data", allow_hyphen_values = true, value_parser = work_box)]
    pub work_mm: Option<WorkBox>,
    /// Columns with the joint angles, base to flange, instead of q1..qn (rad; degrees if the name
    /// ends in _deg). In a bag: names of the joints.
    #[arg(long, help_heading = "The table", value_name = "A,B,C", value_delimiter = ',')]
    pub joint_columns: Vec<String>,
    /// Columns that are left out, whatever their content.
    ///
    #[arg(long, help_heading = "The table", value_name = "X,Y", value_delimiter = ',')]
    pub ignore_columns: Vec<String>,
    #[command(flatten)]
    pub table: TableArgs,
    /// Search for what is wrong with the table (signs, order, zeros, couplings, units, tool, another robot), say it, and
    /// identify nothing. A table that does not fit is searched in any case.
    #[arg(long, help_heading = "The table", requires = "data", conflicts_with = "json")]
    pub explain: bool,
    #[command(flatten)]
    pub bag: BagArgs,
    /// Options as TOML: noise, priors and fixed parameters, harmonics.
    #[arg(long, help_heading = "Identification", value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Without effect, and accepted for one more release: the data find how large the arm's errors are.
    #[arg(long, requires = "data", hide = true)]
    pub uncalibrated: bool,
    /// Names and numbers for the certificate: a file with the block [certificate], such as the cell's configuration.
    #[arg(long, help_heading = "Results", value_name = "FILE.toml", requires = "data")]
    pub certificate: Option<PathBuf>,
    /// Write the rows to this file for sharing: joints, torques, targets and placements alone, without names, further
    /// columns or the instrument's place. `identify` gives the same robot from it.
    #[arg(long, help_heading = "Results", value_name = "FILE.csv", requires = "data")]
    pub anonymise: Option<PathBuf>,
    /// Seed of what draws at random.
    #[arg(long, help_heading = "Identification", value_name = "N")]
    pub seed: Option<u64>,
    /// Print one JSON document and nothing else.
    #[arg(long, help_heading = "Results")]
    pub json: bool,
    /// Directory for summary.json, calibrated.toml, calibrated.urdf, kinematics.yaml, offsets.yaml and report.html.
    #[arg(long, help_heading = "Results", value_name = "DIR", default_value = "spherecal-out")]
    pub out: PathBuf,
}

/// Largest file of options, in bytes.
const MOST_CONFIG_BYTES: u64 = 1 << 20;

/// An accuracy in mm, from 1 um to 100 mm.
fn accuracy(text: &str) -> Result<f64, BadValue> {
    let mm: f64 = text.parse().map_err(|_| BadValue("give a length in mm, such as 0.2"))?;
    if (1e-3..=100.0).contains(&mm) {
        Ok(mm)
    } else {
        Err(BadValue("give a length in mm from 0.001 to 100"))
    }
}

fn work_box(text: &str) -> Result<WorkBox, BadValue> {
    WorkBox::parse(text).map_err(BadValue)
}

/// The request that the arguments describe.
/// Errors: numbers or a configuration that cannot be used.
pub(super) fn request(
    args: &IdentifyArgs,
    robot: &str,
    data: &Path,
    tool: Option<&str>,
) -> Result<StudyRequest, StudyError> {
    let point = |option: &str, text: Option<&str>| text.map(|t| triple(option, t, 2000.0)).transpose();
    let mut options = match &args.config {
        None => Options::default(),
        Some(path) => {
            let text =
                read_text(path, MOST_CONFIG_BYTES, "options are a few lines of TOML").map_err(InputError::from)?;
            read_toml(&text).map_err(|source| InputError::Toml {
                file: path.display().to_string(),
                source,
                expected: "options of the identification: noise, priors and fixed parameters, harmonics",
            })?
        }
    };
    if args.config.is_none() || args.method != Method::Full {
        options.method = args.method;
    }
    if args.config.is_none() || args.model != Model::Full {
        options.model = args.model;
    }
    if args.uncalibrated {
        errln!("spherecal: --uncalibrated is not needed any more: the data find how large the arm's errors are");
    }
    if let Some(seed) = args.seed {
        options.seed = seed;
    }
    Ok(StudyRequest {
        robot: robot.to_owned(),
        data: data.to_owned(),
        plate: args.plate.clone(),
        tool_mm: point("--tool-mm", tool)?,
        payload_kg: args.payload_kg,
        payload_com_mm: point("--payload-com-mm", args.payload_com_mm.as_deref())?,
        validate: args.validate.clone(),
        holdout: args.holdout.clone(),
        accuracy_mm: args.accuracy_mm,
        work: args.work_mm,
        joint_columns: args.joint_columns.clone(),
        ignore_columns: args.ignore_columns.clone(),
        options,
    })
}

/// What the request names, with the tables that were made of bags.
/// Errors: a plate that cannot be read.
pub(super) fn with_bags<'a>(
    request: &'a StudyRequest,
    model: RobotModel,
    tables: &'a BagTables,
) -> Result<Sources<'a>, StudyError> {
    let table = |path: &'a Path, csv: &'a Option<String>| match csv {
        Some(csv) => TableSource::Text {
            name: path.to_str().unwrap_or("bag"),
            csv,
        },
        None => TableSource::File(path),
    };
    Ok(Sources {
        data: table(&request.data, &tables.data),
        validate: request.validate.as_deref().map(|path| table(path, &tables.validate)),
        notes: model.notes.iter().chain(&tables.notes).cloned().collect(),
        ..sources(request, model)?
    })
}

/// Refuses a file that is there already: nothing is overwritten.
fn refuse_existing(path: &Path) -> Result<(), CliError> {
    if path.exists() {
        return Err(CliError::input(format!(
            "--anonymise: {} exists already: give another name",
            path.display()
        )));
    }
    Ok(())
}

/// Writes a file that is not there yet.
fn write_new(path: &Path, text: &str) -> Result<(), CliError> {
    use std::io::Write as _;
    let written = std::fs::File::create_new(path).and_then(|mut file| {
        file.write_all(text.as_bytes())?;
        file.sync_all()
    });
    written.map_err(|error| CliError::job(format!("--anonymise: {} cannot be written: {error}", path.display())))
}

/// `spherecal identify --explain`
fn say_what_is_wrong(request: &StudyRequest, sources: Sources<'_>) -> Result<Exit, CliError> {
    let found = explained(request, sources).map_err(CliError::input)?;
    if !found.own_m.is_finite() {
        outln!("the table has too few rows to search for what is wrong: ten are needed");
    } else if found.found.is_empty() && !found.readout {
        let fits = found.own_m < spherecal_explain::GOOD_M;
        let kept = format!("the rows fit to {:.3} mm as they are", found.own_m * 1e3);
        outln!(
            "{}",
            if fits {
                kept
            } else {
                format!("{kept}; {}", found.none_of_these())
            }
        );
    }
    for sentence in found.sentences() {
        outln!("{sentence}");
    }
    Ok(Exit::Done)
}

pub(super) fn run(args: &IdentifyArgs) -> Result<Exit, CliError> {
    let (Some(robot), Some(data)) = (&args.robot, args.data.first()) else {
        if !args.out.join("calibration.db").exists() {
            return Err(CliError::input(format!(
                "there is no run in {}: give --robot and --data FILE.csv to identify from a table, or --out of an earlier run",
                args.out.display()
            )));
        }
        return stages::report(&StoredArgs {
            out: args.out.clone(),
            json: args.json,
            store: None,
            arm: String::new(),
        });
    };
    // Refused before the work, not after it.
    let stated = match &args.certificate {
        Some(path) => CertificateSection::read(path).map_err(CliError::input)?,
        None => CertificateSection::default(),
    };
    if let Some(path) = &args.anonymise {
        refuse_existing(path)?;
    }
    if args.tool_mm.len() > 1 {
        return Err(CliError::input("--tool-mm: give one for one table"));
    }
    let mut view = StudyProgress::new();
    let tool = args.tool_mm.first().map(String::as_str);
    let mut request = request(args, robot, data, tool).map_err(refuse)?;
    let model = robots::load_path(&request.robot).map_err(|e| refuse(e.into()))?;
    if let Some(chain) = model.chain_words() {
        errln!("spherecal: the arm is {chain}");
    }
    let tables = BagTables::read(&args.bag, &mut request, &model, &mut |p| {
        view.show(StudyStep::Reading(p));
    });
    let mut tables = tables.inspect_err(|_| view.finish())?;
    let from_bag = tables.data.clone();
    let slides = put_right(&args.table, &mut request, &model, &mut tables, Joints::Hinges);
    let slides = slides.inspect_err(|_| view.finish())?;
    let sources = with_bags(&request, model, &tables).map_err(refuse)?;
    if args.explain {
        view.finish();
        return say_what_is_wrong(&request, sources);
    }
    let mut study = identified(&request, sources, &tables.notes, view)?;
    if let Some(slides) = slides {
        take_slides(&mut study, &slides.directions());
    }
    if let Some(path) = &args.anonymise {
        write_new(path, &anonymous_csv(&study.recordings))?;
        errln!(
            "{} has the rows without names. Share it with the robot's name or nominal table, the tool and the distances \
             of the plate (docs/real-data.md)",
            path.display()
        );
    }
    let certificate = study_certificate(&study, &stated);
    let paths = write_study(&study, &args.out, &certificate, from_bag.as_deref())?;
    if args.json {
        outln!("{:#}", summary_json(&study, &certificate));
    } else {
        outln!("{}", summary_text(&study));
        for path in &paths {
            outln!("  {}", path.display());
        }
    }
    Ok(if study.evaluation.verdict.may_be_used {
        Exit::Done
    } else {
        Exit::NotTrusted
    })
}
