//! Where a run's recordings are stored: in memory, or in a database if the fault concerns the
//! host's own computer.

use std::collections::BTreeSet;

use spherecal_shared::protocol::host::{Coupled, Event, Recording};

use super::FaultsError;
use spherecal::simulated::file_lock;
use spherecal_job::{JobError, Link, PreparedRun, StoreJournal, create_run};
use spherecal_link::{Arrival, Journal, JournalError};
use spherecal_sim::inject::{HostFaultJournal, HostFaults};
use spherecal_store::time::now_utc;
use spherecal_store::{CalibrationStore as _, SqlStore};

/// The recordings of a run. They outlive the hosts that make them.
pub(super) enum RunJournal {
    /// Memory that counts recordings stored twice.
    Memory(MemoryJournal),
    /// A database in a folder of its own.
    File {
        folder: tempfile::TempDir,
        store: Box<SqlStore>,
        run: i64,
    },
}

/// A journal in memory.
#[derive(Default)]
pub(super) struct MemoryJournal {
    recordings: Vec<Recording>,
    couplings: Vec<Coupled>,
    rejected: BTreeSet<(u32, u32)>,
    duplicates: usize,
}

impl Journal for MemoryJournal {
    fn append(&mut self, events: &[Arrival]) -> Result<(), JournalError> {
        for arrival in events {
            match &arrival.body {
                Event::Recording(recording) => {
                    let same = |r: &Recording| (r.sphere, r.pose) == (recording.sphere, recording.pose);
                    self.duplicates += usize::from(self.recordings.iter().any(same));
                    self.recordings.push(recording.clone());
                }
                Event::Coupled(coupled) => self.couplings.push(*coupled),
                _ => {}
            }
        }
        Ok(())
    }

    fn reject(&mut self, sphere: u32, pose: u32, _: &str) -> Result<(), JournalError> {
        self.rejected.insert((sphere, pose));
        Ok(())
    }
}

impl RunJournal {
    /// An empty one: a database where `on_disk`.
    pub(super) fn new(prepared: &PreparedRun, on_disk: bool) -> Result<Self, FaultsError> {
        if !on_disk {
            return Ok(Self::Memory(MemoryJournal::default()));
        }
        let folder = tempfile::tempdir().map_err(FaultsError::Folder)?;
        let mut store = SqlStore::create_or_open(&folder.path().join("run.db")).map_err(JobError::from)?;
        let run = create_run(prepared, &Link::Sim, &mut store)?;
        let store = Box::new(store);
        Ok(Self::File { folder, store, run })
    }

    /// The journal of one more host, whose computer has the given faults.
    pub(super) fn journal(&mut self, faults: &HostFaults) -> Result<Box<dyn Journal + '_>, FaultsError> {
        match self {
            Self::Memory(memory) => Ok(Box::new(memory)),
            Self::File { store, run, .. } => {
                let handshakes = store.read_run(*run).map_err(JobError::from)?.handshakes;
                let session = store.begin_session(*run, &now_utc()).map_err(JobError::from)?;
                let path = store.path().to_owned();
                let journal = StoreJournal::live(store.as_mut(), *run, session, handshakes);
                let lock = file_lock(path.clone());
                Ok(Box::new(HostFaultJournal::new(journal, faults.clone(), path, lock)))
            }
        }
    }

    /// A host was killed or has stopped: another one opens the same data.
    pub(super) fn reopen(&mut self) -> Result<(), FaultsError> {
        if let Self::File { folder, store, .. } = self {
            **store = SqlStore::open(&folder.path().join("run.db")).map_err(JobError::from)?;
        }
        Ok(())
    }

    /// Poses that are recorded or given up.
    pub(super) fn done(&mut self) -> Result<BTreeSet<(u32, u32)>, FaultsError> {
        match self {
            Self::Memory(memory) => {
                let recorded = memory.recordings.iter().map(|r| (r.sphere, r.pose));
                Ok(recorded.chain(memory.rejected.iter().copied()).collect())
            }
            Self::File { store, run, .. } => Ok(store.read_run(*run).map_err(JobError::from)?.done()),
        }
    }

    /// Where the spheres were found.
    pub(super) fn couplings(&mut self) -> Result<Vec<Coupled>, FaultsError> {
        match self {
            Self::Memory(memory) => Ok(memory.couplings.clone()),
            Self::File { store, run, .. } => Ok(store.read_run(*run).map_err(JobError::from)?.couplings),
        }
    }

    /// The recordings, as they are stored.
    pub(super) fn recordings(&mut self) -> Result<Vec<Recording>, FaultsError> {
        match self {
            Self::Memory(memory) => Ok(memory.recordings.clone()),
            Self::File { store, run, .. } => Ok(store.read_run(*run).map_err(JobError::from)?.recordings),
        }
    }

    /// Recordings stored twice; a database cannot have any, because of its key.
    pub(super) fn duplicates(&self) -> usize {
        match self {
            Self::Memory(memory) => memory.duplicates,
            Self::File { .. } => 0,
        }
    }
}
