//! `spherecal faults`: what becomes of every fault.

use super::args::FaultsArgs;
use super::exit::{CliError, Exit};
use crate::faults::{CampaignOptions, MatrixOptions, campaign, matrix};
use crate::inject::{PRESETS, Plan};

/// `spherecal faults`
pub(super) fn run(args: &FaultsArgs) -> Result<Exit, CliError> {
    if args.list {
        for preset in PRESETS {
            println!("{:18} {}", preset.name, preset.about);
        }
        return Ok(Exit::Done);
    }
    if let Some(name) = &args.show {
        print!("{}", Plan::load(name).map_err(CliError::input)?.to_toml());
        return Ok(Exit::Done);
    }
    // A panic is counted, and its message is in the table.
    std::panic::set_hook(Box::new(|_| {}));
    let (holds, text, json) = if let Some(runs) = args.campaign {
        let table = campaign::run(&CampaignOptions {
            runs,
            seeds: args.seeds,
            progress: !args.json,
        })
        .map_err(CliError::job)?;
        let json = serde_json::to_string_pretty(&table).map_err(CliError::job)?;
        (table.holds(), table.to_string(), json)
    } else {
        matrix::presets(&args.only).map_err(CliError::input)?;
        let table = matrix::run(&MatrixOptions {
            only: args.only.clone(),
            instants: args.instants,
            seeds: args.seeds,
            progress: !args.json,
        })
        .map_err(CliError::job)?;
        let json = serde_json::to_string_pretty(&table).map_err(CliError::job)?;
        (table.holds(), table.to_string(), json)
    };
    if args.json {
        println!("{json}");
    } else {
        print!("{text}");
    }
    if holds {
        Ok(Exit::Done)
    } else {
        Err(CliError::job(
            "something did not end as docs/recovery.md says: see above",
        ))
    }
}
