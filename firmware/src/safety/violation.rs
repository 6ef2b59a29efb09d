//! Types that the parts of the safety monitor share: the checked joint state and
//! the violation of a limit.

use spherecal_shared::protocol::host::Fault;

/// The violation of a limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Violation {
    /// The fault that it becomes.
    pub(crate) fault: Fault,
    /// Joint, from 1; 0 for none.
    pub(crate) joint: u8,
    /// The value, in the limit's unit.
    pub(crate) value: f64,
    /// The limit.
    pub(crate) limit: f64,
}

impl Violation {
    /// A violation that concerns no joint.
    pub(crate) fn new(fault: Fault, value: f64, limit: f64) -> Self {
        Self {
            fault,
            joint: 0,
            value,
            limit,
        }
    }

    /// Whether the encoder of one joint sticks, while the rest of the state is good.
    pub(crate) fn is_stuck_encoder(&self) -> bool {
        self.fault == Fault::StaleState && self.joint > 0
    }
}

/// A checked joint state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct JointState<const N: usize> {
    /// Joint angles, in rad.
    pub(crate) q: [f64; N],
    /// Joint velocities, in rad/s.
    pub(crate) dq: [f64; N],
    /// Measured torques, in N m.
    pub(crate) tau: [f64; N],
}
