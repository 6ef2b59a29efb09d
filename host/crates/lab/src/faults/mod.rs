//! `spherecal-lab faults`: injects every fault at random instants, and reports how each run ends.
//!
//! Three experiments on a shortened procedure ([`Case`]), on all cores:
//!
//! - the **matrix** ([`matrix`]): each fault alone, at random instants on several arms. Does the
//!   run end as its [`Preset`](spherecal_sim::inject::Preset) says?
//! - the **campaign** ([`campaign`]): many runs with one to four faults each. Does each end
//!   calibrated, or with a stop that gives the reason?
//! - the **search** ([`worst`]): at which phase, pose, direction and instant does each fault do most
//!   harm?
//!
//! Only this test harness reads the plant's truth ([`judge`]), in order to judge. None of it
//! reaches controller, campaign or identification.

pub mod campaign;
mod case;
pub mod judge;
pub mod matrix;
mod run_journal;
pub mod worst;

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;

pub use campaign::{CampaignOptions, CampaignTable};
pub use case::{CalibratedTrial, Case, FaultTrial, Finish, MEASURED_ON, TrialEnd};
pub use judge::{CONTACT_N, HELD_N, HELD_S, JudgeRecord, KINETIC_J, PEAK_N, SUSTAINED_N};
pub use matrix::{FaultRow, MatrixOptions, MatrixTable};
pub use worst::{WorstCase, WorstOptions, WorstRow, WorstTable};

/// Why an experiment could not be made at all.
#[derive(Debug, thiserror::Error)]
pub enum FaultsError {
    /// The job's side failed.
    #[error(transparent)]
    Job(#[from] spherecal_job::JobError),
    /// The undisturbed run, the reference of all others, did not finish well.
    #[error("seed {seed}: the run without faults did not end well: {why}")]
    Clean {
        /// Seed.
        seed: u64,
        /// Why.
        why: String,
    },
    /// There is no folder for a database.
    #[error("a folder for the database cannot be created ({0}): check the temporary folder (TMPDIR)")]
    Folder(std::io::Error),
    /// A run of an arm that was not prepared.
    #[error("the arm of seed {seed} was not prepared")]
    NotPrepared {
        /// Seed.
        seed: u64,
    },
    /// No preset of that name.
    #[error("\"{name}\" is not a fault: `spherecal-lab faults --list` names all faults")]
    Unknown {
        /// As given.
        name: String,
    },
}

/// Arms by seed, each run once undisturbed.
pub struct Cases(BTreeMap<u64, Case>);

impl Cases {
    /// The arms with these seeds and a preset's errors, prepared on all cores.
    fn new(seeds: BTreeSet<u64>, preset: &str, finish: Finish) -> Result<Self, FaultsError> {
        let cases = seeds
            .into_par_iter()
            .map(|seed| Ok((seed, Case::on_preset(seed, preset, finish)?)))
            .collect::<Result<_, FaultsError>>()?;
        Ok(Self(cases))
    }

    fn get(&self, seed: u64) -> Result<&Case, FaultsError> {
        self.0.get(&seed).ok_or(FaultsError::NotPrepared { seed })
    }
}

#[cfg(test)]
mod tests {
    // Fails if the page differs from what the code does. `SPHERECAL_BLESS=1` writes the tables.
    #[test]
    fn the_page_is_what_the_code_does() {
        use spherecal_campaign::recovery::{HANDSHAKE_S, LOST_S, table};

        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../docs/recovery.md");
        let text = std::fs::read_to_string(path).expect("the page");
        let put = |text: &str, name: &str, table: &str| {
            let (begin, end) = (format!("<!-- {name} -->\n"), format!("<!-- end of {name} -->"));
            let (before, rest) = text.split_once(&begin).expect("a beginning");
            let (_, after) = rest.split_once(&end).expect("an end");
            format!("{before}{begin}{table}{end}{after}")
        };
        let whole = put(&text, "faults", &table());
        let whole = put(&whole, "injected faults", &spherecal_sim::inject::table());
        if std::env::var_os("SPHERECAL_BLESS").is_some() {
            std::fs::write(path, &whole).expect("the page can be written");
            return;
        }
        assert_eq!(
            text, whole,
            "docs/recovery.md differs from the code: SPHERECAL_BLESS=1 rewrites its tables"
        );
        for value in [format!("{LOST_S} s"), format!("{HANDSHAKE_S} s")] {
            assert!(text.contains(&value), "{value}");
        }
    }
}
