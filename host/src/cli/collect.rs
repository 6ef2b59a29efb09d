//! `spherecal collect`: contacts of an arm that the user guides by hand.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use spherecal_campaign::collect::{
    CollectRequest, CollectView, ContactFile, ContactRow, StillPose, StillRules, Visits, collect,
};
use spherecal_identify::Options;
use spherecal_identify::study::PAPER_PLATE;
use spherecal_job::Link;
use spherecal_link::{DriveReader, FrankaReader, KukaReader, StateReader, UrReader};
use spherecal_model::chain::Chain;
use spherecal_model::input::{read_plate_file, triple};
use spherecal_model::{paper_plate, robots};
use spherecal_plan::PoseAdvice;

use super::args::BadValue;
use super::exit::{CliError, Exit, interrupt};
use super::out::{errln, outln};
use super::own_calibration::own_robot;
use super::progress::TerminalOperator;

/// Collect contacts while you guide the arm by hand, into the table that `identify` takes.
///
/// It only reads: no torque is commanded and no motion is started. Start the robot's own hand guiding,
/// set the tool's nest on the spheres in the order that is shown, and hold still for 1.5 s at each pose.
/// Press Enter at the first pose on each sphere; the next ones there are taken when the arm is still.
/// Turn the tool much between two poses on a sphere.
///
/// Each pose is on the disk before the next one is taken. The same command goes on where the table ends.
#[derive(Args, Clone, Debug)]
#[command(
    after_help = "Example: spherecal collect --link franka:172.16.0.2 --tool-mm 0,0,120 --out contacts.csv && \
    spherecal identify --robot panda --data contacts.csv --plate paper --tool-mm 0,0,120\n\n\
    Exit codes: 0 all poses are in the table; 1 failed or stopped before; 2 wrong input."
)]
pub struct CollectArgs {
    /// The arm: franka:HOST, fri:PORT, ur:HOST or tcp:HOST:PORT.
    #[arg(long, value_name = "LINK", value_parser = arm_link)]
    pub link: Link,
    /// Built-in name, FILE.toml or FILE.urdf. Default: panda or fr3 as the Franka robot says; iiwa7 with fri:; with ur: the
    /// robot as it computes itself, its factory calibration included, which is written beside the table.
    #[arg(long, value_name = "NAME|FILE")]
    pub robot: Option<String>,
    /// Nominal TCP (the centre of the nest's sphere) in the flange frame, in mm. Default: the robot's own.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub tool_mm: Option<String>,
    /// Certificate of the plate, or `paper` for Table 1 of the paper.
    #[arg(long, value_name = "FILE.toml", default_value = PAPER_PLATE)]
    pub plate: PathBuf,
    /// Placements of the plate.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=32))]
    pub places: u32,
    /// Poses in all, spread evenly over spheres and placements.
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub poses: u32,
    /// Take a pose only after Enter.
    #[arg(long, conflicts_with = "auto")]
    pub key: bool,
    /// Take every still pose without Enter, also the first one on a sphere.
    #[arg(long)]
    pub auto: bool,
    /// Time at rest before the average of 1 s begins, in s.
    #[arg(long, value_name = "S", default_value_t = 0.5, value_parser = seconds)]
    pub settle_s: f64,
    /// Time without a new still pose after which it ends, in s.
    #[arg(long, value_name = "S", default_value_t = 600.0, value_parser = seconds)]
    pub wait_s: f64,
    /// Expect the errors of an arm without a factory calibration when the accuracy is predicted. Always so with franka:,
    /// unless --robot names a file.
    #[arg(long)]
    pub uncalibrated: bool,
    /// Table of the contacts; a table that exists is continued.
    #[arg(long, value_name = "FILE.csv", default_value = "contacts.csv")]
    pub out: PathBuf,
    /// Print one JSON document at the end; progress goes to stderr.
    #[arg(long)]
    pub json: bool,
}

/// The links to arms whose states can be read.
const ARMS: &str = "give franka:HOST, fri:PORT, ur:HOST or tcp:HOST:PORT";

/// A link to an arm whose states can be read.
pub(super) fn arm_link(text: &str) -> Result<Link, BadValue> {
    match text.parse() {
        Ok(link @ (Link::Tcp(_) | Link::Franka { .. } | Link::Fri(_) | Link::Ur { .. })) => Ok(link),
        _ => Err(BadValue(ARMS)),
    }
}

pub(super) fn seconds(text: &str) -> Result<f64, BadValue> {
    match text.parse() {
        Ok(s) if (0.1..=3600.0).contains(&s) => Ok(s),
        _ => Err(BadValue("give 0.1 to 3600 seconds")),
    }
}

/// The reader behind the link, and the robot that it is, where it says so: a built-in name, or a file that is written now.
fn open(args: &CollectArgs) -> Result<(Box<dyn StateReader>, Option<String>), CliError> {
    Ok(match &args.link {
        Link::Franka { host, port } => {
            let reader = FrankaReader::connect(host, *port)?;
            let robot = reader.robot();
            (Box::new(reader), Some(robot.to_owned()))
        }
        Link::Fri(address) => (Box::new(KukaReader::listen(*address)?), Some("iiwa7".to_owned())),
        Link::Ur { host, port } => {
            let reader = UrReader::connect(host, *port)?;
            let robot = match &args.robot {
                Some(_) => None,
                None => Some(own_robot(&reader, &args.out)?),
            };
            (Box::new(reader), robot)
        }
        Link::Tcp(address) => (Box::new(DriveReader::connect(address)?), None),
        _ => return Err(CliError::input(format!("--link: {ARMS}"))),
    })
}

/// What the user sees.
struct Terminal {
    operator: TerminalOperator,
    key: bool,
    auto: bool,
    /// The next pose waits for Enter.
    waits: bool,
    visits: Visits,
    place: u32,
    advice: PoseAdvice,
    chain: Chain,
    largest_spread_rad: f64,
}

impl Terminal {
    /// The joint that covers the least part of its range, from 1, and that part.
    fn least_covered(&self, contacts: &[ContactRow]) -> Option<(usize, f64)> {
        coverage(&self.chain, contacts)
            .into_iter()
            .zip(1..)
            .map(|(part, joint)| (joint, part))
            .min_by(|a, b| a.1.total_cmp(&b.1))
    }
}

/// Which part of each joint's range the contacts cover, from 0 to 1.
fn coverage(chain: &Chain, contacts: &[ContactRow]) -> Vec<f64> {
    let part = |(j, limit): (usize, &spherecal_shared::robot::JointLimits)| {
        let angles = || contacts.iter().filter_map(|c| c.q.get(j)).copied();
        let (low, high) = (
            angles().fold(f64::INFINITY, f64::min),
            angles().fold(f64::NEG_INFINITY, f64::max),
        );
        ((high - low) / (limit.max_rad - limit.min_rad)).max(0.0)
    };
    chain.limits().iter().enumerate().map(part).collect()
}

impl CollectView for Terminal {
    fn wants(&mut self, place: u32, sphere: u32, contacts: &[ContactRow]) {
        if std::mem::replace(&mut self.place, place) != place {
            errln!("Place {place}: put the plate there, and do not move it until the next place.");
        }
        while self.operator_entered() {}
        self.waits = !self.auto;
        let enter = if self.waits { " and press Enter" } else { "" };
        errln!(
            "Set the tool on sphere {sphere}{enter} ({} of {} poses are kept).",
            contacts.len(),
            self.visits.poses
        );
    }

    fn kept(&mut self, pose: &StillPose, contacts: &[ContactRow]) {
        self.largest_spread_rad = self.largest_spread_rad.max(pose.spread_rad);
        self.waits = self.key;
        let Some(last) = contacts.last() else { return };
        self.advice.add(&last.q, last.sphere, last.place as usize - 1);
        errln!(
            "kept {} of {}: spread {:.0} µrad over {} readings; the TCP is then expected to be known to {:.2} mm",
            contacts.len(),
            self.visits.poses,
            pose.spread_rad * 1e6,
            pose.readings,
            self.advice.expected_m() * 1e3
        );
        if let Some((joint, part)) = self.least_covered(contacts) {
            errln!("  joint {joint} covers least of its range: {:.0} %", part * 100.0);
        }
        if self.visits.next(contacts) != Some((last.place, last.sphere)) {
            return;
        }
        if let Some(best) = self.advice.suggest(&last.q, last.sphere, last.place as usize - 1) {
            let angles: Vec<String> = best.joints.iter().map(|q| format!("{:.0}", q.to_degrees())).collect();
            errln!(
                "  most useful next on this sphere: joints near {} degrees (it removes {:.0} % of the variance)",
                angles.join(", "),
                best.gain * 100.0
            );
        }
    }

    fn refused(&mut self, place: u32, sphere: u32, distance_m: f64) {
        self.waits = self.key;
        errln!(
            "not kept: the tool is {:.0} mm from the other contacts on sphere {sphere} in place {place}: set it on that \
             sphere",
            distance_m * 1e3
        );
    }

    fn ready(&mut self) -> bool {
        if !self.waits {
            return true;
        }
        let entered = self.operator_entered();
        self.waits = !entered;
        entered
    }
}

impl Terminal {
    fn operator_entered(&mut self) -> bool {
        !self.auto && self.operator.entered()
    }
}

pub(super) struct Gathered {
    /// The robot: what was asked for, else what is connected.
    pub(super) robot: String,
    /// All poses are in the table.
    pub(super) done: bool,
    /// Poses in the table.
    count: usize,
    /// Those of them that were added now.
    pub(super) new: usize,
    uncalibrated: bool,
    largest_spread_rad: f64,
    coverage: Vec<f64>,
    expected_mm: f64,
}

/// Collects into the table of `args`.
/// Errors: wrong input, or collecting failed.
pub(super) fn gather(args: &CollectArgs) -> Result<Gathered, CliError> {
    let spheres = if args.plate.as_os_str() == PAPER_PLATE {
        paper_plate()
    } else {
        read_plate_file(&args.plate).map_err(CliError::input)?.spheres
    };
    let (mut reader, connected) = open(args)?;
    let name = args.robot.as_deref().or(connected.as_deref()).ok_or_else(|| {
        CliError::input("--robot: a drive link does not tell which robot it is: give its name or file")
    })?;
    let mut model = robots::load_driven(name).map_err(CliError::input)?;
    if let (Some(asked), Some(found)) = (&args.robot, &connected)
        && matches!(args.link, Link::Franka { .. })
        && robots::built_in(asked).is_some()
        && asked != found
    {
        return Err(CliError::input(format!(
            "--robot {asked}: the connected robot is a {found}: leave the option out, or give its own file"
        )));
    }
    if let Some(text) = &args.tool_mm {
        model.tool.tcp_m = triple("--tool-mm", text, 2000.0)
            .map_err(CliError::input)?
            .map(|mm| mm / 1e3);
    }
    let tool = model.tool_in_table();
    let chain = Chain::new(&model.robot, &tool)?;
    let mut table = ContactFile::open(&args.out, reader.joints(), reader.has_torques()).map_err(CliError::input)?;
    let visits = Visits {
        spheres: spheres.iter().map(|s| s.id).collect(),
        places: args.places,
        poses: args.poses,
    };
    let uncalibrated =
        args.uncalibrated || (matches!(args.link, Link::Franka { .. }) && robots::built_in(name).is_some());
    let mut options = Options::default();
    if uncalibrated {
        options.parameters.expect_uncalibrated();
    }
    let advice = PoseAdvice::new(&model.robot, &tool, &spheres, args.places, &options);
    let mut view = Terminal {
        operator: TerminalOperator::default(),
        key: args.key,
        auto: args.auto,
        waits: false,
        visits: visits.clone(),
        place: 0,
        advice: advice.map_err(CliError::input)?,
        chain: chain.clone(),
        largest_spread_rad: 0.0,
    };
    for contact in table.contacts() {
        if (1..=args.places).contains(&contact.place) {
            view.advice.add(&contact.q, contact.sphere, contact.place as usize - 1);
        }
    }
    let request = CollectRequest {
        visits,
        rules: StillRules {
            settle_s: args.settle_s,
            ..StillRules::default()
        },
        patience: Duration::from_secs_f64(args.wait_s),
    };
    let interrupt = interrupt()?;
    let before = table.contacts().len();
    let done = collect(reader.as_mut(), &chain, &mut table, &request, &mut view, &interrupt).map_err(CliError::job)?;
    let count = table.contacts().len();
    Ok(Gathered {
        robot: name.to_owned(),
        done,
        count,
        new: count - before,
        uncalibrated,
        largest_spread_rad: view.largest_spread_rad,
        coverage: coverage(&chain, table.contacts()),
        expected_mm: view.advice.expected_m() * 1e3,
    })
}

pub(super) fn run(args: &CollectArgs) -> Result<Exit, CliError> {
    let found = gather(args)?;
    let file = args.out.display();
    if args.json {
        let document = serde_json::json!({
            "command": "collect", "robot": found.robot, "file": args.out, "poses": found.count, "complete": found.done,
            "largest_spread_rad": found.largest_spread_rad, "coverage": found.coverage,
            "expected_mm": found.expected_mm, "uncalibrated": found.uncalibrated,
        });
        outln!("{document:#}");
    } else {
        outln!("{} contacts are in {file}", found.count);
        if found.done {
            let tool = args.tool_mm.as_ref().map(|t| format!(" --tool-mm {t}"));
            outln!(
                "\nNext: spherecal identify --robot {} --data {file} --plate {}{}",
                found.robot,
                args.plate.display(),
                tool.unwrap_or_default()
            );
        }
    }
    Ok(if found.done { Exit::Done } else { Exit::Failed })
}
