//! The control path.

use embassy_time::Instant;
use spherecal_shared::protocol::drive::{DriveCommand, DriveState};
use spherecal_shared::protocol::host::{Downlink, Uplink};

/// The controller of an arm with `N` joints.
#[derive(Clone, Debug, Default)]
pub struct Controller<const N: usize> {}

impl<const N: usize> Controller<N> {
    /// One control period: joint state in, joint torque out.
    pub fn tick(&mut self, _now: Instant, state: &DriveState) -> DriveCommand {
        DriveCommand {
            tick: state.tick,
            ..DriveCommand::default()
        }
    }

    /// Takes a command; its reply appears among the events.
    pub fn command(&mut self, _now: Instant, _command: Downlink) {}

    /// The next event for the host.
    pub fn event(&mut self) -> Option<Uplink> {
        None
    }
}
