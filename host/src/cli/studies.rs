//! `spherecal reproduce` and `spherecal worlds`: the studies.

use std::path::PathBuf;

use clap::Args;

use super::exit::{CliError, Exit};
use super::out::{errln, out, outln};
use spherecal_identify::Recordings;
use spherecal_job as job;
use spherecal_lab::reproduce::reproduce as study;
use spherecal_lab::worlds::{CompareOptions, PlanOptions, World, compare, compare_plans, record};
use spherecal_store::{CalibrationStore as _, SqlStore};

/// Arguments of `reproduce`.
#[derive(Args, Clone, Debug)]
pub struct ReproduceArgs {
    /// Folder of the run, and of what is written.
    #[arg(long, value_name = "DIR", default_value = "spherecal-out")]
    pub out: PathBuf,
    /// Use a synthetic robot of this world instead of the run: W0 to W4, W4-bad.
    #[arg(long, value_name = "WORLD")]
    pub world: Option<World>,
    /// Seed of the synthetic robot.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Print one JSON document on stdout and nothing else.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `worlds`.
#[derive(Args, Clone, Debug)]
pub struct WorldsArgs {
    /// A world to compare in; all if none is named.
    #[arg(long, value_name = "WORLD")]
    pub world: Vec<World>,
    /// Compare plans instead: error and robot time for several numbers of poses.
    #[arg(long)]
    pub plan: bool,
    /// Robots drawn in each world.
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u64).range(1..=1000))]
    pub seeds: u64,
    /// Print one JSON document on stdout and nothing else.
    #[arg(long)]
    pub json: bool,
}

/// `spherecal reproduce`
pub(super) fn reproduce(args: &ReproduceArgs) -> Result<Exit, CliError> {
    let database = args.out.join("calibration.db");
    let world = match args.world {
        None if database.exists() => None,
        // There is no run: use the world whose laser error is that of the paper.
        None => Some(World::W1),
        given => given,
    };
    let mut seed = args.seed;
    let mut contact_force: Vec<(f64, f64)> = Vec::new();
    let recordings = if let Some(world) = world {
        errln!(
            "recordings: a synthetic robot of world {world} ({}), seed {}",
            world.about(),
            args.seed
        );
        Recordings::from(&record(world, args.seed).map_err(CliError::job)?)
    } else {
        let mut store = SqlStore::open(&database)?;
        let info = store.require_last_run()?;
        errln!("recordings: run {} in {}", info.run, database.display());
        seed = info.seed;
        if let Some(trace) = job::contact_traces(&mut store, info.run)?.first() {
            let since = |&(time_s, force_n): &(f64, f64)| (time_s - trace.trigger_s, force_n);
            contact_force = trace.samples.iter().map(since).collect();
        }
        job::read(&mut store, &info)?.to_recordings()
    };
    if recordings.tracker.as_ref().is_none_or(|t| t.validation.is_empty()) {
        return Err(CliError::input(
            "the run has no laser measurements for the validation: measure with [laser] enabled = true, or use --world W1",
        ));
    }
    let done = study(&recordings, seed, &contact_force).map_err(CliError::job)?;
    let files = done.write(&args.out).map_err(CliError::job)?;
    if args.json {
        outln!("{}", serde_json::to_string_pretty(&done).map_err(CliError::job)?);
    } else {
        out!("{done}\nFiles:\n");
        for file in files {
            outln!("  {}", file.display());
        }
    }
    Ok(if done.verdict.may_be_used {
        Exit::Done
    } else {
        Exit::NotTrusted
    })
}

/// `spherecal worlds`
pub(super) fn worlds(args: &WorldsArgs) -> Result<Exit, CliError> {
    let worlds = if args.world.is_empty() {
        World::ALL.to_vec()
    } else {
        args.world.clone()
    };
    let seeds = (0..args.seeds).collect();
    let progress = !args.json;
    if args.plan {
        let table = compare_plans(&PlanOptions {
            worlds,
            seeds,
            progress,
            ..PlanOptions::default()
        })
        .map_err(CliError::job)?;
        return print(&table, args.json);
    }
    let table = compare(&CompareOptions {
        worlds,
        seeds,
        progress,
        ..CompareOptions::default()
    })
    .map_err(CliError::job)?;
    print(&table, args.json)
}

/// A table for people or for programs.
fn print(table: &(impl std::fmt::Display + serde::Serialize), json: bool) -> Result<Exit, CliError> {
    if json {
        outln!("{}", serde_json::to_string_pretty(table).map_err(CliError::job)?);
    } else {
        out!("{table}");
    }
    Ok(Exit::Done)
}
