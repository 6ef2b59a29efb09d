//! The controller in this process: the firmware's own [`Node`], called directly.

use embassy_time::Instant;
use spherecal_firmware::Node;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState};
use spherecal_shared::protocol::frame::MAX_FRAME;
use spherecal_shared::protocol::host::LoopTiming;

use super::{Controller, LinkError};

/// Bytes that the controller may send in one control period.
const UP_BYTES: usize = 8 * MAX_FRAME;

/// The firmware for `N` joints in this process, on the caller's clock.
pub struct InProcess<const N: usize> {
    node: Box<Node<N>>,
    up: Box<[u8]>,
}

impl<const N: usize> Default for InProcess<N> {
    fn default() -> Self {
        Self {
            node: Box::new(Node::new("in-process")),
            up: vec![0; UP_BYTES].into_boxed_slice(),
        }
    }
}

impl<const N: usize> Controller for InProcess<N> {
    fn connect(&mut self, hello: &DriveHello) -> Result<(), LinkError> {
        self.node.controller().connect(hello).map_err(LinkError::Refused)
    }

    fn missed(&mut self, periods: u32) {
        self.node.controller().record_missed(periods);
    }

    fn timing(&mut self, timing: LoopTiming) {
        self.node.controller().record_timing(timing);
    }

    fn exchange(
        &mut self,
        now_us: u64,
        state: &DriveState,
        down: &[u8],
        up: &mut Vec<u8>,
    ) -> Result<DriveCommand, LinkError> {
        let now = Instant::from_micros(now_us);
        let (command, length) = self.node.exchange(now, state, down, &mut self.up);
        up.extend_from_slice(self.up.get(..length).unwrap_or(&self.up));
        Ok(command)
    }
}

/// The controller for an arm with `joints` joints.
///
/// # Errors
/// When no controller was built for that number.
pub fn controller_in_process(joints: usize) -> Result<Box<dyn Controller>, LinkError> {
    match joints {
        6 => Ok(Box::new(InProcess::<6>::default())),
        7 => Ok(Box::new(InProcess::<7>::default())),
        _ => Err(LinkError::Joints { joints }),
    }
}
