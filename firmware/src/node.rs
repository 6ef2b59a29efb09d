//! Controller and host link in one thread, in lock-step with the drive.

use embassy_time::Instant;
use spherecal_shared::protocol::drive::{DriveCommand, DriveState};
use spherecal_shared::protocol::host::{Command, Sample, Statistics};

use crate::link::{CommandOutcome, CommandPort};
use crate::{Controller, HostLink, Report};

/// A controller and its host link.
#[derive(Clone, Debug)]
pub struct Node<const N: usize> {
    controller: Controller<N>,
    link: HostLink,
}

impl<const N: usize> Default for Node<N> {
    /// A controller inside its host's process: it has the host's build.
    fn default() -> Self {
        Self::new("in-process")
    }
}

impl<const N: usize> Node<N> {
    /// A controller that states `build` in its banner.
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

    /// The host link.
    pub fn link(&self) -> &HostLink {
        &self.link
    }

    /// Takes the host's bytes. A complete command is carried out at once or waits
    /// for the tick at which it starts.
    pub fn receive(&mut self, down: &[u8]) {
        let mut port = Direct(&mut self.controller);
        self.link.receive(down, &mut port);
    }

    /// Writes complete frames for the host to `up`; returns the number of bytes.
    pub fn transmit(&mut self, now: Instant, up: &mut [u8]) -> usize {
        let mut port = Direct(&mut self.controller);
        self.link.transmit(now, up, &mut port)
    }

    /// One control period: takes the host's bytes, runs a tick and writes complete
    /// frames for the host to `up`. Returns the torque command and the number of
    /// bytes written.
    pub fn exchange(&mut self, now: Instant, state: &DriveState, down: &[u8], up: &mut [u8]) -> (DriveCommand, usize) {
        self.receive(down);
        let command = self.controller.tick(now, state);
        (command, self.transmit(now, up))
    }
}

/// The controller as a command port, without queues.
struct Direct<'a, const N: usize>(&'a mut Controller<N>);

impl<const N: usize> CommandPort for Direct<'_, N> {
    fn host_heard(&mut self) {
        self.0.host_heard();
    }

    fn queue_command(&mut self, sequence: u32, start_us: u64, command: Command) -> bool {
        self.0.queue_command(sequence, start_us, &command)
    }

    fn command_outcome(&mut self) -> Option<CommandOutcome> {
        self.0.command_outcome()
    }

    fn next_report(&mut self) -> Option<Report> {
        self.0.next_report()
    }

    fn samples_waiting(&self) -> usize {
        self.0.samples_waiting()
    }

    fn next_sample(&mut self) -> Option<Sample> {
        self.0.next_sample()
    }

    fn period_us(&self) -> u32 {
        self.0.period_us()
    }

    fn statistics(&self) -> Statistics {
        self.0.statistics()
    }
}
