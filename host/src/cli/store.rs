//! `spherecal store`: is a database whole, and what can be saved of one that is not.

use super::args::{StoreAction, StoreArgs};
use super::exit::{CliError, Exit};
use super::out::outln;
use crate::job;
use crate::store::{Store, StoreError, recover};

/// `spherecal store`
pub(super) fn run(args: &StoreArgs) -> Result<Exit, CliError> {
    match &args.action {
        StoreAction::Check { database } => {
            let mut store = Store::open(database)?;
            for info in store.runs()? {
                // Reads everything, and holds it against its digests.
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
            let recovered = recover(damaged, new)?;
            let recordings = recovered.tables.get("recordings").copied().unwrap_or_default();
            if *json {
                outln!("{}", serde_json::to_string_pretty(&recovered).map_err(CliError::job)?);
            } else {
                for (table, saved) in &recovered.tables {
                    outln!("  {table:18} {:8} rows saved {:8} lost", saved.read, saved.lost);
                }
                for (run, sphere, pose) in &recovered.recordings_left_out {
                    outln!("  left out, for it is not what was written: run {run}, sphere {sphere}, pose {pose}");
                }
                outln!(
                    "{}: {} recordings; {} is as it was. What is missing is recorded by `spherecal run --resume` on a \
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
