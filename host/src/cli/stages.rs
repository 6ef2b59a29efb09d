//! Single stages of the job: the plan, and those on stored data.

use std::path::PathBuf;

use clap::Args;
use spherecal_job::{Config, open_store};
use spherecal_model::write_file;
use spherecal_services::live::End;
use spherecal_store::{CalibrationStore, RunInfo};

use super::args::{RunArgs, StoredArgs};
use super::document::documented;
use super::exit::{CliError, Exit, interrupt, unwritten};
use super::out::{out, outln};
use super::run::{self, evaluate, print};
use super::{features, text};
use crate::simulated::check;

/// Arguments of `config`.
#[derive(Args, Clone, Debug)]
pub struct ConfigArgs {
    /// Print it; without this it is only checked.
    #[arg(long)]
    pub print: bool,
    /// Configuration to check or complete.
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
}

pub(super) fn measure(args: &RunArgs) -> Result<Exit, CliError> {
    let interrupt = interrupt()?;
    let (mut store, info, mut live) = run::measure(args, &interrupt)?;
    let recorded = store.read_run(info.run)?.recordings.len();
    live.end(&End {
        run: Some(info.run),
        trusted: None,
        text: format!("Measured: {recorded} recordings. Nothing is identified yet."),
    });
    if args.json {
        let document = serde_json::json!({
            "command": "measure", "run": info.run, "seed": info.about.seed, "robot": info.about.robot.name.as_str(),
            "recorded": recorded, "database": store.path(),
        });
        outln!("{document:#}");
    } else {
        outln!(
            "{recorded} recordings of run {} are in {}\n\nNext: spherecal report --out {}",
            info.run,
            store.path().display(),
            args.out.display()
        );
    }
    Ok(Exit::Done)
}

pub(super) fn validate(args: &StoredArgs) -> Result<Exit, CliError> {
    let (mut store, info) = stored(args)?;
    let finished = evaluate(&args.out, store.as_mut(), &info, args.json)?;
    if args.json {
        return print(&finished, true);
    }
    let table = text::table(&finished.summary);
    if table.is_empty() {
        return Err(CliError::input(format!(
            "run {} has no laser measurements for the validation: measure with [laser] enabled = true",
            info.run
        )));
    }
    out!("{table}");
    Ok(if finished.summary.verdict.may_be_used {
        Exit::Done
    } else {
        Exit::NotTrusted
    })
}

pub(super) fn report(args: &StoredArgs) -> Result<Exit, CliError> {
    let (mut store, info) = stored(args)?;
    let finished = evaluate(&args.out, store.as_mut(), &info, args.json)?;
    print(&finished, args.json)
}

pub(super) fn config(args: &ConfigArgs) -> Result<Exit, CliError> {
    let config = match &args.config {
        Some(path) => Config::read(path)?,
        None => Config::default(),
    };
    check(&config)?;
    if args.print {
        out!("{}", documented(&config)?);
    } else {
        outln!("The configuration is valid; --print shows it.");
    }
    Ok(Exit::Done)
}

fn stored(args: &StoredArgs) -> Result<(Box<dyn CalibrationStore>, RunInfo), CliError> {
    let mut store = open_store(&args.database(), false)?;
    let info = store.require_run_of(&args.arm)?;
    if info.state == "running" {
        return Err(CliError::input(format!(
            "the measurement of run {} is incomplete: continue with `spherecal run --resume --out {}`",
            info.run,
            args.out.display()
        )));
    }
    Ok((store, info))
}

/// Makes the plan, prints its summary, and writes it.
pub(super) fn run(args: &RunArgs) -> Result<Exit, CliError> {
    features::check_run(args)?;
    let prepared = args.prepare()?;
    let json = serde_json::to_string_pretty(&prepared.plan).map_err(CliError::job)?;
    if args.json {
        outln!("{json}");
        return Ok(Exit::Done);
    }
    std::fs::create_dir_all(&args.out).map_err(unwritten(&args.out))?;
    let path = args.out.join("plan.json");
    write_file(&path, json + "\n").map_err(unwritten(&args.out))?;
    out!("{}", text::plan(&prepared.plan));
    if let Some(wanted_mm) = prepared.config.plan.accuracy_mm {
        outln!(
            "A mean error that is surely below {wanted_mm} mm takes about {} poses; the run ends once it is reached.",
            prepared.plan.recorded()
        );
    }
    outln!(
        "\nFiles:\n  {}\n\nNext: spherecal run with the same arguments, or spherecal measure to measure only.",
        path.display()
    );
    Ok(Exit::Done)
}
