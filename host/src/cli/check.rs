//! `spherecal check`: how wrong a robot's forward kinematics is, from a dozen contacts.

use std::path::{Path, PathBuf};

use clap::Args;
use spherecal_identify::check::{Checked, check};
use spherecal_identify::study::{PAPER_PLATE, StudyError, StudyRequest, load};
use spherecal_identify::{ExpectedError, Options};
use spherecal_job::Link;
use spherecal_model::input::triple;

use super::args::BadValue;
use super::collect::{CollectArgs, arm_link, gather};
use super::exit::{CliError, Exit};
use super::out::{errln, outln};

/// Tell from a dozen contacts how wrong a robot's forward kinematics is, and whether a calibration still holds.
///
/// Give the robot as its controller computes it: the nominal one, or the calibrated.toml that is in use. With --link you
/// guide the arm by hand, as in `spherecal collect`: a dozen poses on the spheres of one placement, in about three
/// minutes. Turn the tool and the elbow much between the poses. With --data the contacts come from a table.
///
/// The answer is the mean error of the TCP over the workspace, with its 95 % interval, after the best common placement.
/// It is an inference: the scatter at a dozen poses tells the errors of links, joints and tool, and these tell the rest
/// of the workspace. An error that shows only far from the plate is not seen.
#[derive(Args, Clone, Debug)]
#[command(
    after_help = "Example: spherecal check --link franka:172.16.0.2 --robot result/calibrated.toml --within-mm 0.5\n\n\
    Exit codes: 0 the error is below --within-mm; 1 failed or stopped before; 2 wrong input; 3 the error is above it, or \
    the contacts cannot tell."
)]
pub struct CheckArgs {
    /// The robot as it computes now: built-in name, FILE.toml or FILE.urdf. Default: as `collect`.
    #[arg(long, value_name = "NAME|FILE", required_unless_present = "link")]
    pub robot: Option<String>,
    /// The arm that you guide by hand: franka:HOST, fri:PORT, ur:HOST or tcp:HOST:PORT.
    #[arg(long, value_name = "LINK", value_parser = arm_link, required_unless_present = "data", conflicts_with = "data")]
    pub link: Option<Link>,
    /// Table of contacts, as `collect` writes it.
    #[arg(long, value_name = "FILE.csv")]
    pub data: Option<PathBuf>,
    /// Certificate of the plate, or `paper` for Table 1 of the paper.
    #[arg(long, value_name = "FILE.toml", default_value = PAPER_PLATE)]
    pub plate: PathBuf,
    /// TCP (the centre of the nest's sphere) in the flange frame, in mm. Default: the robot's own.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub tool_mm: Option<String>,
    /// Mean error of the TCP over the workspace up to which the forward kinematics holds, in mm.
    #[arg(long, value_name = "MM", default_value_t = 0.5, value_parser = limit)]
    pub within_mm: f64,
    /// Contacts to make with --link.
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u32).range(9..=100))]
    pub contacts: u32,
    /// Take every still pose without Enter.
    #[arg(long)]
    pub auto: bool,
    /// Time without a new still pose after which it ends, in s.
    #[arg(long, value_name = "S", default_value_t = 600.0, value_parser = super::collect::seconds)]
    pub wait_s: f64,
    /// Table of the contacts that are made with --link. A table that is not complete is continued.
    #[arg(long, value_name = "FILE.csv", default_value = "check.csv")]
    pub out: PathBuf,
    /// Print one JSON document at the end; progress goes to stderr.
    #[arg(long)]
    pub json: bool,
}

fn limit(text: &str) -> Result<f64, BadValue> {
    match text.parse() {
        Ok(mm) if (0.01..=100.0).contains(&mm) => Ok(mm),
        _ => Err(BadValue("give a length in mm from 0.01 to 100")),
    }
}

/// What the contacts say about the limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LimitAnswer {
    Holds,
    DoesNotHold,
    CannotTell,
}

impl LimitAnswer {
    fn of(error: &ExpectedError, within_mm: f64) -> Self {
        if error.interval[1] <= within_mm {
            Self::Holds
        } else if error.interval[0] > within_mm {
            Self::DoesNotHold
        } else {
            Self::CannotTell
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::Holds => "holds",
            Self::DoesNotHold => "does_not_hold",
            Self::CannotTell => "cannot_tell",
        }
    }

    fn words(self, robot: &str, within_mm: f64) -> String {
        match self {
            Self::Holds => format!("{robot} holds: its error is below {within_mm} mm"),
            Self::DoesNotHold => {
                format!("{robot} does not hold: its error is above {within_mm} mm. Calibrate the robot.")
            }
            Self::CannotTell => format!(
                "cannot tell whether {robot} holds: the interval contains {within_mm} mm. Make more contacts, in other \
                 places too, or give another --within-mm."
            ),
        }
    }
}

/// Guides the contacts into `args.out`. Returns the robot, or none if it was stopped.
fn contacts(args: &CheckArgs, link: &Link) -> Result<Option<String>, CliError> {
    let collect = CollectArgs {
        link: link.clone(),
        robot: args.robot.clone(),
        tool_mm: args.tool_mm.clone(),
        plate: args.plate.clone(),
        places: 1,
        poses: args.contacts,
        key: false,
        auto: args.auto,
        settle_s: 0.5,
        wait_s: args.wait_s,
        uncalibrated: false,
        out: args.out.clone(),
        json: args.json,
    };
    let gathered = gather(&collect)?;
    if gathered.done && gathered.new == 0 {
        return Err(CliError::input(format!(
            "--out {0}: this table is complete already. Its contacts may be old: give another file, or check it with \
             --data {0}",
            args.out.display()
        )));
    }
    Ok(gathered.done.then_some(gathered.robot))
}

pub(super) fn run(args: &CheckArgs) -> Result<Exit, CliError> {
    let (robot, data): (String, &Path) = match (&args.link, &args.data, &args.robot) {
        (Some(link), ..) => match contacts(args, link)? {
            Some(robot) => (robot, &args.out),
            None => return Ok(Exit::Failed),
        },
        (None, Some(data), Some(robot)) => (robot.clone(), data),
        _ => return Err(CliError::input("give --link, or --data and --robot")),
    };
    let tool_mm = args.tool_mm.as_deref().map(|t| triple("--tool-mm", t, 2000.0));
    let request = StudyRequest {
        robot: robot.clone(),
        data: data.to_owned(),
        plate: Some(args.plate.clone()),
        tool_mm: tool_mm.transpose().map_err(CliError::input)?,
        ..StudyRequest::default()
    };
    let refuse = |error: StudyError| {
        if error.is_input() {
            CliError::input(error)
        } else {
            CliError::job(error)
        }
    };
    let loaded = load(&request, &mut |_| {}).map_err(refuse)?;
    if !loaded.recordings.closed_loop() {
        return Err(CliError::input(format!(
            "{}: give contacts with spheres: columns sphere and q1..",
            data.display()
        )));
    }
    errln!("Fitting the model to the contacts ...");
    let found = check(&loaded.recordings.experiment, &Options::default()).map_err(|error| refuse(error.into()))?;
    let answer = LimitAnswer::of(&found.error_mm, args.within_mm);
    if args.json {
        let document = serde_json::json!({
            "command": "check", "robot": robot, "file": data, "within_mm": args.within_mm,
            "answer": answer.name(), "check": found,
        });
        outln!("{document:#}");
    } else {
        outln!("{}", text(&found, answer, &robot, args.within_mm));
    }
    Ok(if answer == LimitAnswer::Holds {
        Exit::Done
    } else {
        Exit::NotTrusted
    })
}

fn text(found: &Checked, answer: LimitAnswer, robot: &str, within_mm: f64) -> String {
    let error = |e: &ExpectedError| {
        format!(
            "{:.2} mm in the mean (95 % interval {:.2} to {:.2} mm), {:.2} mm at 95 % of the workspace",
            e.mean, e.interval[0], e.interval[1], e.p95
        )
    };
    format!(
        "{} contacts: the spheres as {robot} sees them scatter by {:.2} mm (root mean square).\n\
         Error of the TCP over the workspace: {}.\n\
         With the tool that fits best:        {}.\n\
         The contacts look like those of {}.\n\n{}",
        found.contacts,
        found.scatter_mm,
        error(&found.error_mm),
        error(&found.arm_error_mm),
        found.expectation.words(),
        answer.words(robot, within_mm)
    )
}
