//! Controller and drive in lock-step.

use spherecal_shared::protocol::PROTOCOL_VERSION;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState};

use super::{Controller, Drive, LinkError};

/// Controller and drive, stepped one control period at a time; its clock is
/// the number of periods.
pub struct Cell {
    controller: Box<dyn Controller>,
    drive: Box<dyn Drive>,
    hello: DriveHello,
    state: DriveState,
    command: Option<DriveCommand>,
    first_tick: u64,
    ticks: u64,
}

impl Cell {
    /// Joins a controller and a drive for a robot with `joints` joints.
    ///
    /// # Errors
    /// When the drive speaks another protocol, has another number of joints or
    /// an impossible control period.
    pub fn new(mut controller: Box<dyn Controller>, drive: Box<dyn Drive>, joints: usize) -> Result<Self, LinkError> {
        let hello = drive.hello().clone();
        if hello.protocol != PROTOCOL_VERSION {
            return Err(LinkError::Protocol {
                found: hello.protocol,
                expected: PROTOCOL_VERSION,
            });
        }
        if hello.limits.len() != joints {
            return Err(LinkError::OtherRobot {
                drive: hello.limits.len(),
                robot: joints,
            });
        }
        if !(100..=10_000).contains(&hello.period_us) {
            return Err(LinkError::Period {
                period_us: hello.period_us,
            });
        }
        controller.connect(&hello)?;
        Ok(Self {
            controller,
            drive,
            hello,
            state: DriveState::default(),
            command: None,
            first_tick: 0,
            ticks: 0,
        })
    }

    /// What the drive says of itself.
    pub fn hello(&self) -> &DriveHello {
        &self.hello
    }

    /// Device time, in µs since the first period.
    pub fn now_us(&self) -> u64 {
        self.state
            .tick
            .saturating_sub(self.first_tick)
            .saturating_mul(u64::from(self.hello.period_us))
    }

    /// Control periods carried out.
    pub fn ticks(&self) -> u64 {
        self.ticks
    }

    /// The last joint state of the drive.
    pub fn state(&self) -> &DriveState {
        &self.state
    }

    /// The last torque command.
    pub fn command(&self) -> Option<&DriveCommand> {
        self.command.as_ref()
    }

    /// One control period: the drive moves under the last command, the
    /// controller answers its new state. `down` are the host's bytes; the
    /// controller's are appended to `up`.
    ///
    /// # Errors
    /// When one of them fails for good.
    pub fn step(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        self.drive.exchange(self.command.as_ref(), &mut self.state)?;
        if self.ticks == 0 {
            self.first_tick = self.state.tick;
        }
        self.ticks += 1;
        let command = self.controller.exchange(self.now_us(), &self.state, down, up)?;
        self.command = Some(command);
        Ok(())
    }
}
