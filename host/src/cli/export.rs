//! `spherecal export`: a run as tables.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::exit::{CliError, Exit};
use super::out::{errln, outln};
use spherecal_job::open_store;
use spherecal_report::export::{ExportError, Exported, Format, export, export_ros2};
use spherecal_store::StoreLocation;

/// Arguments of `export`.
#[derive(Args, Clone, Debug)]
pub struct ExportArgs {
    /// What to write.
    #[arg(long, value_name = "FORMAT", default_value = "parquet")]
    pub format: ExportFormat,
    /// The same as --format parquet (the default; needs the feature `parquet`).
    #[arg(long, conflicts_with_all = ["csv", "format"])]
    pub parquet: bool,
    /// The same as --format csv.
    #[arg(long, conflicts_with = "format")]
    pub csv: bool,
    /// Folder of the run. The tables are written to `tables` in it, a ROS 2 bag to `ros2`.
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

/// What `export` writes.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportFormat {
    /// All tables, as Apache Parquet.
    Parquet,
    /// All tables, as comma-separated values.
    Csv,
    /// The telemetry, as a ROS 2 bag: joint states, wrench and frames.
    Ros2,
}

/// `spherecal export`
pub(super) fn run(args: &ExportArgs) -> Result<Exit, CliError> {
    let wanted = if args.csv { ExportFormat::Csv } else { args.format };
    if wanted == ExportFormat::Parquet && cfg!(not(feature = "parquet")) {
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
    // The telemetry in the folder belongs to the last run.
    let telemetry = args.out.join("telemetry.mcap");
    let telemetry = (run == last && telemetry.exists()).then_some(telemetry);
    let exported = match (wanted, &telemetry) {
        (ExportFormat::Ros2, None) => {
            return Err(CliError::input(format!(
                "{} holds no telemetry of run {run}: a ROS 2 bag is made of telemetry; --format csv writes what is \
                 stored",
                args.out.display()
            )));
        }
        (ExportFormat::Ros2, Some(telemetry)) => export_ros2(telemetry, &args.out.join("ros2"))
            .map(|(files, torn_telemetry)| Exported { files, torn_telemetry }),
        (_, telemetry) => {
            let format = match wanted {
                ExportFormat::Csv => Format::Csv,
                _ => Format::Parquet,
            };
            let folder = args.out.join("tables");
            export(store.as_mut(), run, telemetry.as_deref(), format, &folder)
        }
    };
    let exported = exported.map_err(|e| match e {
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
