//! The command line of `spherecal-lab`. Exit codes are those of `spherecal`.

mod faults;
mod sharding;
mod soak;
mod studies;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use spherecal::cli::{finish, parse, print_usage};

use faults::FaultsArgs;
use soak::SoakArgs;
use studies::{ReproduceArgs, WorldsArgs};

const EXIT_CODES: &str = "\
Exit codes: 0 done; 1 the study failed; 2 wrong usage or input;
3 finished, but the result must not be used.";

/// Studies of a robot calibration: estimators and plans on synthetic robots, the paper's tables, faults, long runs.
#[derive(Debug, Parser)]
#[command(name = "spherecal-lab", version, about, after_help = EXIT_CODES)]
pub struct LabCli {
    /// Study.
    #[command(subcommand)]
    pub study: Study,
    /// Log more (-v, -vv). The environment variable SPHERECAL_LOG takes a filter.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
}

/// The studies.
#[derive(Debug, Subcommand)]
pub enum Study {
    /// Repeat the paper's study on the last run of --out, or on a synthetic robot: tables and
    /// figures beside the published numbers.
    #[command(
        after_help = "Examples: spherecal-lab reproduce --world W1 --seed 3 --out study\n          \
                            spherecal-lab reproduce --world W1 --robots 1000 --shard 3/50 --out study\n          \
                            spherecal-lab reproduce --merge --out study"
    )]
    Reproduce(ReproduceArgs),
    /// Compare the estimators, or the plans, on the synthetic worlds W0 to W5.
    #[command(
        after_help = "Examples: spherecal-lab worlds --world W0 --world W3 --seeds 4\n          spherecal-lab worlds --plan\n          \
                      spherecal-lab worlds --seeds 1000000 --shard 17/1000 --out study\n          \
                      spherecal-lab worlds --merge --rows parquet --out study"
    )]
    Worlds(WorldsArgs),
    /// Inject every fault at random instants, and check how each run ends.
    #[command(after_help = "Examples: spherecal-lab faults --list\n          \
                            spherecal-lab faults --show human_push > push.toml && spherecal run --inject push.toml\n          \
                            spherecal-lab faults --instants 20 --seeds 3\n          \
                            spherecal-lab faults --campaign 1000\n          \
                            spherecal-lab faults --campaign 100000 --shard 17/100 --out study\n          \
                            spherecal-lab faults --campaign 100000 --merge --out study")]
    Faults(FaultsArgs),
    /// Run the same simulated cell for hours of robot time, and report growth and drift.
    #[command(after_help = "Example: spherecal-lab soak --hours 24 --out soak")]
    Soak(SoakArgs),
}

/// Runs the program with the process's arguments.
pub fn main() -> ExitCode {
    let exit = match parse::<LabCli>(std::env::args_os()) {
        Ok(cli) => finish("spherecal-lab", cli.verbose, || match cli.study {
            Study::Reproduce(args) => studies::reproduce(&args),
            Study::Worlds(args) => studies::worlds(&args),
            Study::Faults(args) => faults::run(&args),
            Study::Soak(args) => soak::run(&args),
        }),
        Err(error) => print_usage(&error),
    };
    exit.into()
}
