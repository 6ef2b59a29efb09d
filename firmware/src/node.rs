//! Controller and host link in one thread, in lock-step with the drive.

use embassy_time::Instant;
use heapless::Deque;
use spherecal_shared::protocol::drive::{DriveCommand, DriveState};
use spherecal_shared::protocol::host::{Command, Event, Sample, Statistics};

use crate::link::{Desk, Verdict};
use crate::{Controller, HostLink};

/// Verdicts that wait for the next answer to the host.
const VERDICTS: usize = 8;

/// Controller and host link together.
#[derive(Clone, Debug)]
pub struct Node<const N: usize> {
    controller: Controller<N>,
    verdicts: Deque<Verdict, VERDICTS>,
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
            verdicts: Deque::new(),
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

    /// Takes the host's bytes; whole commands are carried out at once.
    pub fn receive(&mut self, down: &[u8]) {
        let mut desk = Direct {
            controller: &mut self.controller,
            verdicts: &mut self.verdicts,
        };
        self.link.receive(down, &mut desk);
    }

    /// Writes whole frames for the host into `up`; returns the number of bytes.
    pub fn transmit(&mut self, now: Instant, up: &mut [u8]) -> usize {
        let mut desk = Direct {
            controller: &mut self.controller,
            verdicts: &mut self.verdicts,
        };
        self.link.transmit(now, up, &mut desk)
    }

    /// One control period: takes the host's bytes, ticks, and writes whole
    /// frames for the host into `up`. Returns the torque command and the
    /// number of bytes written.
    pub fn exchange(&mut self, now: Instant, state: &DriveState, down: &[u8], up: &mut [u8]) -> (DriveCommand, usize) {
        self.receive(down);
        let command = self.controller.tick(now, state);
        (command, self.transmit(now, up))
    }
}

/// The controller at hand: commands are carried out as they come.
struct Direct<'a, const N: usize> {
    controller: &'a mut Controller<N>,
    verdicts: &'a mut Deque<Verdict, VERDICTS>,
}

impl<const N: usize> Desk for Direct<'_, N> {
    fn heard(&mut self) {
        self.controller.heard();
    }

    fn command(&mut self, sequence: u32, command: Command) -> bool {
        if self.verdicts.is_full() {
            return false;
        }
        let result = self.controller.command(command);
        self.verdicts.push_back(Verdict { sequence, result }).is_ok()
    }

    fn verdict(&mut self) -> Option<Verdict> {
        self.verdicts.pop_front()
    }

    fn event(&mut self) -> Option<Event> {
        self.controller.event()
    }

    fn samples_waiting(&self) -> usize {
        self.controller.samples_waiting()
    }

    fn sample(&mut self) -> Option<Sample> {
        self.controller.sample()
    }

    fn statistics(&self) -> Statistics {
        self.controller.statistics()
    }
}
