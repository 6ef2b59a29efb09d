//! The controller's end of the host link.

use embassy_time::Instant;

use crate::Controller;

/// Bytes to commands, events to bytes.
#[derive(Clone, Debug, Default)]
pub struct HostLink {}

impl HostLink {
    /// Takes bytes from the host; whole commands go to the controller.
    pub fn receive<const N: usize>(&mut self, _now: Instant, _bytes: &[u8], _controller: &mut Controller<N>) {}

    /// Writes what there is to say into `out`, whole frames only; returns the
    /// number of bytes.
    pub fn transmit<const N: usize>(
        &mut self,
        _now: Instant,
        _out: &mut [u8],
        _controller: &mut Controller<N>,
    ) -> usize {
        0
    }
}
