//! `spherecal plan`: what would be visited.

use super::args::RunArgs;
use super::exit::{CliError, Exit, unwritten};
use super::features;
use super::out::{out, outln};
use super::text;
use spherecal_model::write_file;

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
