//! The drive of a [`FaultyCell`](super::FaultyCell). Faults of the arm can be injected if the arm
//! is simulated.

use spherecal_link::Drive;

use crate::plant::Disturbance;
use crate::simulated::Disturb;

/// The drive of a [`FaultyCell`](super::FaultyCell).
pub enum FaultyDrive {
    /// The simulated arm, which can suffer every fault.
    Simulated(Box<dyn Disturb>),
    /// Any other drive: faults can only be injected between it and the controller.
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
        // A plan with faults of the arm itself is refused if the arm is not simulated.
        if let Self::Simulated(arm) = self {
            arm.disturb(what);
        }
    }
}
