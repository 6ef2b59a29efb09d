//! What an optimal plan is asked for.

use spherecal_identify::Options;

use super::candidates::Range;
use super::path::Rules;

/// Contacts at most where nothing is said: over the worlds, more take robot
/// time and leave the error where it is; three leave a fifth more.
pub const CONTACTS: usize = 5;
/// Poses of a plan whose turns may take as long as recording.
const PATIENT_POSES: f64 = 60.0;

/// What to plan.
#[derive(Clone, Debug, PartialEq)]
pub struct DesignRequest {
    /// Poses in all.
    pub poses: usize,
    /// Contacts at most, though never less than one of each sphere in each
    /// placement; 0 for as many as are worth it.
    pub contacts: usize,
    /// How many recordings' time the way to a pose may take before half of what
    /// it gains is lost; infinite for the best poses wherever they are.
    pub patience: f64,
    /// How wide they may lie.
    pub range: Range,
    /// What configurations and moves must keep.
    pub rules: Rules,
    /// Model, priors and noise that accuracy is predicted with.
    pub options: Options,
    /// Exchange passes after the greedy choice.
    pub passes: usize,
}

impl DesignRequest {
    /// `poses` poses over the default ranges on at most five contacts; the more
    /// poses, the less each gains and the less it may cost.
    pub fn new(poses: usize) -> Self {
        let range = Range::default();
        Self {
            poses,
            contacts: CONTACTS,
            patience: PATIENT_POSES / poses.max(1) as f64,
            range: Range {
                candidates: range.candidates.min(600 + 16 * poses),
                ..range
            },
            rules: Rules::default(),
            options: Options::default(),
            passes: 2,
        }
    }
}
