//! `spherecal-lab reproduce` and `spherecal-lab worlds`: the studies.

use std::path::PathBuf;

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser as _};

use super::sharding::{self, ShardArgs, ShardFolder};
use crate::Estimator;
use crate::reproduce::{ManyOptions, merge_many, reproduce as study, reproduce_many};
use crate::worlds::{
    Chosen, CompareOptions, Comparison, PlanOptions, World, compare, compare_plans, merge_comparison, merge_plans,
    planned_poses, record,
};
use spherecal::cli::{CliError, Exit};
use spherecal::{errln, out, outln};
use spherecal_export::{Format, TableFile};
use spherecal_identify::Recordings;
use spherecal_job as job;
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
    /// Seed of the synthetic robot, or of the first of --robots.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Instead, the study on N synthetic robots: medians, and how often each finding is true.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    pub robots: Option<u64>,
    #[command(flatten)]
    pub part: ShardArgs,
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
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    pub seeds: u64,
    /// An estimator to compare; all if none is named.
    #[arg(long, value_name = "NAME", conflicts_with = "plan",
          value_parser = PossibleValuesParser::new(Estimator::ALL.map(Estimator::name)).map(estimator))]
    pub estimator: Vec<Estimator>,
    /// Contacts of each robot, chosen as `run` does; the paper's grid if not given.
    #[arg(long, value_name = "N", conflicts_with = "plan", value_parser = clap::value_parser!(u64).range(20..=1800))]
    pub poses: Option<u64>,
    /// Also write one row for each robot and estimator into --out.
    #[arg(long, value_name = "FORMAT", conflicts_with_all = ["plan", "shard"])]
    pub rows: Option<RowsFormat>,
    #[command(flatten)]
    pub part: ShardArgs,
    #[command(flatten)]
    pub folder: ShardFolder,
    /// Print one JSON document on stdout and nothing else.
    #[arg(long)]
    pub json: bool,
}

/// Format of `worlds --rows`.
#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum RowsFormat {
    /// `worlds.parquet`.
    Parquet,
    /// `worlds.csv`.
    Csv,
}

/// The estimator of a name that the parser has accepted.
fn estimator(name: String) -> Estimator {
    let found = Estimator::ALL.into_iter().find(|e| e.name() == name);
    found.unwrap_or(Estimator::Sphere)
}

/// `spherecal-lab reproduce --robots N`
fn reproduce_on_many(args: &ReproduceArgs, robots: u64) -> Result<Exit, CliError> {
    let options = ManyOptions {
        world: args.world.unwrap_or(World::W1),
        first_seed: args.seed,
        robots,
        progress: !args.json,
    };
    match args.part.shard {
        Some(shard) => sharding::one(&options, shard, &args.out, args.json),
        None => print(&reproduce_many(&options).map_err(CliError::job)?, args.json),
    }
}

/// `spherecal-lab reproduce`
pub(super) fn reproduce(args: &ReproduceArgs) -> Result<Exit, CliError> {
    if args.part.merge {
        return print(&merge_many(&args.out).map_err(sharding::refused)?, args.json);
    }
    if let Some(robots) = args.robots {
        return reproduce_on_many(args, robots);
    }
    if args.part.shard.is_some() {
        return Err(CliError::input(
            "the study of one robot cannot be divided: give --robots N with --shard",
        ));
    }
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
        seed = info.about.seed;
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

/// `spherecal-lab worlds`
pub(super) fn worlds(args: &WorldsArgs) -> Result<Exit, CliError> {
    let folder = &args.folder.out;
    if args.rows == Some(RowsFormat::Parquet) && cfg!(not(feature = "parquet")) {
        return Err(CliError::feature("--rows parquet", "parquet"));
    }
    let worlds = if args.world.is_empty() {
        World::ALL.to_vec()
    } else {
        args.world.clone()
    };
    let seeds = (0..args.seeds).collect();
    let progress = !args.json;
    if args.plan {
        let options = PlanOptions {
            worlds,
            seeds,
            progress,
            ..PlanOptions::default()
        };
        return match args.part.shard {
            Some(shard) => sharding::one(&options, shard, folder, args.json),
            None if args.part.merge => print(&merge_plans(folder).map_err(sharding::refused)?, args.json),
            None => print(&compare_plans(&options).map_err(CliError::job)?, args.json),
        };
    }
    if args.part.merge {
        return compared(args, &merge_comparison(folder).map_err(sharding::refused)?);
    }
    let mut options = CompareOptions {
        worlds,
        seeds,
        progress,
        ..CompareOptions::default()
    };
    if !args.estimator.is_empty() {
        options.estimators.clone_from(&args.estimator);
    }
    if let Some(poses) = args.poses {
        let plan = Chosen::Optimal(poses as usize).plan().map_err(CliError::job)?;
        options.poses = Some(planned_poses(&plan));
    }
    match args.part.shard {
        Some(shard) => sharding::one(&options, shard, folder, args.json),
        None => compared(args, &compare(&options).map_err(CliError::job)?),
    }
}

/// Prints the comparison, and writes its rows.
fn compared(args: &WorldsArgs, table: &Comparison) -> Result<Exit, CliError> {
    if let Some(format) = args.rows {
        let format = match format {
            RowsFormat::Parquet => Format::Parquet,
            RowsFormat::Csv => Format::Csv,
        };
        std::fs::create_dir_all(&args.folder.out).map_err(CliError::job)?;
        let rows = table.rows();
        let mut file = TableFile::create(&args.folder.out, format, &rows).map_err(CliError::job)?;
        file.append(&rows).map_err(CliError::job)?;
        let path = file.finish().map_err(CliError::job)?;
        errln!("{}: {} rows", path.display(), rows.rows());
    }
    print(table, args.json)
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
