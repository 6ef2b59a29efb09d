//! `spherecal export`: a run as tables.

use std::path::PathBuf;

use clap::Args;

use super::exit::{CliError, Exit};
use super::out::{errln, outln};
use spherecal_job::{open_store, run_telemetry};
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
    /// Folder of the run. The tables are written to `tables` in it; tables of another run there are removed.
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
    let Some(info) = store.runs()?.into_iter().find(|info| info.run == run) else {
        return Err(CliError::input(format!(
            "{} has no run {run}: give a number from 1 to {last}",
            store.path().display()
        )));
    };
    let format = if args.csv { Format::Csv } else { Format::Parquet };
    let telemetry = run_telemetry(&args.out, store.as_mut(), &info)?;
    let tables = args.out.join("tables");
    let exported = export(store.as_mut(), &info, &telemetry.files, format, &tables).map_err(|e| match e {
        ExportError::Store(e) => CliError::from(e),
        ExportError::Telemetry { .. } | ExportError::NoParquet => CliError::input(e),
        ExportError::Write { .. } => CliError::job(e),
    })?;
    for file in &exported.files {
        outln!("{}", file.display());
    }
    for file in exported.removed.iter().filter(|file| !exported.files.contains(file)) {
        errln!(
            "spherecal export: {} was of another run than {run}: it is removed",
            file.display()
        );
    }
    if let Some(remark) = telemetry.remark(run) {
        errln!("spherecal export: {remark}");
    }
    for file in &exported.torn_telemetry {
        errln!(
            "spherecal export: {} ends in the middle of a record, because its program was killed: the telemetry \
             before that is exported",
            file.display()
        );
    }
    Ok(Exit::Done)
}
