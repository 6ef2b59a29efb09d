//! The host link's counters, as the database stores them.

use serde::{Deserialize, Serialize};
use spherecal_link::Injected;
use spherecal_link::native::DriveRecord;
use spherecal_shared::protocol::frame::LinkCounters;

/// Counters of the two ends of the host link in a session.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkRecord {
    /// What the host received, and what the controller received.
    pub ends: [LinkCounters; 2],
    /// What was done to frames on purpose.
    #[serde(default)]
    pub injected: Injected,
    /// Commands that came after their start.
    #[serde(default)]
    pub late: u32,
    /// What the drive measured, if it is a robot's own interface.
    #[serde(default)]
    pub drive: Option<DriveRecord>,
    /// Whether the drive said that its arm is simulated.
    #[serde(default)]
    pub simulated: bool,
}

impl LinkRecord {
    /// Reads the stored text. A session that was killed has none.
    pub(super) fn stored(text: &str) -> Self {
        serde_json::from_str(text).unwrap_or_default()
    }

    pub(super) fn add(&mut self, other: &Self) {
        for (sum, part) in self.ends.iter_mut().zip(&other.ends) {
            add(sum, part);
        }
        self.injected = self.injected.plus(other.injected);
        self.late = self.late.saturating_add(other.late);
        self.simulated |= other.simulated;
        if let Some(drive) = &other.drive {
            self.drive.get_or_insert_default().add(drive);
        }
    }
}

fn add(sum: &mut LinkCounters, part: &LinkCounters) {
    sum.frames = sum.frames.saturating_add(part.frames);
    sum.crc_errors = sum.crc_errors.saturating_add(part.crc_errors);
    sum.lost = sum.lost.saturating_add(part.lost);
    sum.duplicates = sum.duplicates.saturating_add(part.duplicates);
    sum.resent = sum.resent.saturating_add(part.resent);
    sum.overflow = sum.overflow.saturating_add(part.overflow);
}
