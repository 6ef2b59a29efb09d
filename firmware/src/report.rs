//! What the control path reports and the host must get: the events that are repeated
//! until the host acknowledges them.
//!
//! The wire's [`Event`] also carries telemetry, and each of its values takes the memory
//! of the largest telemetry frame. Queues hold a [`Report`], which takes 40 % of that.

use spherecal_shared::protocol::host::{Contact, Coupled, Event, FaultReport, PhaseChange, Recording};

/// An event that is repeated until the host acknowledges it.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // Stored in place: the controller does not allocate.
pub enum Report {
    /// [`Event::Phase`].
    Phase(PhaseChange),
    /// [`Event::Contact`].
    Contact(Contact),
    /// [`Event::Coupled`].
    Coupled(Coupled),
    /// [`Event::Recording`].
    Recording(Recording),
    /// [`Event::Passed`].
    Passed {
        /// Id of the pose.
        pose: u32,
    },
    /// [`Event::Fault`].
    Fault(FaultReport),
}

impl From<Report> for Event {
    fn from(report: Report) -> Self {
        match report {
            Report::Phase(change) => Self::Phase(change),
            Report::Contact(contact) => Self::Contact(contact),
            Report::Coupled(coupled) => Self::Coupled(coupled),
            Report::Recording(recording) => Self::Recording(recording),
            Report::Passed { pose } => Self::Passed { pose },
            Report::Fault(fault) => Self::Fault(fault),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a report grows to the size of a telemetry frame: the queues of a board hold
    // some 30 of them.
    #[test]
    fn a_report_is_much_smaller_than_an_event() {
        let (report, event) = (size_of::<Report>(), size_of::<Event>());
        assert!(5 * report <= 2 * event, "{report} of {event} bytes");
    }
}
