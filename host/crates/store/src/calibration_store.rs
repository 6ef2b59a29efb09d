//! The interface of every store of calibrations.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use spherecal_model::{LaserShot, Sphere};
use spherecal_shared::protocol::host::{Contact, Coupled, FaultReport, PhaseChange, Recording};

use super::past::{FINGERPRINT, HEADLINE, StoredPast};
use super::{NewRun, Placed, RunInfo, SessionEnd, StoreError};

/// Everything that a run has, fetched once.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StoredRun {
    /// Sessions, oldest first.
    pub sessions: Vec<SessionEnd>,
    /// The plate's certificate.
    pub spheres: Vec<Sphere>,
    /// Recordings, in the order in which they came.
    pub recordings: Vec<Recording>,
    /// Poses that were given up: sphere, pose.
    pub rejected: BTreeSet<(u32, u32)>,
    /// Contacts, in the order in which they came.
    pub contacts: Vec<Contact>,
    /// Couplings, in the order in which they came.
    pub couplings: Vec<Coupled>,
    /// Phase changes, in the order in which they came.
    pub phases: Vec<PhaseChange>,
    /// Faults, in the order in which they came.
    pub faults: Vec<FaultReport>,
    /// Laser shots, in the order in which they were written.
    pub laser: Vec<LaserShot>,
    /// The nonces under which the sessions started a handshake with the controller, with session
    /// and handshake number of each.
    pub handshakes: BTreeMap<u32, (i64, i64)>,
}

impl StoredRun {
    /// Poses that are recorded: sphere, pose.
    pub fn recorded(&self) -> BTreeSet<(u32, u32)> {
        self.recordings.iter().map(|r| (r.sphere, r.pose)).collect()
    }

    /// Poses that need not be visited again: recorded or given up.
    pub fn done(&self) -> BTreeSet<(u32, u32)> {
        self.recorded().union(&self.rejected).copied().collect()
    }
}

/// A store of calibrations: a file, a database server, or a service.
///
/// All calls block until the store has answered. When a call returns, its data are on the disk,
/// unless the method says otherwise.
pub trait CalibrationStore: Send {
    /// The file, or the address without its password.
    fn path(&self) -> &Path;

    /// Whether it is a file of this computer.
    fn is_file(&self) -> bool;

    /// The run that this program has begun or chosen. For this program it is the last run, whatever
    /// other robots begin meanwhile.
    fn chosen_run(&self) -> Option<i64>;

    /// Chooses the run that this program works on.
    fn choose_run(&mut self, run: i64);

    /// Stores a new run with its plate and its poses, and chooses it. Returns its number.
    ///
    /// # Errors
    /// When the store fails.
    fn create_run(&mut self, new: &NewRun) -> Result<i64, StoreError>;

    /// The newest calibration.
    ///
    /// # Errors
    /// When the store fails or the run does not decode.
    fn newest_run(&mut self) -> Result<Option<RunInfo>, StoreError>;

    /// The runs of one arm, or of all if `arm` is empty, with its commissionings; oldest first.
    ///
    /// # Errors
    /// When the store fails or a run does not decode.
    fn runs_of(&mut self, arm: &str) -> Result<Vec<RunInfo>, StoreError>;

    /// All data of a run.
    ///
    /// # Errors
    /// When the store fails, or a value does not decode or fails its digest.
    fn read_run(&mut self, run: i64) -> Result<StoredRun, StoreError>;

    /// Begins a session of a run, and chooses the run; returns the session's number.
    ///
    /// # Errors
    /// When the store fails.
    fn begin_session(&mut self, run: i64, started_utc: &str) -> Result<i64, StoreError>;

    /// Stores how a session went.
    ///
    /// # Errors
    /// When the store fails.
    fn end_session(&mut self, run: i64, session: i64, end: &SessionEnd) -> Result<(), StoreError>;

    /// Sets the state of a run: `running`, `measured`, `complete`.
    ///
    /// # Errors
    /// When the store fails.
    fn set_state(&mut self, run: i64, state: &str) -> Result<(), StoreError>;

    /// Stores the `nonce` under which a session performs handshake number `handshake` with the
    /// controller.
    ///
    /// # Errors
    /// When the store fails.
    fn put_handshake(&mut self, run: i64, session: i64, handshake: i64, nonce: u32) -> Result<(), StoreError>;

    /// Writes a batch of events in one transaction. A recording that is already stored is not
    /// written again.
    ///
    /// Measurements (recordings, contacts, couplings, faults) are on the disk when the call
    /// returns. Phase changes alone survive a kill of the program; they reach the disk with the
    /// next such commit and are not waited for.
    ///
    /// # Errors
    /// When the store fails; then nothing of the batch is stored.
    fn append(&mut self, run: i64, events: &[Placed<'_>]) -> Result<(), StoreError>;

    /// Like [`append`](Self::append), but stored events with the same numbers are replaced, except
    /// recordings. For a run that is repeated from its start.
    ///
    /// # Errors
    /// When the store fails; then nothing of the batch is stored.
    fn rewrite(&mut self, run: i64, events: &[Placed<'_>]) -> Result<(), StoreError>;

    /// Removes the events of a run, except recordings, that do not belong to `session` or that came
    /// after event `last` of it.
    ///
    /// # Errors
    /// When the store fails.
    fn forget_after(&mut self, run: i64, session: i64, last: i64) -> Result<(), StoreError>;

    /// Marks a pose as given up, with the reason.
    ///
    /// # Errors
    /// When the store fails.
    fn reject_pose(&mut self, run: i64, sphere: u32, pose: u32, reason: &str) -> Result<(), StoreError>;

    /// Writes laser shots; those that were there are replaced.
    ///
    /// # Errors
    /// Writes laser shots. They replace the stored ones.
    fn put_laser(&mut self, run: i64, shots: &[LaserShot]) -> Result<(), StoreError>;

    /// Writes a named result, as JSON. It replaces a result of the same name.
    ///
    /// # Errors
    /// When the store fails.
    fn put_result(&mut self, run: i64, name: &str, json: &str) -> Result<(), StoreError>;

    /// A named result, as JSON.
    ///
    /// # Errors
    /// When the store fails.
    fn result(&mut self, run: i64, name: &str) -> Result<Option<String>, StoreError>;

    /// One run.
    ///
    /// # Errors
    /// When the store fails or the run does not decode.
    fn find_run(&mut self, run: i64) -> Result<Option<RunInfo>, StoreError> {
        Ok(self.runs()?.into_iter().find(|info| info.run == run))
    }

    /// The calibrations of one arm, or of all if `arm` is empty, without what was measured in them;
    /// oldest first.
    ///
    /// # Errors
    /// When the store fails, or a row is not as it was written.
    fn past(&mut self, arm: &str) -> Result<Vec<StoredPast>, StoreError> {
        one_by_one(self, arm)
    }

    /// Reads everything that a file holds, and compares it with its digests. A server vouches for
    /// its own data.
    ///
    /// # Errors
    /// When the file cannot be read, or a row is not as it was written.
    fn verify(&mut self) -> Result<(), StoreError> {
        Ok(())
    }

    /// Whether several robots may store their runs here.
    fn is_shared(&self) -> bool {
        !self.is_file()
    }

    /// All runs, oldest first.
    ///
    /// # Errors
    /// When the store fails or a run does not decode.
    fn runs(&mut self) -> Result<Vec<RunInfo>, StoreError> {
        self.runs_of("")
    }

    /// The run that this program has begun or chosen; otherwise the newest.
    ///
    /// # Errors
    /// When the store fails or the run does not decode.
    fn last_run(&mut self) -> Result<Option<RunInfo>, StoreError> {
        match self.chosen_run() {
            Some(chosen) => self.find_run(chosen),
            None => self.newest_run(),
        }
    }

    /// Like [`last_run`](Self::last_run), but a missing run is an error.
    ///
    /// # Errors
    /// When the store fails, or holds no run.
    fn require_last_run(&mut self) -> Result<RunInfo, StoreError> {
        self.last_run()?.ok_or_else(|| StoreError::Absent {
            path: self.path().to_owned(),
            what: "holds no run".to_owned(),
            remedy: "begin one with `spherecal run`",
        })
    }

    /// The newest run of one arm, or of all if `arm` is empty; chooses it. In a store that several
    /// robots share, the arm must be named.
    ///
    /// # Errors
    /// When the store fails, there is no such run, or no arm is named in a shared store.
    fn require_run_of(&mut self, arm: &str) -> Result<RunInfo, StoreError> {
        if arm.is_empty() && self.is_shared() {
            return Err(StoreError::Absent {
                path: self.path().to_owned(),
                what: "may hold the runs of several robots".to_owned(),
                remedy: "name the arm with --arm",
            });
        }
        if arm.is_empty() {
            return self.require_last_run();
        }
        let mut runs = self.runs_of(arm)?.into_iter();
        let found = runs.rfind(RunInfo::is_calibration).ok_or_else(|| StoreError::Absent {
            path: self.path().to_owned(),
            what: format!("holds no run of arm {arm}"),
            remedy: "`spherecal history` lists the stored runs",
        })?;
        self.choose_run(found.run);
        Ok(found)
    }
}

/// Reads the past run by run, with all checks of a store.
pub(super) fn one_by_one<S: CalibrationStore + ?Sized>(
    store: &mut S,
    arm: &str,
) -> Result<Vec<StoredPast>, StoreError> {
    let mut past = Vec::new();
    for info in store.runs_of(arm)?.into_iter().filter(RunInfo::is_calibration) {
        past.push(StoredPast {
            headline: store.result(info.run, HEADLINE)?,
            fingerprint: store.result(info.run, FINGERPRINT)?,
            run: info.run,
            created_utc: info.about.created_utc,
            robot: info.about.robot.name.to_string(),
            arm: info.about.arm,
            state: info.state,
        });
    }
    Ok(past)
}
