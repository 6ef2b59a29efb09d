//! The command line.
//!
//! ```text
//!   arguments ─▶ Config ─▶ job (prepare ─ measure ─ evaluate ─ write) ─▶ tables, files, exit code
//! ```
//!
//! Results go to stdout; progress, logs and errors go to stderr. Exit codes: 0 done; 1 the job
//! failed; 2 wrong usage or input; 3 finished, but the result must not be used.

mod args;
mod bag;
mod certificate;
mod check;
mod collect;
mod command;
mod commission;
mod doctor;
mod doctor_realtime;
mod document;
mod exit;
mod export;
mod features;
mod history;
mod identify;
mod impedance;
mod init;
mod init_given;
mod init_questions;
mod limbs;
mod live_output;
pub mod out;
mod own_calibration;
mod progress;
mod robot;
mod robot_sides;
mod run;
mod serve;
mod servers;
mod shell;
mod stability;
mod stages;
mod store;
mod study;
mod table;
mod teach;
mod text;
mod ur_side;

use std::io::IsTerminal as _;
use std::process::ExitCode;

use clap::CommandFactory as _;
use clap::error::ContextKind;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

pub use args::RunArgs;
use command::grouped;
pub use command::{Cli, CliCommand};
pub use exit::{CliError, Exit, interrupt};
use out::errln;
pub use progress::ProgressView;

/// The studies that `spherecal-lab` runs, each by its command. Earlier versions of `spherecal` ran them.
const STUDIES: [&str; 4] = ["reproduce", "worlds", "faults", "soak"];

/// Runs the program with the process's arguments.
pub fn main() -> ExitCode {
    main_with(std::env::args_os()).into()
}

/// Runs the program with `arguments`, the first of which is the program's name: for a host
/// process that is not `spherecal`, such as a Python interpreter. Wrong usage is printed too.
pub fn main_with(arguments: impl IntoIterator<Item = std::ffi::OsString>) -> Exit {
    match parse_as::<Cli>(grouped(Cli::command()), arguments) {
        Ok(cli) => finish("spherecal", cli.verbose, || execute(cli)),
        Err(error) => {
            let asked = error.get(ContextKind::InvalidSubcommand).map(ToString::to_string);
            match asked.filter(|name| STUDIES.contains(&name.as_str())) {
                Some(name) => {
                    errln!("spherecal: `{name}` is a study: run `spherecal-lab {name}` (see docs/lab.md)");
                    Exit::Usage
                }
                None => print_usage(&error),
            }
        }
    }
}

/// The arguments, read. A negative number is a value, so that its refusal names its option.
///
/// # Errors
/// Wrong usage, or a request for the help or the version.
pub fn parse<C: clap::Parser>(arguments: impl IntoIterator<Item = std::ffi::OsString>) -> Result<C, clap::Error> {
    parse_as(C::command(), arguments)
}

/// The same with a command line that was changed.
fn parse_as<C: clap::Parser>(
    command: clap::Command,
    arguments: impl IntoIterator<Item = std::ffi::OsString>,
) -> Result<C, clap::Error> {
    let numbers = |command: clap::Command| {
        command.mut_args(|arg| {
            let takes_value = arg.get_action().takes_values();
            arg.allow_negative_numbers(takes_value)
        })
    };
    let command = numbers(command).mut_subcommands(numbers);
    C::from_arg_matches(&command.try_get_matches_from(arguments)?)
}

/// Prints wrong usage, the help or the version.
pub fn print_usage(error: &clap::Error) -> Exit {
    // Help and version go to stdout and are no failure.
    let failed = error.use_stderr();
    let _ = error.print();
    if failed { Exit::Usage } else { Exit::Done }
}

/// Runs a command of the program `name`, and prints why it failed. Logs go to stderr; `verbose` counts `-v`.
pub fn finish(name: &str, verbose: u8, command: impl FnOnce() -> Result<Exit, CliError>) -> Exit {
    log_to_stderr(verbose);
    match command() {
        Ok(exit) => match out::failure() {
            Some(failure) => {
                errln!("{name}: stdout: {failure}");
                Exit::Failed
            }
            None => exit,
        },
        Err(error) => {
            errln!("{name}: {error}");
            error.exit()
        }
    }
}

/// Runs what was asked for.
fn execute(cli: Cli) -> Result<Exit, CliError> {
    let main_job = Some(cli.run.out.as_path());
    if let Some(out) = cli.command.as_ref().map_or(main_job, CliCommand::results) {
        exit::check_writable(out)?;
    }
    match cli.command {
        None => run::run(&cli.run),
        Some(CliCommand::Run(args)) => run::run(&args),
        Some(CliCommand::Init(args)) => init::run(&args),
        Some(CliCommand::Plan(args)) => stages::run(&args),
        Some(CliCommand::Measure(args)) => stages::measure(&args),
        Some(CliCommand::Teach(args)) => teach::run(&args),
        Some(CliCommand::Check(args)) => check::run(&args),
        Some(CliCommand::Commission(args)) => commission::run(&args),
        Some(CliCommand::Impedance(args)) => impedance::run(&args),
        Some(CliCommand::Collect(args)) => collect::run(&args),
        Some(CliCommand::Stability(args)) => stability::run(&args),
        Some(CliCommand::Identify(args)) if limbs::are_meant(&args) => limbs::run(&args),
        Some(CliCommand::Identify(args)) => identify::run(&args),
        Some(CliCommand::Validate(args)) => stages::validate(&args),
        Some(CliCommand::Report(args)) => stages::report(&args),
        Some(CliCommand::Certificate(args)) => certificate::run(&args),
        Some(CliCommand::Export(args)) => export::run(&args),
        Some(CliCommand::Robot(args)) => robot::run(&args),
        Some(CliCommand::Plant(args)) => servers::plant(&args),
        Some(CliCommand::Controller(args)) => servers::controller(&args),
        Some(CliCommand::Serve(args)) => serve::run(&args),
        Some(CliCommand::History(args)) => history::history(&args),
        Some(CliCommand::Trend(args)) => history::trend(&args),
        Some(CliCommand::Config(args)) => stages::config(&args),
        Some(CliCommand::Conform(args)) => Ok(servers::run(&args)),
        Some(CliCommand::Doctor(args)) => doctor::run(&args),
        Some(CliCommand::Completions(args)) => shell::completions(&args, Cli::command()),
        Some(CliCommand::Man(args)) => shell::man(&args, Cli::command()),
        Some(CliCommand::Store(args)) => store::run(&args),
    }
}

/// Whether stderr is coloured: on a terminal, unless `NO_COLOR` is set or the terminal is dumb.
fn colour() -> bool {
    let set = |name| std::env::var_os(name).is_some_and(|value: std::ffi::OsString| !value.is_empty());
    std::io::stderr().is_terminal() && !set("NO_COLOR") && std::env::var_os("TERM").is_none_or(|term| term != "dumb")
}

/// Logs go to stderr; `SPHERECAL_LOG` or `-v` sets the level.
fn log_to_stderr(verbose: u8) {
    let level = match verbose {
        // The user cannot act on the database driver's warning about a slow disk.
        0 => "warn,sqlx=error",
        1 => "spherecal=info",
        2 => "spherecal=debug",
        _ => "trace",
    };
    let asked = std::env::var("SPHERECAL_LOG").ok();
    let filter: Targets = asked
        .and_then(|asked| asked.parse().ok())
        .or_else(|| level.parse().ok())
        .unwrap_or_default();
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(std::io::stderr)
        .with_ansi(colour())
        .with_target(false);
    // A second subscriber is refused; the first one stays, as intended.
    let _ = tracing_subscriber::registry().with(filter).with(lines).try_init();
}
