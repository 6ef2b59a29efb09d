//! `spherecal export`: a run as tables.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::exit::{CliError, Exit};
use super::out::{errln, outln};
use spherecal_export::{ExportError, Format, export, export_ros2};
use spherecal_job::{open_store, run_telemetry};
use spherecal_store::StoreLocation;

/// Arguments of `export`.
#[derive(Args, Clone, Debug)]
pub struct ExportArgs {
    /// What to write.
    #[arg(long, value_name = "FORMAT", default_value = "csv")]
    pub format: ExportFormat,
    /// The same as --format parquet (needs the feature `parquet`).
    #[arg(long, conflicts_with_all = ["csv", "format"])]
    pub parquet: bool,
    /// The same as --format csv, the default.
    #[arg(long, conflicts_with = "format")]
    pub csv: bool,
    /// Folder of the run. The tables are written to `tables` in it, a ROS 2 bag to `ros2`; tables of another run
    /// there are removed.
    #[arg(long, value_name = "DIR", default_value = "spherecal-out")]
    pub out: PathBuf,
    /// Database: a file, postgres://USER@HOST/DATABASE or grpc:HOST:PORT. Default: calibration.db
    /// in --out.
    #[arg(long, value_name = "STORE", value_parser = super::args::StoreParser)]
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

pub(super) fn run(args: &ExportArgs) -> Result<Exit, CliError> {
    let wanted = if args.parquet {
        ExportFormat::Parquet
    } else {
        args.format
    };
    if wanted == ExportFormat::Parquet && cfg!(not(feature = "parquet")) {
        return Err(CliError::input(ExportError::NoParquet));
    }
    let file = StoreLocation::File(args.out.join("calibration.db"));
    let mut store = open_store(args.store.as_ref().unwrap_or(&file), false)?;
    let last = store.require_last_run()?.run;
    let run = args.run.unwrap_or(last);
    let Some(info) = store.find_run(run)? else {
        return Err(CliError::input(format!(
            "{} has no run {run}: give a number from 1 to {last}",
            store.path().display()
        )));
    };
    let telemetry = run_telemetry(&args.out, &info);
    let exported = match wanted {
        ExportFormat::Ros2 if telemetry.is_empty() => {
            return Err(CliError::input(format!(
                "{} holds no telemetry of run {run}: a ROS 2 bag is made of telemetry; --format csv writes what is \
                 stored",
                args.out.display()
            )));
        }
        ExportFormat::Ros2 => export_ros2(&telemetry, &args.out.join("ros2")),
        wanted => {
            let format = match wanted {
                ExportFormat::Csv => Format::Csv,
                _ => Format::Parquet,
            };
            export(store.as_mut(), &info, &telemetry, format, &args.out.join("tables"))
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
    for file in exported.removed.iter().filter(|file| !exported.files.contains(file)) {
        errln!(
            "spherecal export: {} was of another run than {run}: it is removed",
            file.display()
        );
    }
    for torn in &exported.torn_telemetry {
        errln!(
            "spherecal export: {} ends in the middle of a record, because its program was killed: {} samples \
             before that are exported, the last {} bytes are left out",
            torn.file.display(),
            torn.read.periods,
            torn.read.left_out
        );
    }
    Ok(Exit::Done)
}
