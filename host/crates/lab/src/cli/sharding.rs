//! `--shard I/N` and `--merge`: a study on several machines.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::shards::{Shard, ShardError, ShardedStudy, run_shard};
use spherecal::cli::{CliError, Exit};
use spherecal::outln;

/// Arguments of a study that several machines can share.
#[derive(Args, Clone, Debug)]
pub struct ShardArgs {
    /// Only the I-th of N parts, into a file in --out; started again, it goes on where it was stopped.
    #[arg(long, value_name = "I/N", conflicts_with = "merge")]
    pub shard: Option<Shard>,
    /// Instead, read the files of all shards in --out. The result has the bits of one run.
    #[arg(long)]
    pub merge: bool,
}

/// The folder of the shards, for commands that have no other use for one.
#[derive(Args, Clone, Debug)]
pub struct ShardFolder {
    /// Folder of the shards and of what is written from them.
    #[arg(long, value_name = "DIR", default_value = "spherecal-out")]
    pub out: PathBuf,
}

/// Works on one shard, and says what it did.
pub(super) fn one<S: ShardedStudy>(study: &S, shard: Shard, folder: &Path, json: bool) -> Result<Exit, CliError> {
    let done = run_shard(study, shard, folder, !json).map_err(refused)?;
    if json {
        outln!("{}", serde_json::to_string_pretty(&done).map_err(CliError::job)?);
    } else {
        outln!(
            "Shard {shard}: {} {}, {} of them done before, in {}",
            done.items,
            S::ITEMS,
            done.done_before,
            done.file.display()
        );
    }
    Ok(Exit::Done)
}

/// Tells the user's error (exit code 2) from a failure of the study (1).
pub(super) fn refused(error: ShardError) -> CliError {
    if error.is_input() {
        CliError::input(error)
    } else {
        CliError::job(error)
    }
}
