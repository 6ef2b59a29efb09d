//! The commands.

use std::path::Path;

use clap::{Command, Parser, Subcommand};

use super::args::{RunArgs, StoredArgs};
use super::certificate::CertificateArgs;
use super::check::CheckArgs;
use super::collect::CollectArgs;
use super::commission::CommissionArgs;
use super::doctor::DoctorArgs;
use super::export::ExportArgs;
use super::history::{HistoryArgs, TrendArgs};
use super::identify::IdentifyArgs;
use super::impedance::ImpedanceArgs;
use super::init_given::InitArgs;
use super::robot::RobotArgs;
use super::robot_sides::PlantArgs;
use super::serve::ServeArgs;
use super::servers::{ConformArgs, ControllerArgs};
use super::shell::{CompletionsArgs, ManArgs};
use super::stability::StabilityArgs;
use super::stages::ConfigArgs;
use super::store::StoreArgs;

const EXAMPLES: &str = "\
Examples:
  spherecal                              calibrate a simulated iiwa 7 and show the remaining error
  spherecal init                         write cell.toml for a cell of your own: asks, and checks the answers
  spherecal run --seed 3 --poses 60      another arm, fewer poses
  spherecal run --paper                  the paper's whole pose grid
  spherecal run --resume                 continue a run that was stopped
  spherecal run --json | jq .validation  one JSON document, for programs
  spherecal identify --robot ur5e --data poses.csv   calibrate any robot from a table
  spherecal robot show iiwa7             table, limits and masses of a robot

Exit codes: 0 done; 1 the job failed; 2 wrong usage or input;
3 finished, but the result must not be used.";

/// The commands in the help of the program: the title of a group, those with their line, and those by name.
const GROUPS: [(&str, &[&str], &[&str]); 5] = [
    (
        "Calibrate",
        &["init", "run", "identify", "check", "certificate"],
        &["plan", "teach", "measure", "validate", "stability"],
    ),
    ("Look", &["report", "history"], &["trend", "export"]),
    ("Robot", &["robot"], &["commission", "collect", "impedance"]),
    ("Serve", &["serve"], &["plant", "controller", "conform"]),
    ("More", &["doctor"], &["config", "store", "completions", "man"]),
];

/// The command line with its commands in groups. `clap` has one list of them.
pub(super) fn grouped(command: Command) -> Command {
    let mut list = String::new();
    for (title, shown, named) in GROUPS {
        list += &format!("{title}:\n");
        for name in shown {
            let about = command.find_subcommand(name).and_then(Command::get_about);
            let about = about.map(ToString::to_string).unwrap_or_default();
            list += &format!("  {name:<12} {about}\n");
        }
        if !named.is_empty() {
            list += &format!("  also: {}\n", named.join(", "));
        }
        list.push('\n');
    }
    // Hidden, they are not listed a second time, among the options.
    let command = command.mut_subcommands(|subcommand| subcommand.hide(true));
    command.help_template(format!(
        "{{before-help}}{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{list}`spherecal COMMAND --help` explains a \
         command.\n\n{{all-args}}{{after-help}}"
    ))
}

/// A robot arm calibrates itself by touching three precision spheres.
///
/// Without a command, spherecal runs the whole job with its defaults: plan the poses, measure them
/// with the real controller on a simulated arm, identify the robot, validate the result against a
/// simulated laser tracker, write a report.
#[derive(Debug, Parser)]
#[command(name = "spherecal", version, about, after_help = EXAMPLES, args_conflicts_with_subcommands = true)]
pub struct Cli {
    /// Command; without one, the whole job.
    #[command(subcommand)]
    pub command: Option<CliCommand>,
    /// Arguments of the whole job.
    #[command(flatten)]
    pub run: RunArgs,
    /// Log more (-v, -vv). The environment variable SPHERECAL_LOG takes a filter.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum CliCommand {
    /// Write the files of a first cell: cell.toml, plate.toml and poses.csv.
    Init(Box<InitArgs>),
    /// Run the whole job: plan, measure, identify, validate, report.
    #[command(
        after_help = "Examples: spherecal run --seed 2 --poses 60 --out second-arm\n          \
                            spherecal run --serve 7404      and look at http://127.0.0.1:7404/ meanwhile"
    )]
    Run(RunArgs),
    /// Plan the poses and print their cost; writes plan.json.
    #[command(
        after_help = "Examples: spherecal plan --poses 60 --out small\n          spherecal plan --accuracy-mm 0.2"
    )]
    Plan(RunArgs),
    /// Plan, and measure into the database; identifies nothing.
    #[command(after_help = "Example: spherecal measure --out cell-4 && spherecal validate --out cell-4")]
    Measure(RunArgs),
    /// Lead the arm over each sphere by hand and store its position; writes waypoints.toml.
    #[command(after_help = "Example: spherecal teach --out cell-4 && \
                            spherecal run --waypoints cell-4/waypoints.toml --out cell-4")]
    Teach(RunArgs),
    /// Commission a robot: its first run, in five steps, with a person at the robot.
    Commission(Box<CommissionArgs>),
    /// Hold the arm by a Cartesian spring, and set it live.
    Impedance(Box<ImpedanceArgs>),
    /// Guide the arm by hand, and collect its contacts for `identify`; commands no torque.
    Collect(Box<CollectArgs>),
    /// Tell from a dozen contacts how wrong the robot's forward kinematics is.
    Check(Box<CheckArgs>),
    /// Hold still for long at some poses, and check whether recordings of one second are long
    /// enough; writes stability.html and stability.json.
    #[command(after_help = "Example: spherecal stability --hold-s 30 --places 4 --out cell-4")]
    Stability(StabilityArgs),
    /// Identify any robot from a table of poses (CSV).
    Identify(Box<IdentifyArgs>),
    /// Identify the last run of --out, and print its validation table.
    #[command(after_help = "Example: spherecal validate --out cell-4")]
    Validate(StoredArgs),
    /// Identify the last run of --out again, and write all of its files.
    #[command(after_help = "Example: spherecal report --out cell-4")]
    Report(StoredArgs),
    /// Write the certificate of an accepted result.
    Certificate(CertificateArgs),
    /// Write a run as tables: Parquet or CSV.
    #[command(after_help = "Example: spherecal export --csv --out cell-4 && \
                            spherecal identify --robot iiwa7 --data cell-4/tables/poses.csv --plate paper")]
    Export(ExportArgs),
    /// List, show or convert robots.
    #[command(
        after_help = "Examples: spherecal robot list\n          spherecal robot show ur5e\n          \
                            spherecal robot convert arm.urdf arm.toml"
    )]
    Robot(RobotArgs),
    /// Serve the simulated arm to any controller over the drive link (docs/drive-link.md).
    #[command(after_help = "Example: spherecal plant --listen 7401 --seed 2\n         \
                            spherecal run --link tcp:127.0.0.1:7401 --seed 2")]
    Plant(PlantArgs),
    /// Run the controller as a separate process, between a drive and a host.
    #[command(
        after_help = "Example: spherecal controller --drive tcp:127.0.0.1:7401 --host-link tcp:127.0.0.1:7402\n         \
                            spherecal run --link controller:127.0.0.1:7402"
    )]
    Controller(ControllerArgs),
    /// Serve robot, laser tracker, database and a web page of all runs to other machines.
    ///
    /// The services are gRPC (Figure 4 of the paper). The page shows current runs and past calibrations.
    #[command(after_help = "Example: spherecal serve --grpc 7403 --seed 2\n         \
                            spherecal run --link grpc:127.0.0.1:7403 --tracker grpc:127.0.0.1:7403 --store grpc:127.0.0.1:7403")]
    Serve(Box<ServeArgs>),
    /// List past calibrations.
    #[command(after_help = "Example: spherecal history --store postgres://robots@db/fleet --arm A-17")]
    History(HistoryArgs),
    /// Check whether an arm drifts, and when its next calibration is due.
    #[command(after_help = "Example: spherecal trend --arm A-17 --limit-mm 0.3")]
    Trend(TrendArgs),
    /// Print or check the configuration: every field with its meaning and value.
    #[command(after_help = "Example: spherecal config --print > cell.toml && spherecal run --config cell.toml")]
    Config(ConfigArgs),
    /// Ask a foreign drive or controller for each sentence of the links' documentation.
    #[command(after_help = "Examples: spherecal conform --drive 127.0.0.1:7401\n          \
                            spherecal conform --controller 127.0.0.1:7402 --json | jq .sentences")]
    Conform(ConformArgs),
    /// Check what this machine has and lacks, and name the remedies.
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
    /// Check a database, or save the readable data of a damaged one.
    #[command(
        after_help = "Examples: spherecal store check spherecal-out/calibration.db\n          \
                            spherecal store recover spherecal-out/calibration.db saved/calibration.db"
    )]
    Store(StoreArgs),
}

impl CliCommand {
    /// The folder that the command writes its results into.
    pub(super) fn results(&self) -> Option<&Path> {
        Some(match self {
            Self::Run(args) | Self::Measure(args) | Self::Plan(args) | Self::Teach(args) => &args.out,
            Self::Init(args) => &args.out,
            Self::Stability(args) => &args.run.out,
            Self::Commission(args) if !args.show => &args.run.out,
            Self::Impedance(args) => &args.run.out,
            Self::Identify(args) => &args.out,
            Self::Validate(args) | Self::Report(args) => &args.out,
            Self::Export(args) => &args.out,
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    // Fails if a command is in no group or in two, if a group names one that does not exist, or if more than ten commands
    // have a line of their own.
    #[test]
    fn every_command_is_in_one_group() {
        let command = Cli::command();
        let mut all: Vec<&str> = command.get_subcommands().map(Command::get_name).collect();
        let mut grouped: Vec<&str> = GROUPS.iter().flat_map(|g| [g.1, g.2].concat()).collect();
        all.sort_unstable();
        grouped.sort_unstable();
        assert_eq!(grouped, all);
        assert!(GROUPS.iter().map(|g| g.1.len()).sum::<usize>() <= 10);
        let help = super::grouped(command).render_long_help().to_string();
        let screen: Vec<&str> = help.lines().take(34).collect();
        assert!(screen.iter().all(|line| line.chars().count() <= 100), "{screen:#?}");
        for line in ["Calibrate:", "  also: config, store, completions, man"] {
            assert!(screen.contains(&line), "{line} in {help}");
        }
    }
}
