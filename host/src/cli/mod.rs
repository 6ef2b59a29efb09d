//! The command line.
//!
//! ```text
//!   arguments ─▶ Config ─▶ job (prepare ─ measure ─ evaluate ─ write) ─▶ tables, files, exit code
//! ```
//!
//! Results go to stdout, everything else (progress, logs, errors) to stderr.
//! Exit codes: 0 done; 1 the job failed; 2 wrong usage or input; 3 finished,
//! but the result is not to be trusted.

mod args;
mod exit;
mod identify;
mod person;
mod plan;
mod progress;
mod robot;
mod run;
mod servers;
mod stages;
mod studies;
mod teach;
mod text;

use std::process::ExitCode;

use clap::Parser;
use tracing_subscriber::EnvFilter;

pub use args::{Cli, Command, RunArgs};
pub use exit::{CliError, Exit};

/// Runs the program with the process's arguments.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    log_to_stderr(cli.verbose);
    let result = match cli.command {
        None => run::run(&cli.run),
        Some(Command::Run(args)) => run::run(&args),
        Some(Command::Plan(args)) => plan::run(&args),
        Some(Command::Measure(args)) => stages::measure(&args),
        Some(Command::Teach(args)) => teach::run(&args),
        Some(Command::Identify(args)) => identify::run(&args),
        Some(Command::Validate(args)) => stages::validate(&args),
        Some(Command::Report(args)) => stages::report(&args),
        Some(Command::Robot(args)) => robot::run(&args),
        Some(Command::Plant(args)) => servers::plant(&args),
        Some(Command::Controller(args)) => servers::controller(&args),
        Some(Command::Reproduce(args)) => studies::reproduce(&args),
        Some(Command::Worlds(args)) => studies::worlds(&args),
        Some(Command::Config(args)) => stages::config(&args),
    };
    match result {
        Ok(exit) => exit.into(),
        Err(error) => {
            eprintln!("{}: {error}", console_name());
            error.exit().into()
        }
    }
}

fn console_name() -> &'static str {
    "spherecal"
}

/// Logs go to stderr; `SPHERECAL_LOG` or `-v` says how much.
fn log_to_stderr(verbose: u8) {
    let level = match verbose {
        0 => "warn",
        1 => "spherecal=info",
        2 => "spherecal=debug",
        _ => "trace",
    };
    let filter = EnvFilter::try_from_env("SPHERECAL_LOG").unwrap_or_else(|_| EnvFilter::new(level));
    // A second subscriber is refused; the first then stays, which is what is wanted.
    let _ = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_target(false)
        .try_init();
}
