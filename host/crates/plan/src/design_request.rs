//! What an optimal plan is asked for.

use spherecal_identify::Options;

use super::candidates::Range;
use super::path::Rules;

/// Default for the largest number of contacts. In the worlds, more contacts take robot time and do
/// not lower the error; three contacts give a fifth more error.
pub const CONTACTS: usize = 5;
/// Number of poses of a plan in which a turn may take as long as a recording. Plans that do not weigh travel take 5 to 11 %
/// more robot time with 30 poses and 8 to 17 % more with 150, for 1 to 4 % less predicted error (seven arms, 2026-11-29).
const PATIENT_POSES: f64 = 60.0;

/// What to plan.
#[derive(Clone, Debug, PartialEq)]
pub struct DesignRequest {
    /// Poses in all.
    pub poses: usize,
    /// Largest number of contacts, but at least one per sphere and placement; 0 for as many as are
    /// worthwhile.
    pub contacts: usize,
    /// Travel time to a pose, in units of a recording's time, at which half of the pose's gain is
    /// discounted; infinite to ignore travel.
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
    /// `poses` poses over the default ranges on at most five contacts. The more poses, the less
    /// each gains and the less travel it may cost.
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
