//! Steps controller and drive in lock-step.

use embassy_time::Instant;
use spherecal_firmware::Node;
use spherecal_shared::protocol::PROTOCOL_VERSION;
use spherecal_shared::protocol::drive::{
    DriveCommand, DriveHello, DriveState, MOST_LATENCY_US, MOST_MOTOR_KG_M2, NO_SESSION, PERIODS_US,
};
use spherecal_shared::protocol::frame::{LinkCounters, MAX_FRAME};
use spherecal_shared::protocol::host::LoopTiming;
use spherecal_shared::robot::{JointLimits, Robot};

use super::tcp::check_limits;
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
/// The first field of the hello that cannot be, with its own remedy.
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
    if hello.session == NO_SESSION {
        return Err(LinkError::NoSession);
    }
    for (limits, joint) in hello.limits.iter().zip(1..) {
        let JointLimits {
            min_rad,
            max_rad,
            velocity_rad_s,
            torque_nm,
        } = *limits;
        for (field, value, above) in [
            ("the smallest angle in rad", min_rad, f64::NEG_INFINITY),
            ("the largest angle in rad", max_rad, min_rad),
            ("the largest speed in rad/s", velocity_rad_s, 0.0),
            ("the largest torque in N m", torque_nm, 0.0),
        ] {
            // NaN fails the comparison.
            if !(value.is_finite() && value > above) {
                return Err(LinkError::HelloLimit { joint, field, value });
            }
        }
    }
    let motors = hello.motor_kg_m2.len();
    if motors != 0 && motors != joints {
        return Err(LinkError::MotorCount { found: motors, joints });
    }
    for (inertia, joint) in hello.motor_kg_m2.iter().zip(1..) {
        if !(0.0..=MOST_MOTOR_KG_M2).contains(inertia) {
            return Err(LinkError::Motor {
                joint,
                inertia: *inertia,
            });
        }
    }
    if hello.latency_us > MOST_LATENCY_US {
        return Err(LinkError::Latency {
            latency_us: hello.latency_us,
        });
    }
    Ok(())
}

/// Checks a drive for the robot of this description, whose limits the plan was made with.
///
/// # Errors
/// The first field of the hello that cannot be, or the first limit that is tighter than the description's.
pub fn check_drive(hello: &DriveHello, robot: &Robot) -> Result<(), LinkError> {
    check_hello(hello, robot.dof())?;
    Ok(check_limits(&hello.limits, robot)?)
}

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

#[cfg(test)]
mod tests {
    use super::*;

    type Change = fn(&mut DriveHello);

    // Fails if a field of a hello that cannot be is accepted, or is told as another field.
    #[test]
    fn each_field_of_a_hello_has_its_own_refusal() {
        let limits = JointLimits {
            min_rad: -2.9,
            max_rad: 2.9,
            velocity_rad_s: 1.5,
            torque_nm: 100.0,
        };
        let good = DriveHello::new(5, [limits; 7]);
        check_hello(&good, 7).expect("a good one");
        let motors: Change = |hello| hello.motor_kg_m2 = [0.5; 7].into_iter().collect();
        let with_motors = {
            let mut hello = good.clone();
            motors(&mut hello);
            hello
        };
        check_hello(&with_motors, 7).expect("one inertia for each joint");
        let cases: [(Change, &str); 11] = [
            (|hello| hello.protocol = 1, "protocol 1"),
            (|hello| hello.session = 0, "session 0"),
            (|hello| hello.limits.truncate(6), "6 joints"),
            (
                |hello| hello.limits[2].min_rad = f64::NAN,
                "joint 3 has the smallest angle in rad NaN",
            ),
            (
                |hello| hello.limits[6].max_rad = -3.0,
                "joint 7 has the largest angle in rad -3",
            ),
            (
                |hello| hello.limits[0].velocity_rad_s = 0.0,
                "joint 1 has the largest speed in rad/s 0",
            ),
            (
                |hello| hello.limits[1].torque_nm = f64::INFINITY,
                "joint 2 has the largest torque in N m inf",
            ),
            (|hello| hello.period_us = 500, "500 µs"),
            (
                |hello| hello.motor_kg_m2 = [0.5; 3].into_iter().collect(),
                "3 inertias of motors",
            ),
            (
                |hello| hello.motor_kg_m2 = [0.5, 0.5, 0.5, 51.0, 0.5, 0.5, 0.5].into_iter().collect(),
                "motor of joint 4",
            ),
            (|hello| hello.latency_us = 5001, "5001 µs"),
        ];
        for (change, words) in cases {
            let mut hello = good.clone();
            change(&mut hello);
            let said = check_hello(&hello, 7).expect_err(words).to_string();
            assert!(said.contains(words), "{words}: {said}");
        }
    }
}
