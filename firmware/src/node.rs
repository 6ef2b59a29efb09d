//! Controller and host link in one thread, in lock-step with the drive.

use embassy_time::Instant;
use spherecal_shared::protocol::drive::{DriveCommand, DriveState};

use crate::app::ports::Probe;
use crate::{Controller, HostLink};

/// Controller and host link together.
#[derive(Clone, Debug)]
pub struct Node<const N: usize> {
    controller: Controller<N>,
    link: HostLink,
}

impl<const N: usize> Default for Node<N> {
    /// A controller in the process of its host, which has the host's build.
    fn default() -> Self {
        Self::new("in-process")
    }
}

impl<const N: usize> Node<N> {
    /// A controller that says `build` in its banner.
    pub fn new(build: &str) -> Self {
        Self {
            controller: Controller::default(),
            link: HostLink::new(build, N),
        }
    }

    /// The controller.
    pub fn controller(&mut self) -> &mut Controller<N> {
        &mut self.controller
    }

    /// One control period: takes the host's bytes, ticks, and writes whole
    /// frames for the host into `up`. Returns the torque command and the
    /// number of bytes written.
    pub fn exchange(&mut self, now: Instant, state: &DriveState, down: &[u8], up: &mut [u8]) -> (DriveCommand, usize) {
        self.exchange_probed(now, state, down, up, &mut ())
    }

    /// As [`exchange`](Self::exchange), with a look at what the control law and
    /// the host link cost.
    pub fn exchange_probed(
        &mut self,
        now: Instant,
        state: &DriveState,
        down: &[u8],
        up: &mut [u8],
        probe: &mut impl Probe,
    ) -> (DriveCommand, usize) {
        self.link.receive(down, &mut self.controller);
        probe.before_tick();
        let command = self.controller.tick(now, state);
        probe.between();
        let length = self.link.transmit(now, up, &mut self.controller);
        probe.after();
        (command, length)
    }
}
