//! What the safety monitor's parts share: the checked joint state and the broken
//! limit.

use spherecal_shared::protocol::host::Fault;

/// A limit that was broken: fault, joint (from 1, 0 for none), value and limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Violation {
    /// The fault it becomes.
    pub(crate) fault: Fault,
    /// Joint, from 1; 0 for none.
    pub(crate) joint: u8,
    /// Value, in the limit's unit.
    pub(crate) value: f64,
    /// Limit.
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

    /// Whether one joint's angle is not to be believed, all else is.
    pub(crate) fn is_stuck_encoder(&self) -> bool {
        self.fault == Fault::StaleState && self.joint > 0
    }
}

/// Joint state, checked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct JointState<const N: usize> {
    /// Joint angles, in rad.
    pub(crate) q: [f64; N],
    /// Joint velocities, in rad/s.
    pub(crate) dq: [f64; N],
    /// Measured torques, in N m.
    pub(crate) tau: [f64; N],
}
