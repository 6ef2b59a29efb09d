//! What every store of calibrations can do, whatever is behind it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use spherecal_model::{LaserShot, Sphere};
use spherecal_shared::protocol::host::{Contact, Coupled, FaultReport, PhaseChange, Recording};

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
    /// Under which numbers (nonces) the sessions have greeted the controller:
    /// session and handshake of each.
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
/// All calls block until the store has answered. What a call has stored is on
/// the disk when it returns, unless it says otherwise.
pub trait CalibrationStore: Send {
    /// The file, or the address without its password.
    fn path(&self) -> &Path;

    /// Whether it is a file of this computer.
    fn is_file(&self) -> bool;

    /// The run that this program has begun or chosen: to it, that is the last one,
    /// whatever other robots begin meanwhile.
    fn chosen_run(&self) -> Option<i64>;

    /// Chooses the run that this program works on.
    fn choose_run(&mut self, run: i64);

    /// Notes a new run, its plate and its poses, and chooses it; returns its number.
    ///
    /// # Errors
    /// When the store fails.
    fn create_run(&mut self, new: &NewRun) -> Result<i64, StoreError>;

    /// The newest run.
    ///
    /// # Errors
    /// When the store fails or the run does not decode.
    fn newest_run(&mut self) -> Result<Option<RunInfo>, StoreError>;

    /// The runs of one arm, or of all if `arm` is empty; oldest first.
    ///
    /// # Errors
    /// When the store fails or a run does not decode.
    fn runs_of(&mut self, arm: &str) -> Result<Vec<RunInfo>, StoreError>;

    /// Everything that a run has.
    ///
    /// # Errors
    /// When the store fails, or a value does not decode or is not what was written.
    fn read_run(&mut self, run: i64) -> Result<StoredRun, StoreError>;

    /// Begins a session of a run, and chooses the run; returns the session's number.
    ///
    /// # Errors
    /// When the store fails.
    fn begin_session(&mut self, run: i64, started_utc: &str) -> Result<i64, StoreError>;

    /// Notes how a session went.
    ///
    /// # Errors
    /// When the store fails.
    fn end_session(&mut self, run: i64, session: i64, end: &SessionEnd) -> Result<(), StoreError>;

    /// Sets the state of a run: `running`, `measured`, `complete`.
    ///
    /// # Errors
    /// When the store fails.
    fn set_state(&mut self, run: i64, state: &str) -> Result<(), StoreError>;

    /// Notes under which number (`nonce`) a session greets the controller, as
    /// its handshake number `handshake`.
    ///
    /// # Errors
    /// When the store fails.
    fn put_handshake(&mut self, run: i64, session: i64, handshake: i64, nonce: u32) -> Result<(), StoreError>;

    /// Writes a batch of events in one transaction. A recording that is already
    /// there is not written again.
    ///
    /// What was measured (recordings, contacts, couplings, faults) is on the
    /// disk when it returns. Phase changes alone survive a kill, and are carried
    /// to the disk by the next such commit: they do not wait for it.
    ///
    /// # Errors
    /// When the store fails; then nothing of the batch is stored.
    fn append(&mut self, run: i64, events: &[Placed<'_>]) -> Result<(), StoreError>;

    /// As [`append`](Self::append), but what was stored under the numbers of
    /// these events is written anew, recordings excepted: for a run that is
    /// repeated from its start.
    ///
    /// # Errors
    /// When the store fails; then nothing of the batch is stored.
    fn rewrite(&mut self, run: i64, events: &[Placed<'_>]) -> Result<(), StoreError>;

    /// Removes the events of a run, recordings excepted, that do not belong to
    /// `session` or came after event `last` of it.
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
    /// When the store fails.
    fn put_laser(&mut self, run: i64, shots: &[LaserShot]) -> Result<(), StoreError>;

    /// Writes a named result, as JSON; one of the same name is replaced.
    ///
    /// # Errors
    /// When the store fails.
    fn put_result(&mut self, run: i64, name: &str, json: &str) -> Result<(), StoreError>;

    /// A named result, as JSON.
    ///
    /// # Errors
    /// When the store fails.
    fn result(&mut self, run: i64, name: &str) -> Result<Option<String>, StoreError>;

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

    /// The run that this program has begun or chosen; else the newest.
    ///
    /// # Errors
    /// When the store fails or the run does not decode.
    fn last_run(&mut self) -> Result<Option<RunInfo>, StoreError> {
        match self.chosen_run() {
            Some(chosen) => Ok(self.runs()?.into_iter().find(|info| info.run == chosen)),
            None => self.newest_run(),
        }
    }

    /// As [`last_run`](Self::last_run), which must be there.
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

    /// The newest run of one arm, or of all if `arm` is empty; chooses it. In a
    /// store that several robots share the arm must be named.
    ///
    /// # Errors
    /// When the store fails; no such run, or no arm named where it must be.
    fn require_run_of(&mut self, arm: &str) -> Result<RunInfo, StoreError> {
        if arm.is_empty() && self.is_shared() {
            return Err(StoreError::Absent {
                path: self.path().to_owned(),
                what: "may hold the runs of several robots".to_owned(),
                remedy: "say with --arm whose last run is meant",
            });
        }
        if arm.is_empty() {
            return self.require_last_run();
        }
        let found = self.runs_of(arm)?.pop().ok_or_else(|| StoreError::Absent {
            path: self.path().to_owned(),
            what: format!("holds no run of arm {arm}"),
            remedy: "`spherecal history` lists what there is",
        })?;
        self.choose_run(found.run);
        Ok(found)
    }
}
