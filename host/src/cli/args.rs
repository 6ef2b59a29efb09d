//! Commands and their arguments.

use std::path::{Path, PathBuf};

use clap::{Args, Parser, Subcommand};

use super::doctor::DoctorArgs;
use super::export::ExportArgs;
use super::faults::FaultsArgs;
use super::history::{HistoryArgs, TrendArgs};
use super::identify::IdentifyArgs;
use super::robot::RobotArgs;
use super::serve::ServeArgs;
use super::servers::{ControllerArgs, PlantArgs};
use super::shell::{CompletionsArgs, ManArgs};
use super::soak::SoakArgs;
use super::stability::StabilityArgs;
use super::stages::ConfigArgs;
use super::store::StoreArgs;
use super::studies::{ReproduceArgs, WorldsArgs};
use crate::job::{self, Config, JobError, Link, Prepared, Waypoints};
use crate::rpc::{GuardFiles, Peer};
use crate::store::Place;

const EXAMPLES: &str = "\
Examples:
  spherecal                              calibrate a simulated iiwa 7 and show how good it is
  spherecal run --seed 3 --poses 60      another arm, fewer poses
  spherecal run --paper                  the paper's whole pose grid
  spherecal run --resume                 go on where a run was stopped
  spherecal run --json | jq .validation  one JSON document, for programs
  spherecal identify --robot ur5e --data poses.csv   calibrate any robot from a table
  spherecal robot show iiwa7             what is known of a robot

Exit codes: 0 done; 1 the job failed; 2 wrong usage or input;
3 finished, but the result is not to be trusted.";

/// A robot arm calibrates itself by touching three precision spheres.
///
/// Without a command it runs the whole job with its defaults: plan, measure with
/// the real controller on a simulated arm, identify, validate against a laser
/// tracker, report.
#[derive(Debug, Parser)]
#[command(name = "spherecal", version, about, after_help = EXAMPLES, args_conflicts_with_subcommands = true)]
pub struct Cli {
    /// What to do; the whole job if nothing is said.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// Arguments of the whole job.
    #[command(flatten)]
    pub run: RunArgs,
    /// Log more (-v, -vv); the variable SPHERECAL_LOG takes a filter.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// The whole job: plan, measure, identify, validate, report.
    #[command(
        after_help = "Examples: spherecal run --seed 2 --poses 60 --out second-arm\n          \
                            spherecal run --serve 7404      and look at http://127.0.0.1:7404/ meanwhile"
    )]
    Run(RunArgs),
    /// Plan the poses and say what they cost; writes plan.json.
    #[command(
        after_help = "Examples: spherecal plan --poses 60 --out small\n          spherecal plan --accuracy-mm 0.2"
    )]
    Plan(RunArgs),
    /// Plan and measure into the database; nothing is identified.
    #[command(after_help = "Example: spherecal measure --out cell-4 && spherecal validate --out cell-4")]
    Measure(RunArgs),
    /// Lead the arm over each sphere by hand and keep where it stood; writes waypoints.toml.
    #[command(after_help = "Example: spherecal teach --out cell-4 && \
                            spherecal run --waypoints cell-4/waypoints.toml --out cell-4")]
    Teach(RunArgs),
    /// Hold long at some of the poses and tell whether one second would have done;
    /// writes stability.html and stability.json.
    #[command(after_help = "Example: spherecal stability --hold-s 30 --places 4 --out cell-4")]
    Stability(StabilityArgs),
    /// Identify any robot from a table of poses (CSV).
    Identify(Box<IdentifyArgs>),
    /// Identify the last run of --out, and print its validation table.
    #[command(after_help = "Example: spherecal validate --out cell-4")]
    Validate(StoredArgs),
    /// Write all files of the last run of --out anew.
    #[command(after_help = "Example: spherecal report --out cell-4")]
    Report(StoredArgs),
    /// Write a run as tables: Parquet or CSV.
    #[command(after_help = "Example: spherecal export --csv --out cell-4 && \
                            spherecal identify --robot iiwa7 --data cell-4/tables/poses.csv")]
    Export(ExportArgs),
    /// List, show or convert robots.
    Robot(RobotArgs),
    /// Offer the simulated arm to any controller over the drive link (docs/drive-link.md).
    #[command(after_help = "Example: spherecal plant --listen 7401 --seed 2\n         \
                            spherecal run --link tcp:127.0.0.1:7401 --seed 2")]
    Plant(PlantArgs),
    /// Run the controller as a process of its own, between a drive and a host.
    #[command(
        after_help = "Example: spherecal controller --drive tcp:127.0.0.1:7401 --host-link tcp:127.0.0.1:7402\n         \
                            spherecal run --link controller:127.0.0.1:7402"
    )]
    Controller(ControllerArgs),
    /// Offer robot, laser tracker and database as network services (gRPC, Figure 4 of the paper),
    /// and a web page with the runs that go on and those of the past.
    #[command(after_help = "Example: spherecal serve --grpc 7403 --seed 2\n         \
                            spherecal run --link grpc:127.0.0.1:7403 --tracker grpc:127.0.0.1:7403 --store grpc:127.0.0.1:7403")]
    Serve(Box<ServeArgs>),
    /// List past calibrations.
    #[command(after_help = "Example: spherecal history --store postgres://robots@db/fleet --arm A-17")]
    History(HistoryArgs),
    /// Say whether an arm is drifting, and when its next calibration is due.
    #[command(after_help = "Example: spherecal trend --arm A-17 --limit-mm 0.3")]
    Trend(TrendArgs),
    /// The paper's study on the last run of --out, or on a synthetic robot:
    /// tables and figures beside the published numbers.
    #[command(after_help = "Example: spherecal reproduce --world W1 --seed 3 --out study")]
    Reproduce(ReproduceArgs),
    /// Compare the estimators, or the plans, over the synthetic worlds W0 to W4.
    #[command(
        after_help = "Examples: spherecal worlds --world W0 --world W3 --seeds 4\n          spherecal worlds --plan"
    )]
    Worlds(WorldsArgs),
    /// Inject every fault there is, at random instants, and say what becomes of it.
    #[command(after_help = "Examples: spherecal faults --list\n          \
                            spherecal faults --show human_push > push.toml && spherecal run --inject push.toml\n          \
                            spherecal faults --instants 20 --seeds 3\n          \
                            spherecal faults --campaign 1000")]
    Faults(FaultsArgs),
    /// Print the configuration: every field, what it is, and its value.
    #[command(after_help = "Example: spherecal config --print > cell.toml && spherecal run --config cell.toml")]
    Config(ConfigArgs),
    /// Say what this machine has and lacks, and what to do about it.
    #[command(after_help = "Example: spherecal doctor --json | jq .checks")]
    Doctor(DoctorArgs),
    /// Print the completions of a shell.
    #[command(
        after_help = "Example: spherecal completions bash > ~/.local/share/bash-completion/completions/spherecal"
    )]
    Completions(CompletionsArgs),
    /// Print the manual page, or write one for each command.
    #[command(after_help = "Example: spherecal man --out ~/.local/share/man/man1")]
    Man(ManArgs),
    /// Check a database, or save what can be read of a damaged one.
    Store(StoreArgs),
    /// Run the same simulated cell for hours of robot time: what grows or drifts is told.
    #[command(after_help = "Example: spherecal soak --hours 24 --out soak")]
    Soak(SoakArgs),
}

/// Arguments of everything that plans or measures.
#[derive(Args, Clone, Debug)]
pub struct RunArgs {
    /// Seed of everything that is drawn: the arm's errors, noise, taught waypoints.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Poses over all spheres.
    #[arg(long, value_name = "N", conflicts_with = "paper")]
    pub poses: Option<usize>,
    /// As few poses as promise this mean error of the TCP, in mm.
    #[arg(long, value_name = "MM", conflicts_with_all = ["poses", "paper"])]
    pub accuracy_mm: Option<f64>,
    /// The paper's whole grid: 625 poses a sphere, as far as the arm reaches.
    #[arg(long)]
    pub paper: bool,
    /// How controller and arm are reached: sim, qemu, serial:DEVICE or serial:DEVICE@BAUD
    /// (a controller board), tcp:HOST:PORT
    /// (a drive: simulator or gateway), controller:HOST:PORT (`spherecal controller`),
    /// grpc:HOST:PORT or grpcs:HOST:PORT (`spherecal serve`).
    #[arg(long, value_name = "LINK", default_value_t = Link::Sim)]
    pub link: Link,
    /// Folder of the database and of all results.
    #[arg(long, value_name = "DIR", default_value = "spherecal-out")]
    pub out: PathBuf,
    /// Database: a file, postgres://USER@HOST/DATABASE or grpc:HOST:PORT;
    /// calibration.db in --out if none is given.
    #[arg(long, value_name = "STORE")]
    pub store: Option<Place>,
    /// Laser tracker behind gRPC: grpc:HOST:PORT or grpcs:HOST:PORT.
    #[arg(long, value_name = "PEER", value_parser = peer)]
    pub tracker: Option<Peer>,
    /// Which arm this is (serial number), for history and trend.
    #[arg(long, value_name = "NAME")]
    pub arm: Option<String>,
    /// Configuration; it names only what differs from the defaults (`spherecal config --print` has them all).
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Begin the descents where `spherecal teach` found the spheres.
    #[arg(long, value_name = "FILE.toml")]
    pub waypoints: Option<PathBuf>,
    /// Let things go wrong: a preset (`spherecal faults --list`) or a file (`spherecal faults --show PRESET`).
    #[arg(long, value_name = "FILE.toml|PRESET")]
    pub inject: Option<String>,
    /// Go on with the last run of --out, at the pose where it was.
    #[arg(long, conflicts_with_all = ["poses", "accuracy_mm", "paper", "config", "seed", "waypoints"])]
    pub resume: bool,
    /// Show the run on the whole terminal: phase, force, joints, what is found so far.
    #[arg(long)]
    pub dashboard: bool,
    /// Show the run on a web page here, as long as it goes on; a port alone is on this machine only, 0 takes any.
    #[arg(long, value_name = "[HOST:]PORT")]
    pub serve: Option<String>,
    /// Protection of --serve.
    #[command(flatten)]
    pub protection: ProtectionArgs,
    /// Show the run on the page of `spherecal serve` there: grpc:HOST:PORT or grpcs:HOST:PORT.
    /// It is shown without this where --store or --link is such a server.
    #[arg(long, value_name = "PEER", value_parser = peer)]
    pub publish: Option<Peer>,
    /// Print one JSON document on stdout and nothing else.
    #[arg(long)]
    pub json: bool,
}

/// Files that protect what listens beyond this machine.
#[derive(Args, Clone, Debug, Default)]
pub struct ProtectionArgs {
    /// Certificate chain, PEM: clients then use grpcs, and browsers https.
    #[arg(long, value_name = "FILE.pem")]
    pub tls_cert: Option<PathBuf>,
    /// Private key of the certificate, PEM.
    #[arg(long, value_name = "FILE.pem")]
    pub tls_key: Option<PathBuf>,
    /// File with the token that clients must show (theirs is in SPHERECAL_TOKEN; the page asks for it).
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
}

impl ProtectionArgs {
    /// The files, as a server takes them.
    pub fn files(&self) -> GuardFiles {
        GuardFiles {
            certificate: self.tls_cert.clone(),
            key: self.tls_key.clone(),
            token: self.token_file.clone(),
        }
    }
}

/// The configuration of a file, or the defaults, with a seed of its own.
pub(super) fn base(file: Option<&Path>, seed: Option<u64>) -> Result<Config, JobError> {
    let mut config = file.map(Config::read).transpose()?.unwrap_or_default();
    if let Some(seed) = seed {
        config.seed = seed;
    }
    Ok(config)
}

impl RunArgs {
    /// The configuration that the arguments make, checked.
    ///
    /// # Errors
    /// A file or a value that cannot be used.
    pub fn configuration(&self) -> Result<Config, JobError> {
        let mut config = base(self.config.as_deref(), self.seed)?;
        if let Some(poses) = self.poses {
            if poses == 0 {
                return Err(crate::job::ConfigError::Range {
                    field: "--poses",
                    value: 0.0,
                    remedy: "ask for at least one pose, or for --paper",
                }
                .into());
            }
            config.plan.poses = poses;
            config.plan.paper = false;
            config.plan.accuracy_mm = None;
        }
        if self.accuracy_mm.is_some() {
            config.plan.accuracy_mm = self.accuracy_mm;
            config.plan.paper = false;
        }
        if self.paper {
            config.plan.paper = true;
        }
        if let Some(arm) = &self.arm {
            config.arm.clone_from(arm);
        }
        config.check()?;
        Ok(config)
    }

    /// The plan of that configuration, with the waypoints that were taught.
    ///
    /// # Errors
    /// Whatever is wrong with the input.
    pub fn prepare(&self) -> Result<Prepared, JobError> {
        let mut prepared = job::prepare(&self.configuration()?)?;
        if let Some(path) = &self.waypoints {
            Waypoints::read(path)?.apply(&mut prepared)?;
        }
        Ok(prepared)
    }

    /// The database.
    pub fn database(&self) -> Place {
        database(self.store.as_ref(), &self.out)
    }

    /// The server whose page shows the run.
    pub fn shown_by(&self) -> Option<Peer> {
        let store = match &self.store {
            Some(Place::Service(peer)) => Some(peer),
            _ => None,
        };
        let link = match &self.link {
            Link::Grpc(peer) => Some(peer),
            _ => None,
        };
        self.publish.as_ref().or(store).or(link).cloned()
    }
}

/// The store that was given, or the file in the folder of results.
fn database(store: Option<&Place>, out: &std::path::Path) -> Place {
    store
        .cloned()
        .unwrap_or_else(|| Place::File(out.join("calibration.db")))
}

/// `grpc:HOST:PORT` or `grpcs:HOST:PORT`.
fn peer(text: &str) -> Result<Peer, String> {
    Peer::parse(text).ok_or_else(|| "give grpc:HOST:PORT or grpcs:HOST:PORT".to_owned())
}

/// Arguments of what works on a stored run.
#[derive(Args, Clone, Debug)]
pub struct StoredArgs {
    /// Folder of the database and of all results.
    #[arg(long, value_name = "DIR", default_value = "spherecal-out")]
    pub out: PathBuf,
    /// Database: a file, postgres://USER@HOST/DATABASE or grpc:HOST:PORT;
    /// calibration.db in --out if none is given.
    #[arg(long, value_name = "STORE")]
    pub store: Option<Place>,
    /// Whose last run, in a database that several robots share.
    #[arg(long, value_name = "NAME", default_value = "")]
    pub arm: String,
    /// Print one JSON document on stdout and nothing else.
    #[arg(long)]
    pub json: bool,
}

impl StoredArgs {
    /// The database.
    pub fn database(&self) -> Place {
        database(self.store.as_ref(), &self.out)
    }
}
