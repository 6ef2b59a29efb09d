//! The store as a campaign's journal, and the telemetry of a run in a folder.
//!
//! ```text
//!   events ─▶ whose session is it? ─▶ place in the run ─▶ stored, then acknowledged
//!                 └ another run's: passed over, acknowledged
//! ```
//!
//! An arm that was simulated in the process died with the process. A continued run then starts from
//! the beginning: the same seed gives the same run, much faster than the robot. Every stored
//! recording is compared with its repetition, bit by bit. None is written twice, and the database
//! ends as that of an uninterrupted run.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::mpsc::Sender;

use spherecal_campaign::telemetry::{RunKey, files_of_run};
use spherecal_link::{Arrival, Journal, JournalError};
use spherecal_shared::protocol::host::{Event, Recording, SessionId};
use spherecal_store::{CalibrationStore, Placed, RunInfo, StoreError};

use super::Link;

/// The session number reserved for a repeated run.
pub(super) const REPEATED_SESSION: i64 = 1;

/// The store as a campaign's journal.
pub struct StoreJournal<'a> {
    store: &'a mut dyn CalibrationStore,
    run: i64,
    session: i64,
    handshakes: i64,
    /// Session and handshake of the run, by the number of the host link's session.
    places: BTreeMap<u32, (i64, i64)>,
    repetition: Option<Repetition>,
    last: i64,
    passed_over: u64,
    /// Who hears what was stored.
    told: Option<Sender<Event>>,
}

/// A run that is repeated from its start.
struct Repetition {
    stored: BTreeMap<(u32, u32), Recording>,
}

impl<'a> StoreJournal<'a> {
    /// A journal for a session of a continued run whose arm lives on. `handshakes` are the stored
    /// handshakes of its earlier sessions.
    pub fn live(
        store: &'a mut dyn CalibrationStore,
        run: i64,
        session: i64,
        handshakes: BTreeMap<u32, (i64, i64)>,
    ) -> Self {
        Self {
            store,
            run,
            session,
            handshakes: 0,
            places: handshakes,
            repetition: None,
            last: 0,
            passed_over: 0,
            told: None,
        }
    }

    /// A journal for a run that is repeated from its start. `recordings` are the stored ones.
    pub(super) fn repeated(store: &'a mut dyn CalibrationStore, run: i64, recordings: &[Recording]) -> Self {
        let stored = recordings.iter().map(|r| ((r.sphere, r.pose), r.clone())).collect();
        Self {
            store,
            run,
            session: REPEATED_SESSION,
            handshakes: 0,
            places: BTreeMap::new(),
            repetition: Some(Repetition { stored }),
            last: 0,
            passed_over: 0,
            told: None,
        }
    }

    /// The same journal, which tells every recording, coupling and fault of the run once it is stored.
    pub(super) fn telling(self, told: Sender<Event>) -> Self {
        Self {
            told: Some(told),
            ..self
        }
    }

    /// Events of other runs that were passed over.
    pub(super) fn passed_over(&self) -> u64 {
        self.passed_over
    }

    /// Removes the events of an earlier attempt that lie after the end of the repetition.
    /// Errors: when the database fails.
    pub(super) fn finish(&mut self) -> Result<(), StoreError> {
        if self.repetition.is_some() {
            self.store.forget_after(self.run, self.session, self.last)?;
        }
        Ok(())
    }
}

impl Journal for StoreJournal<'_> {
    fn handshake(&mut self, session: SessionId) -> Result<(), JournalError> {
        let nonce = u32::from_le_bytes(session);
        self.handshakes += 1;
        self.store
            .put_handshake(self.run, self.session, self.handshakes, nonce)
            .map_err(store_error)?;
        self.places.insert(nonce, (self.session, self.handshakes));
        Ok(())
    }

    fn append(&mut self, events: &[Arrival]) -> Result<(), JournalError> {
        let mut placed = Vec::with_capacity(events.len());
        for arrival in events {
            let nonce = u32::from_le_bytes(arrival.session);
            let Some((session, handshake)) = self.places.get(&nonce) else {
                // A controller that lives on may hold events of another run.
                self.passed_over += 1;
                continue;
            };
            // Events of the first handshake keep the controller's own numbers.
            let event = ((handshake - 1) << 32) | i64::from(arrival.event);
            self.last = self.last.max(event);
            if let (Some(repetition), Event::Recording(recording)) = (&self.repetition, &arrival.body)
                && let Some(stored) = repetition.stored.get(&(recording.sphere, recording.pose))
                // The numbers are compared as values: none is a NaN, and the sign of a zero is not
                // stored.
                && stored != recording
            {
                return Err(JournalError::Differs {
                    sphere: recording.sphere,
                    pose: recording.pose,
                });
            }
            placed.push(Placed {
                session: *session,
                event,
                body: &arrival.body,
            });
        }
        if placed.is_empty() {
            return Ok(());
        }
        if self.repetition.is_some() {
            self.store.rewrite(self.run, &placed)
        } else {
            self.store.append(self.run, &placed)
        }
        .map_err(store_error)?;
        if let Some(told) = &self.told {
            for Placed { body, .. } in placed {
                if matches!(body, Event::Recording(_) | Event::Coupled(_) | Event::Fault(_)) {
                    // Nobody may be listening any more.
                    let _ = told.send((*body).clone());
                }
            }
        }
        Ok(())
    }

    fn reject(&mut self, sphere: u32, pose: u32, reason: &str) -> Result<(), JournalError> {
        self.store
            .reject_pose(self.run, sphere, pose, reason)
            .map_err(store_error)
    }
}

/// Converts an error of the store to one of the journal.
pub fn store_error(error: StoreError) -> JournalError {
    JournalError::store(error)
}

/// Key of a run in the metadata of its telemetry.
pub(super) fn run_key(info: &RunInfo) -> RunKey {
    RunKey {
        number: info.run,
        created_utc: info.about.created_utc.clone(),
    }
}

/// The telemetry of run `info` in `folder`: its files, in the order in which they were written. One, and one more for
/// each time it was resumed.
///
/// A simulated run that is resumed starts from its beginning, so each of its files repeats the ones
/// before. Of them only the largest is returned.
pub fn run_telemetry(folder: &Path, info: &RunInfo) -> Vec<PathBuf> {
    let files = files_of_run(folder, &run_key(info));
    if !info.about.link.parse::<Link>().is_ok_and(|link| link.simulated()) {
        return files;
    }
    let size = |path: &PathBuf| std::fs::metadata(path).map_or(0, |m| m.len());
    files.into_iter().max_by_key(size).into_iter().collect()
}
