//! What an optimal plan is asked for.

use spherecal_identify::Options;

use super::candidates::Range;
use super::path::Rules;

/// Default for the largest number of contacts. In the worlds, more contacts take robot time and do
/// not lower the error; three contacts give a fifth more error.
pub const CONTACTS: usize = 5;
/// Default for [`DesignRequest::patience`]. Plans that do not weigh turns take 10 to 17 % more robot time, with 30 poses and
/// with 150, for 2 to 10 % less predicted error (iiwa 7, FR3, UR5e, 2026-11-30); less patience saves no more time.
pub const PATIENCE: f64 = 0.1;

/// What to plan.
#[derive(Clone, Debug, PartialEq)]
pub struct DesignRequest {
    /// Poses in all.
    pub poses: usize,
    /// Largest number of contacts, but at least one per sphere and placement; 0 for as many as are
    /// worthwhile.
    pub contacts: usize,
    /// Time of the turn to a pose, in units of a recording's time, at which half of the pose's gain is
    /// discounted; infinite to ignore turns.
    pub patience: f64,
    /// How wide they may lie.
    pub range: Range,
    /// What configurations and moves must keep.
    pub rules: Rules,
    /// Model, priors and noise for the predicted accuracy.
    pub options: Options,
    /// Exchange passes after the greedy choice.
    pub passes: usize,
}

impl DesignRequest {
    /// `poses` poses over the default ranges on at most five contacts.
    pub fn new(poses: usize) -> Self {
        let range = Range::default();
        Self {
            poses,
            contacts: CONTACTS,
            patience: PATIENCE,
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
