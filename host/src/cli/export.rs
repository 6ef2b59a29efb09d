//! `spherecal export`: a run as tables.

use std::path::PathBuf;

use clap::Args;

use super::exit::{CliError, Exit};
use super::out::{errln, outln};
use spherecal_job::open_store;
use spherecal_report::export::{ExportError, Format, export};
use spherecal_store::StoreLocation;

/// Arguments of `export`.
#[derive(Args, Clone, Debug)]
pub struct ExportArgs {
    /// Write Parquet (the default; needs the feature `parquet`).
    #[arg(long, conflicts_with = "csv")]
    pub parquet: bool,
    /// Write CSV.
    #[arg(long)]
    pub csv: bool,
    /// Folder of the run. The tables are written to `tables` in it.
    #[arg(long, value_name = "DIR", default_value = "spherecal-out")]
    pub out: PathBuf,
    /// Database: a file, postgres://USER@HOST/DATABASE or grpc:HOST:PORT. Default: calibration.db
    /// in --out.
    #[arg(long, value_name = "STORE")]
    pub store: Option<StoreLocation>,
    /// Number of the run; the last if none is given.
    #[arg(long, value_name = "N")]
    pub run: Option<i64>,
}

/// `spherecal export`
pub(super) fn run(args: &ExportArgs) -> Result<Exit, CliError> {
    if !args.csv && cfg!(not(feature = "parquet")) {
        return Err(CliError::input(ExportError::NoParquet));
    }
    let file = StoreLocation::File(args.out.join("calibration.db"));
    let mut store = open_store(args.store.as_ref().unwrap_or(&file), false)?;
    let last = store.require_last_run()?.run;
    let run = args.run.unwrap_or(last);
    if !store.runs()?.iter().any(|info| info.run == run) {
        return Err(CliError::input(format!(
            "{} has no run {run}: give a number from 1 to {last}",
            store.path().display()
        )));
    }
    let format = if args.csv { Format::Csv } else { Format::Parquet };
    // The telemetry in the folder belongs to the last run.
    let telemetry = args.out.join("telemetry.mcap");
    let telemetry = (run == last && telemetry.exists()).then_some(telemetry);
    let exported = export(
        store.as_mut(),
        run,
        telemetry.as_deref(),
        format,
        &args.out.join("tables"),
    )
    .map_err(|e| match e {
        ExportError::Store(e) => CliError::from(e),
        ExportError::Telemetry { .. } | ExportError::NoParquet => CliError::input(e),
        ExportError::Write { .. } => CliError::job(e),
    })?;
    for file in &exported.files {
        outln!("{}", file.display());
    }
    if exported.torn_telemetry {
        errln!(
            "spherecal export: telemetry.mcap ends in the middle of a record, because its program was killed: the \
             telemetry before that is exported"
        );
    }
    Ok(Exit::Done)
}
