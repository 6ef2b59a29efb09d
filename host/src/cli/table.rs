//! Tables of any kind in place of the one that the identification reads: named columns, corrections, recordings of
//! robots with joints that slide or follow others.

use std::path::Path;

use clap::Args;
use spherecal_explain::{Slides, hinges};
use spherecal_identify::study::StudyRequest;
use spherecal_model::input::{
    Adjustments, ColumnMapping, InputError, Labels, MOST_FILE_BYTES, Recorded, Table, TableFormat, read_csv, recorded,
};
use spherecal_model::open_regular;
use spherecal_model::robots::RobotModel;

use super::bag::BagTables;
use super::exit::CliError;

/// What a table says of the joints of its robot after it was put right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Joints {
    /// The angles of the robot's table, with sliding joints at zero.
    Hinges,
    /// The columns of the whole path.
    Path,
}

/// Files larger than this (bytes) are looked at only if an option asks for it: they are read as they are.
const LOOKED_AT: u64 = 64 << 20;

/// How a table differs from the one that is read.
#[derive(Args, Clone, Debug)]
pub struct TableArgs {
    /// Columns by their meaning: joints=.., joints_deg=.., torques=.., point_mm=X,Y,Z, point_m=.., quaternion=W,X,Y,Z,
    /// quaternion_xyzw=.., euler_zyx_deg=A,B,C (axes in the order in which the body turns), rpy_deg=ROLL,PITCH,YAW,
    /// rotvec=RX,RY,RZ, sphere=.., place=.., set=... Names, or numbers from 1 where the table has no header.
    #[arg(long, help_heading = "The table", value_name = "MEANING=A,B,C", num_args = 1.., requires = "data")]
    pub columns: Vec<String>,
    /// Leave out all columns that are not known.
    #[arg(long, help_heading = "The table", requires = "data")]
    pub ignore_rest: bool,
    /// Joints whose columns count the other way.
    #[arg(
        long,
        help_heading = "The table",
        value_name = "J,K",
        value_delimiter = ',',
        requires = "data"
    )]
    pub flip: Vec<usize>,
    /// The joint column that each joint is taken from, base to flange.
    #[arg(
        long,
        help_heading = "The table",
        value_name = "A,B,C",
        value_delimiter = ',',
        requires = "data"
    )]
    pub order: Vec<usize>,
    /// Angles to add to joints, in degrees.
    #[arg(
        long,
        help_heading = "The table",
        value_name = "J=DEG",
        value_delimiter = ',',
        requires = "data",
        allow_hyphen_values = true
    )]
    pub zero_deg: Vec<String>,
    /// Joints that stand at sums of the columns, such as 3=q3+q2 where joint 3 counts from the horizon.
    #[arg(
        long,
        help_heading = "The table",
        value_name = "J=qA+qB",
        value_delimiter = ',',
        requires = "data"
    )]
    pub couple: Vec<String>,
    /// Units of single joint columns: deg where the others are in rad, or rad where the others are in degrees.
    #[arg(
        long,
        help_heading = "The table",
        value_name = "J=deg|rad",
        value_delimiter = ',',
        requires = "data"
    )]
    pub joint_unit: Vec<String>,
    /// Factor of the measured points, such as 25.4 for inches in columns of mm.
    #[arg(long, help_heading = "The table", value_name = "F", requires = "data")]
    pub point_factor: Option<f64>,
    /// The measured points are in a left-handed frame: their y counts the other way.
    #[arg(long, help_heading = "The table", requires = "data")]
    pub mirror_points: bool,
    /// The measured poses are those of the instrument in the frame of the tool.
    #[arg(long, help_heading = "The table", requires = "data")]
    pub invert_poses: bool,
    /// Rows by which the measurements lag behind their joint angles; parts of a row, such as 0.6, where the arm moved while
    /// it was measured.
    #[arg(
        long,
        help_heading = "The table",
        value_name = "N",
        default_value = "0",
        requires = "data",
        allow_hyphen_values = true
    )]
    pub shift_rows: f64,
}

fn refuse(option: &str, value: &str, remedy: &str) -> CliError {
    CliError::input(InputError::Field {
        file: "command line".to_owned(),
        field: option.to_owned(),
        value: format!("\"{}\"", spherecal_model::excerpt(value)),
        remedy: remedy.to_owned(),
    })
}

/// A joint's number from 1, as an index.
fn joint(option: &str, text: &str) -> Result<usize, CliError> {
    let number = text.trim().parse::<usize>().ok().and_then(|n| n.checked_sub(1));
    number.ok_or_else(|| refuse(option, text, "number the joints from 1, base to flange"))
}

/// `q3+q2-q1` as columns with their factors.
fn sum(text: &str) -> Option<Vec<(usize, f64)>> {
    let spaced = text.replace('+', " +").replace('-', " -");
    let term = |word: &str| {
        let (factor, name) = match word.strip_prefix('-') {
            Some(rest) => (-1.0, rest),
            None => (1.0, word.strip_prefix('+').unwrap_or(word)),
        };
        Some((name.strip_prefix('q')?.parse::<usize>().ok()?.checked_sub(1)?, factor))
    };
    let terms: Option<Vec<_>> = spaced.split_whitespace().map(term).collect();
    terms.filter(|t| !t.is_empty())
}

impl TableArgs {
    /// The corrections that are asked for, for a robot with `n` joint columns.
    /// Errors: a joint that the robot does not have, and words that say nothing.
    fn adjustments(&self, n: usize) -> Result<Adjustments, CliError> {
        let pair = |option: &'static str, text: &String| -> Result<(usize, String), CliError> {
            let (number, value) = text
                .split_once('=')
                .ok_or_else(|| refuse(option, text, "write JOINT=VALUE"))?;
            Ok((joint(option, number)?, value.trim().to_owned()))
        };
        let mut out = Adjustments {
            point_factor: self.point_factor.unwrap_or(1.0),
            mirror: self.mirror_points,
            invert: self.invert_poses,
            shift: self.shift_rows,
            ..Adjustments::default()
        };
        if !(out.point_factor.is_finite() && out.point_factor > 0.0) {
            return Err(refuse(
                "--point-factor",
                &out.point_factor.to_string(),
                "give a positive factor",
            ));
        }
        let numbers = |option: &'static str, all: &[usize]| -> Result<Vec<usize>, CliError> {
            all.iter().map(|k| joint(option, &k.to_string())).collect()
        };
        out.flips = numbers("--flip", &self.flip)?;
        out.order = numbers("--order", &self.order)?;
        let mut sorted = out.order.clone();
        sorted.sort_unstable();
        if !sorted.is_empty() && sorted != (0..n).collect::<Vec<_>>() {
            return Err(refuse(
                "--order",
                &format!("{:?}", self.order),
                &format!("name each of the {n} joint columns once"),
            ));
        }
        for text in &self.zero_deg {
            let (number, value) = pair("--zero-deg", text)?;
            let angle: Option<f64> = value.parse().ok().filter(|d: &f64| d.abs() <= 360.0);
            let angle = angle.ok_or_else(|| refuse("--zero-deg", text, "give an angle of at most 360 degrees"))?;
            out.zeros.push((number, angle.to_radians()));
        }
        for text in &self.couple {
            let (number, value) = pair("--couple", text)?;
            let terms = sum(&value).ok_or_else(|| refuse("--couple", text, "write JOINT=qA+qB or JOINT=qA-qB"))?;
            out.couples.push((number, terms));
        }
        for text in &self.joint_unit {
            let (number, value) = pair("--joint-unit", text)?;
            let factor = match value.as_str() {
                "deg" => 1f64.to_radians(),
                "rad" => 1f64.to_degrees(),
                _ => return Err(refuse("--joint-unit", text, "write JOINT=deg or JOINT=rad")),
            };
            // A number beyond the robot's joints is refused below.
            out.units.resize(out.units.len().max(n), 1.0);
            match out.units.get_mut(number) {
                Some(unit) => *unit = factor,
                None => {
                    return Err(refuse(
                        "--joint-unit",
                        text,
                        &format!("the robot has {n} joint columns"),
                    ));
                }
            }
        }
        if out.largest_joint() > n {
            return Err(refuse(
                "--flip, --order, --zero-deg, --couple, --joint-unit",
                &out.largest_joint().to_string(),
                &format!("the robot has {n} joint columns"),
            ));
        }
        Ok(out)
    }
}

/// A file as it was recorded; `None` where it is read as it is.
fn looked_at(
    path: &Path,
    format: &TableFormat,
    mapping: &ColumnMapping,
    asked: bool,
) -> Result<Option<Recorded>, InputError> {
    let (file, bytes) = open_regular(path, MOST_FILE_BYTES, "split the table into several files")?;
    if bytes > LOOKED_AT && !asked {
        return Ok(None);
    }
    recorded(&path.display().to_string(), file, format, mapping).map(Some)
}

/// Puts the tables of a request right, in place of its files: columns, corrections, joints that slide or follow others.
/// What was done goes to the tables' notes. Then the request's column options are used up. Returns the motion of the
/// sliding joints, where there are some and `joints` are those of the table.
/// Errors: options that say nothing, and tables that cannot be read.
pub(super) fn put_right(
    args: &TableArgs,
    request: &mut StudyRequest,
    model: &RobotModel,
    tables: &mut BagTables,
    joints: Joints,
) -> Result<Option<Slides>, CliError> {
    let path = model.joint_path().map_err(CliError::input)?;
    let plain = path.odd_joint().is_none();
    let n = path.columns.len();
    let adjust = args.adjustments(n)?;
    let mapping = ColumnMapping::parse(&args.columns, args.ignore_rest).map_err(CliError::input)?;
    let bags_alone = tables.data.is_some() && (request.validate.is_none() || tables.validate.is_some());
    if bags_alone && !(mapping.is_nothing() && request.ignore_columns.is_empty()) {
        return Err(refuse(
            "--columns, --ignore-rest, --ignore-columns",
            &request.data.display().to_string(),
            "a bag has no columns: name its topics with --topics, and its joints with --joint-columns",
        ));
    }
    let (others, carriers) = model.other_joints().map_err(CliError::input)?;
    let format = TableFormat {
        joints: n,
        joint_names: if plain {
            model.joint_names.clone()
        } else {
            path.columns.clone()
        },
        joint_columns: request.joint_columns.clone(),
        ignore: request.ignore_columns.clone(),
        others,
        carriers,
        label: request.holdout.clone(),
        units: adjust.units.clone(),
    };
    // The columns' units are corrected as they are read: degrees are no angles in rad.
    let then = Adjustments {
        units: Vec::new(),
        ..adjust.clone()
    };
    let rebuilt = !adjust.is_nothing() || !plain || joints == Joints::Path;
    let asked = rebuilt || !mapping.is_nothing();
    let mut motion: Option<Slides> = None;
    let tool = request.tool_mm.map_or(model.tool.tcp_m, |mm| mm.map(|x| x / 1e3));
    let mut one =
        |file: &Path, made: &mut Option<String>, what: &str, notes: &mut Vec<String>| -> Result<(), CliError> {
            let name = file.display().to_string();
            if made.is_none() {
                let Some(found) = looked_at(file, &format, &mapping, asked).map_err(CliError::input)? else {
                    return Ok(());
                };
                notes.extend(found.notes.iter().map(|note| format!("{what}: {note}")));
                if found.changed || rebuilt {
                    *made = Some(found.csv);
                }
            }
            let Some(csv) = made.as_mut().filter(|_| rebuilt) else {
                return Ok(());
            };
            let mut places = Labels::default();
            let mut table: Table = read_csv(&name, csv.as_bytes(), &format, &mut places).map_err(CliError::input)?;
            then.apply(&mut table).map_err(CliError::input)?;
            if !plain && joints == Joints::Hinges {
                let done = hinges(&path, &tool.into(), &mut table, &mut motion).map_err(CliError::input)?;
                notes.extend(done);
            }
            let label = request.holdout.as_deref().filter(|_| !table.labels.is_empty());
            *csv = table.to_csv(&places, label);
            Ok(())
        };
    one(&request.data, &mut tables.data, "--data", &mut tables.notes)?;
    if let Some(file) = &request.validate {
        one(file, &mut tables.validate, "--validate", &mut tables.notes)?;
    }
    if !adjust.is_nothing() {
        tables
            .notes
            .push(format!("the tables were corrected as asked: {}", adjust.options()));
    }
    if rebuilt {
        request.joint_columns.clear();
        request.ignore_columns.clear();
    }
    Ok(motion)
}
