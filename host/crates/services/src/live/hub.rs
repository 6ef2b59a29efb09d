//! Receives runs and sends them to browsers. It keeps what a browser that connects later needs, and
//! forwards the rest.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::Serialize;
use tokio::sync::{broadcast, mpsc};

use super::{End, Frame, LiveContact, LiveScene, ViewerMessage};
use spherecal_budget::services::RUNS;

/// Messages that may wait for a browser before it is sent the whole state again.
const NEWS: usize = 64;
/// Runs kept after their end.
const ENDED: usize = 4;
/// Points of the force curve kept for browsers that connect later: half a minute.
const POINTS: usize = 3000;
/// Remarks kept of each run.
const NOTES: usize = 20;

/// A run among those that a hub shows.
pub type RunId = u64;

struct KeptRun {
    scene: LiveScene,
    frame: Option<Frame>,
    forces: VecDeque<(f64, f32)>,
    contact: Option<LiveContact>,
    notes: VecDeque<String>,
    end: Option<End>,
}

/// A message with the id of its run, as browsers read it.
#[derive(Serialize)]
struct Told<'a> {
    id: RunId,
    message: &'a ViewerMessage,
}

/// All runs of a page.
pub struct Hub {
    runs: Mutex<BTreeMap<RunId, KeptRun>>,
    next: Mutex<RunId>,
    /// `None` when the page is closed.
    news: Mutex<Option<broadcast::Sender<Arc<str>>>>,
}

impl Default for Hub {
    fn default() -> Self {
        Self {
            runs: Mutex::default(),
            next: Mutex::new(1),
            news: Mutex::new(Some(broadcast::channel(NEWS).0)),
        }
    }
}

/// Locked data are consistent after every statement, even if another thread has panicked.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Hub {
    /// Shows one run until its messages end.
    pub async fn show(self: Arc<Self>, mut messages: mpsc::Receiver<ViewerMessage>) {
        let mut run = None;
        while let Some(message) = messages.recv().await {
            self.take(&mut run, message);
        }
        self.gone(run);
    }

    /// Takes one message of a run; `run` is `None` until its scene has arrived. Returns whether the
    /// message was accepted.
    pub fn take(&self, run: &mut Option<RunId>, message: ViewerMessage) -> bool {
        let id = match (&message, *run) {
            (ViewerMessage::Scene(scene), None) => {
                let id = self.begin(scene);
                *run = Some(id);
                id
            }
            (ViewerMessage::Scene(_), Some(_)) | (_, None) => return false,
            (_, Some(id)) => id,
        };
        // Messages are sent while the runs are locked. So a browser that reads the kept state and
        // then listens misses nothing and receives nothing twice.
        let mut runs = lock(&self.runs);
        if let Some(kept) = runs.get_mut(&id) {
            keep(kept, &message);
            self.tell(id, &message);
        }
        true
    }

    /// The run's messages have ended. Without an end message the run was cut off.
    pub fn gone(&self, run: Option<RunId>) {
        let Some(id) = run else { return };
        let mut runs = lock(&self.runs);
        if let Some(kept) = runs.get_mut(&id)
            && kept.end.is_none()
        {
            let end = End {
                run: None,
                trusted: None,
                text: "The run's program disconnected without a result.".to_owned(),
            };
            kept.end = Some(end.clone());
            self.tell(id, &ViewerMessage::End(end));
        }
    }

    fn begin(&self, scene: &LiveScene) -> RunId {
        let id = {
            let mut next = lock(&self.next);
            *next += 1;
            *next - 1
        };
        let mut runs = lock(&self.runs);
        // The same arm starts a new run: its last run is removed.
        let same =
            |kept: &KeptRun| kept.end.is_some() && (&kept.scene.robot, &kept.scene.arm) == (&scene.robot, &scene.arm);
        runs.retain(|_, kept| !same(kept));
        let ended: Vec<RunId> = runs
            .iter()
            .filter(|(_, k)| k.end.is_some())
            .map(|(id, _)| *id)
            .collect();
        let over = ended.len().saturating_sub(ENDED - 1);
        for id in ended.iter().take(over) {
            runs.remove(id);
        }
        if runs.len() >= RUNS {
            runs.pop_first();
        }
        runs.insert(
            id,
            KeptRun {
                scene: scene.clone(),
                frame: None,
                forces: VecDeque::new(),
                contact: None,
                notes: VecDeque::new(),
                end: None,
            },
        );
        id
    }

    fn tell(&self, id: RunId, message: &ViewerMessage) {
        if let Some(news) = &*lock(&self.news)
            && news.receiver_count() > 0
            && let Ok(text) = serde_json::to_string(&Told { id, message })
        {
            // That everybody has left meanwhile is no matter.
            let _ = news.send(text.into());
        }
    }

    /// The present state, and all later messages; `None` if the page is closed.
    pub fn listen(&self) -> Option<(Vec<Arc<str>>, broadcast::Receiver<Arc<str>>)> {
        let runs = lock(&self.runs);
        let news = lock(&self.news).as_ref()?.subscribe();
        let mut known = Vec::new();
        for (id, kept) in runs.iter() {
            let mut add = |message: &ViewerMessage| {
                if let Ok(text) = serde_json::to_string(&Told { id: *id, message }) {
                    known.push(text.into());
                }
            };
            add(&ViewerMessage::Scene(kept.scene.clone()));
            for text in &kept.notes {
                add(&ViewerMessage::Note { text: text.clone() });
            }
            if let Some(contact) = &kept.contact {
                add(&ViewerMessage::Contact(contact.clone()));
            }
            if let Some(frame) = &kept.frame {
                add(&ViewerMessage::Frame(Frame {
                    forces: kept.forces.iter().copied().collect(),
                    ..frame.clone()
                }));
            }
            if let Some(end) = &kept.end {
                add(&ViewerMessage::End(end.clone()));
            }
        }
        Some((known, news))
    }

    /// Ends all connections, after the messages already sent.
    pub fn close(&self) {
        *lock(&self.news) = None;
    }
}

fn keep(kept: &mut KeptRun, message: &ViewerMessage) {
    match message {
        ViewerMessage::Scene(_) => {}
        ViewerMessage::Frame(frame) => {
            let over = (kept.forces.len() + frame.forces.len()).saturating_sub(POINTS);
            kept.forces.drain(..over.min(kept.forces.len()));
            kept.forces.extend(frame.forces.iter().take(POINTS));
            kept.frame = Some(Frame {
                forces: Vec::new(),
                ..frame.clone()
            });
        }
        ViewerMessage::Contact(contact) => kept.contact = Some(contact.clone()),
        ViewerMessage::Note { text } => {
            kept.notes.push_back(text.clone());
            if kept.notes.len() > NOTES {
                kept.notes.pop_front();
            }
        }
        ViewerMessage::End(end) => kept.end = Some(end.clone()),
    }
}

#[cfg(test)]
#[path = "hub_tests.rs"]
mod tests;
