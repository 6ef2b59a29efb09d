//! One fault, injected in a phase, for the tests of recovery and of pressing.

use spherecal::sim::inject::{FaultPlan, InjectedFault, PlannedFault, When};
use spherecal_shared::protocol::host::Phase;

/// A plan with one fault: `after_s` into the `entry`-th time that the controller is in the phase, for
/// `for_s`.
pub(crate) fn one(what: InjectedFault, name: Phase, entry: u32, after_s: f64, for_s: f64) -> FaultPlan {
    FaultPlan {
        seed: 1,
        host_link: None,
        faults: vec![PlannedFault {
            what,
            when: When::Phase { name, entry, after_s },
            for_s: Some(for_s),
        }],
    }
}
