//! Steps controller and drive in lock-step.

use spherecal_shared::protocol::PROTOCOL_VERSION;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState, MOST_LATENCY_US, PERIODS_US};
use spherecal_shared::protocol::frame::LinkCounters;

use super::{Controller, Device, Drive, LinkError};

/// Periods after which the controller learns how punctual its loop is.
const TIMING_TICKS: u64 = 100;

/// A controller and a drive, stepped one control period at a time. The clock counts periods, missed
/// ones included.
pub struct LocalDevice {
    controller: Box<dyn Controller>,
    drive: Box<dyn Drive>,
    hello: DriveHello,
    state: DriveState,
    command: Option<DriveCommand>,
    missed: u64,
    ticks: u64,
}

impl LocalDevice {
    /// Joins a controller and a drive for a robot with `joints` joints.
    ///
    /// # Errors
    /// The drive speaks another protocol, has another number of joints, or states a control period
    /// that is out of range.
    pub fn new(mut controller: Box<dyn Controller>, drive: Box<dyn Drive>, joints: usize) -> Result<Self, LinkError> {
        let hello = drive.hello().clone();
        check_hello(&hello, joints)?;
        controller.connect(&hello)?;
        Ok(Self {
            controller,
            drive,
            hello,
            state: DriveState::default(),
            command: None,
            missed: 0,
            ticks: 0,
        })
    }

    /// The drive's hello.
    pub fn hello(&self) -> &DriveHello {
        &self.hello
    }

    /// The last joint state of the drive.
    pub fn state(&self) -> &DriveState {
        &self.state
    }

    /// The last torque command.
    pub fn command(&self) -> Option<&DriveCommand> {
        self.command.as_ref()
    }

    /// What was received on the drive link.
    pub fn drive_counters(&self) -> LinkCounters {
        self.drive.counters()
    }
}

impl Device for LocalDevice {
    fn simulated(&self) -> Option<bool> {
        Some(self.hello.simulated)
    }

    fn now_us(&self) -> u64 {
        let periods = self.ticks.saturating_sub(1).saturating_add(self.missed);
        periods.saturating_mul(u64::from(self.hello.period_us))
    }

    fn ticks(&self) -> u64 {
        self.ticks
    }

    /// One control period: the drive moves under the last command, then the controller answers the
    /// new state.
    fn step(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        self.drive.exchange(self.command.as_ref(), &mut self.state)?;
        let missed = self.drive.missed();
        self.missed = self.missed.saturating_add(u64::from(missed));
        self.ticks += 1;
        self.controller.missed(missed);
        if self.ticks.is_multiple_of(TIMING_TICKS)
            && let Some(timing) = self.drive.timing()
        {
            self.controller.timing(timing);
        }
        let command = self.controller.exchange(self.now_us(), &self.state, down, up)?;
        // Before anything else, such as the bytes for the host, takes time.
        self.drive.answer(&command)?;
        self.command = Some(command);
        Ok(())
    }

    fn move_plate(&mut self, place: u32) -> bool {
        self.drive.move_plate(place)
    }

    fn monitor(&self) -> Option<crate::native::Monitor> {
        self.drive.monitor()
    }
}

/// Checks that this program can work with a drive, for a robot with `joints` joints.
///
/// # Errors
/// The drive speaks another protocol, has another number of joints, or states a control period that
/// is out of range.
pub fn check_hello(hello: &DriveHello, joints: usize) -> Result<(), LinkError> {
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
    if !PERIODS_US.contains(&hello.period_us) {
        return Err(LinkError::Period {
            period_us: hello.period_us,
        });
    }
    if hello.latency_us > MOST_LATENCY_US {
        return Err(LinkError::Latency {
            latency_us: hello.latency_us,
        });
    }
    Ok(())
}
