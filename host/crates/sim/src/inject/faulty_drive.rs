//! The drive of a [`FaultyCell`](super::FaultyCell), which may be one that can suffer faults of the arm.

use spherecal_link::Drive;

use crate::plant::Disturbance;
use crate::simulated::Disturb;

/// The drive of a [`FaultyCell`](super::FaultyCell).
pub enum FaultyDrive {
    /// The simulated arm, which can suffer every fault.
    Simulated(Box<dyn Disturb>),
    /// Any other drive: only what passes between it and the controller can be faulty.
    Other(Box<dyn Drive>),
}

impl FaultyDrive {
    pub(super) fn drive(&self) -> &dyn Drive {
        match self {
            Self::Simulated(arm) => arm.as_ref(),
            Self::Other(drive) => drive.as_ref(),
        }
    }

    pub(super) fn drive_mut(&mut self) -> &mut dyn Drive {
        match self {
            Self::Simulated(arm) => arm.as_mut(),
            Self::Other(drive) => drive.as_mut(),
        }
    }

    pub(super) fn disturb(&mut self, what: &Disturbance) {
        // A plan that wants the arm to suffer is refused where it cannot.
        if let Self::Simulated(arm) = self {
            arm.disturb(what);
        }
    }
}
