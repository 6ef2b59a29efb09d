//! `spherecal-lab faults`: what becomes of every fault.

use clap::Args;

use super::sharding::{self, ShardArgs, ShardFolder};
use crate::faults::{CampaignOptions, MEASURED_ON, MatrixOptions, WorstOptions, campaign, matrix, worst};
use spherecal::cli::{CliError, Exit};
use spherecal_sim::inject::{FaultPlan, PRESETS};

/// Arguments of `faults`.
#[derive(Args, Clone, Debug)]
pub struct FaultsArgs {
    /// List the faults.
    #[arg(long)]
    pub list: bool,
    /// Print a fault as a file for --inject.
    #[arg(long, value_name = "NAME")]
    pub show: Option<String>,
    /// Inject only this; all if none is named.
    #[arg(long, value_name = "NAME")]
    pub only: Vec<String>,
    /// Random instants for each fault and arm.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..))]
    pub instants: u32,
    /// Arms, each with its own errors.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    pub seeds: u64,
    /// Instead, run N runs with one to four random faults each.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub campaign: Option<u64>,
    /// Errors of the arms, as --preset of `spherecal run`. The tables' limits were measured on the default.
    #[arg(long, value_name = "PRESET", conflicts_with = "worst", default_value = MEASURED_ON)]
    pub preset: String,
    /// Only the run with this number of the campaign, from 0, to inspect it again.
    #[arg(long, value_name = "N", requires = "campaign")]
    pub run: Option<u64>,
    /// Instead, search with N runs for each fault for the cases that do most harm, and print them.
    #[arg(long, value_name = "N", conflicts_with_all = ["campaign", "shard", "merge"], num_args = 0..=1,
          default_missing_value = "100",
          value_parser = clap::value_parser!(u32).range(8..))]
    pub worst: Option<u32>,
    #[command(flatten)]
    pub part: ShardArgs,
    #[command(flatten)]
    pub folder: ShardFolder,
    /// Print one JSON document on stdout and nothing else.
    #[arg(long)]
    pub json: bool,
}

/// `spherecal-lab faults`
pub(super) fn run(args: &FaultsArgs) -> Result<Exit, CliError> {
    if args.list {
        for preset in PRESETS {
            println!("{:18} {}", preset.name, preset.about);
        }
        return Ok(Exit::Done);
    }
    if let Some(name) = &args.show {
        print!("{}", FaultPlan::load(name).map_err(CliError::input)?.to_toml());
        return Ok(Exit::Done);
    }
    // A panic is counted, and its message is in the table.
    std::panic::set_hook(Box::new(|_| {}));
    let (shard, folder) = (args.part.shard, &args.folder.out);
    let progress = !args.json;
    if let Some(runs) = args.campaign {
        let options = CampaignOptions {
            runs,
            seeds: args.seeds,
            preset: args.preset.clone(),
            only: args.run,
            progress,
        };
        if let Some(shard) = shard {
            return sharding::one(&options, shard, folder, args.json);
        }
        let table = if args.part.merge {
            campaign::merge(folder).map_err(sharding::refused)?
        } else {
            campaign::run(&options).map_err(CliError::job)?
        };
        return end(args, &table, table.holds());
    }
    matrix::presets(&args.only).map_err(CliError::input)?;
    if let Some(runs) = args.worst {
        let table = worst::run(&WorstOptions {
            only: args.only.clone(),
            runs,
            seeds: args.seeds,
            progress,
        })
        .map_err(CliError::job)?;
        return end(args, &table, table.holds());
    }
    let options = MatrixOptions {
        only: args.only.clone(),
        instants: args.instants,
        seeds: args.seeds,
        preset: args.preset.clone(),
        progress,
    };
    if let Some(shard) = shard {
        return sharding::one(&options, shard, folder, args.json);
    }
    let table = if args.part.merge {
        matrix::merge(folder).map_err(sharding::refused)?
    } else {
        matrix::run(&options).map_err(CliError::job)?
    };
    end(args, &table, table.holds())
}

/// Prints a table. Fails if a run did not end as it should.
fn end(args: &FaultsArgs, table: &(impl std::fmt::Display + serde::Serialize), holds: bool) -> Result<Exit, CliError> {
    if args.json {
        println!("{}", serde_json::to_string_pretty(table).map_err(CliError::job)?);
    } else {
        print!("{table}");
    }
    if holds {
        Ok(Exit::Done)
    } else {
        Err(CliError::job(
            "a run did not end as docs/recovery.md says: see the lines above",
        ))
    }
}
