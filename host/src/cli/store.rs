//! `spherecal store`: checks a database, and saves the readable data of a damaged one.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use super::exit::{CliError, Exit};
use super::out::outln;
use spherecal_job as job;
use spherecal_store::{CalibrationStore as _, SqlStore, StoreError, StoreLocation, recover};

/// Arguments of `store`.
#[derive(Args, Clone, Debug)]
pub struct StoreArgs {
    /// What to do.
    #[command(subcommand)]
    pub action: StoreAction,
}

/// What `store` does.
#[derive(Clone, Debug, Subcommand)]
pub enum StoreAction {
    /// Read everything in a database, and compare it with its digests.
    #[command(after_help = "Example: spherecal store check spherecal-out/calibration.db")]
    Check {
        /// The database.
        #[arg(value_name = "DATABASE")]
        database: PathBuf,
    },
    /// Save the readable data of a damaged database in a new file; the old file stays unchanged.
    #[command(after_help = "Example: spherecal store recover spherecal-out/calibration.db saved/calibration.db")]
    Recover {
        /// The damaged database.
        #[arg(value_name = "DAMAGED")]
        damaged: PathBuf,
        /// The new one.
        #[arg(value_name = "NEW")]
        new: PathBuf,
        /// Print one JSON document on stdout and nothing else.
        #[arg(long)]
        json: bool,
    },
}

/// Refuses the address of a server in the place of a file, without its password.
fn refuse_server(path: &Path) -> Result<(), CliError> {
    match path.to_str().and_then(|text| text.parse().ok()) {
        None | Some(StoreLocation::File(_)) => Ok(()),
        Some(server) => Err(CliError::input(format!(
            "{server} is a server: this command reads SQLite files. Check and restore a server's database with the \
             server's own tools"
        ))),
    }
}

pub(super) fn run(args: &StoreArgs) -> Result<Exit, CliError> {
    match &args.action {
        StoreAction::Check { database } => {
            refuse_server(database)?;
            let mut store = SqlStore::open(database)?;
            let damage = store.damage()?;
            for found in &damage {
                outln!("run {}: {}", found.run, found.what);
            }
            if let Some(first) = damage.first() {
                return Err(StoreError::Damaged {
                    path: database.clone(),
                    what: match damage.len() {
                        1 => format!("run {}: {}", first.run, first.what),
                        rows => format!("{rows} rows are not as they were written"),
                    },
                }
                .into());
            }
            for info in store.runs()? {
                let measured = job::read(&mut store, &info)?;
                outln!(
                    "run {}: {}, {} of {} poses recorded",
                    info.run,
                    info.state,
                    measured.recordings.len(),
                    measured.plan.recorded()
                );
            }
            outln!("{}: is whole", database.display());
            Ok(Exit::Done)
        }
        StoreAction::Recover { damaged, new, json } => {
            refuse_server(damaged)?;
            refuse_server(new)?;
            let recovered = recover(damaged, new)?;
            let recordings = recovered.tables.get("recordings").copied().unwrap_or_default();
            if *json {
                outln!("{}", serde_json::to_string_pretty(&recovered).map_err(CliError::job)?);
            } else {
                for (table, saved) in &recovered.tables {
                    outln!("  {table:18} {:8} rows saved {:8} lost", saved.read, saved.lost);
                }
                for (run, sphere, pose) in &recovered.recordings_left_out {
                    outln!("  left out because its digest differs: run {run}, pose {pose} (sphere {sphere})");
                }
                for run in &recovered.settings_restored {
                    outln!("  settings of run {run}: restored from their second copy");
                }
                for run in &recovered.settings_doubtful {
                    outln!("  settings of run {run}: differ from what was written and have no second copy; check them");
                }
                for run in &recovered.settings_lost {
                    outln!("  run {run}: its settings and their second copy are damaged; the run is left out");
                }
                for (run, missing) in &recovered.acknowledged_missing {
                    outln!("  run {run}: {missing} recordings that were acknowledged are not there");
                }
                outln!(
                    "{}: {} recordings; {} is unchanged. To record what is missing, use `spherecal run --resume` on a \
                     folder with the new file as calibration.db",
                    new.display(),
                    recordings
                        .read
                        .saturating_sub(recovered.recordings_left_out.len() as u64),
                    damaged.display()
                );
            }
            if recordings.read == 0 && recovered.tables.get("runs").is_none_or(|runs| runs.read == 0) {
                return Err(CliError::job(StoreError::Absent {
                    path: damaged.clone(),
                    what: "nothing could be read".to_owned(),
                    remedy: "measure again into another --out folder",
                }));
            }
            Ok(Exit::Done)
        }
    }
}
