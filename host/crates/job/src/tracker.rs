//! The plant's laser tracker as the campaign's [`Tracker`].

use spherecal_campaign::{Tracker, TrackerError};
use spherecal_model::TrackerSession;
use spherecal_sim::SimulatedTracker;

use crate::{JobError, PreparedRun};

/// The plant's tracker.
struct Simulated(SimulatedTracker);

impl Tracker for Simulated {
    fn shot(&mut self, session: TrackerSession, q: &[f64]) -> Result<(Vec<f64>, [f64; 3]), TrackerError> {
        Ok(self.0.shot(session, q)?)
    }
}

/// The simulated tracker of a configuration, in its state before the first shot.
///
/// # Errors
/// The plant cannot be created.
pub fn simulated_tracker(prepared: &PreparedRun) -> Result<Box<dyn Tracker + Send>, JobError> {
    let tracker = SimulatedTracker::new(&prepared.robot, &prepared.tool, &prepared.plant)?;
    Ok(Box::new(Simulated(tracker)))
}
