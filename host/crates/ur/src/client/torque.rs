//! The client that commands torques.

use super::channel::Channel;
use super::rtde::{Fields, Rtde};
use super::state::finite;
use super::{ClientConfig, ClientError, DashboardCommand, RobotState, ask_dashboard, ask_robot_api};
use crate::JOINTS;
use crate::wire::{
    ACKNOWLEDGED, ControllerVersion, FieldType, INPUTS, Load, Order, PROGRAM, Reader, Series, Taken, WireError,
    data_package, take_data,
};

/// The fields that this client reads, in this order.
const OUTPUTS: &Fields = &[
    ("timestamp", FieldType::Double),
    ("actual_q", FieldType::Vector6D),
    ("actual_qd", FieldType::Vector6D),
    ("robot_mode", FieldType::Int32),
    ("safety_mode", FieldType::Int32),
    ("runtime_state", FieldType::Uint32),
    ("actual_current_as_torque", FieldType::Vector6D),
    (ACKNOWLEDGED, FieldType::Int32),
];
/// Bytes of a package of inputs: header, number of the recipe, two integers, 16 doubles.
const PACKAGE: usize = 4 + 2 * 4 + 16 * 8;

/// The robot at one instant, as far as torques need it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TorqueState {
    /// Angles, velocities, modes.
    pub robot: RobotState,
    /// Torques of the motors beyond those that hold arm and load, seen at the joints, N m.
    pub motor_torque: [f64; JOINTS],
    /// The last number that the program has acknowledged.
    pub acknowledged: i32,
}

impl TorqueState {
    fn read(bytes: &mut Reader<'_>) -> Result<Self, WireError> {
        let state = Self {
            robot: RobotState::read(bytes)?,
            motor_torque: bytes.doubles("actual_current_as_torque")?,
            acknowledged: bytes.i32(ACKNOWLEDGED)?,
        };
        finite(state.motor_torque.iter())?;
        Ok(state)
    }
}

/// A connection over which torques are commanded by [our own program](PROGRAM). It allocates nothing while it runs.
pub struct TorqueClient {
    rtde: Rtde,
    outputs: u8,
    inputs: u8,
    load: Load,
    /// Number of the last package of inputs.
    number: i32,
    /// The connection over which the program was sent. It stays open until the next one.
    primary: Option<Channel>,
}

impl TorqueClient {
    /// Connects to an e-Series or newer robot, and takes the registers of the program. No program is started. `load` is what
    /// the program tells the robot to carry.
    ///
    /// # Errors
    /// A [`ClientError`] if the robot cannot be reached or has no torques, or if another client writes a register.
    pub fn connect(config: &ClientConfig, load: Load) -> Result<Self, ClientError> {
        let mut rtde = Rtde::connect(config)?;
        if !rtde.version.has_torques() {
            return Err(ClientError::NoTorques { version: rtde.version });
        }
        let outputs = rtde.outputs(OUTPUTS)?;
        let inputs = rtde.inputs(&INPUTS)?;
        rtde.start()?;
        Ok(Self {
            rtde,
            outputs,
            inputs,
            load,
            number: 0,
            primary: None,
        })
    }

    /// The version of the robot's software.
    pub fn version(&self) -> ControllerVersion {
        self.rtde.version
    }

    /// Whether the robot has answered from this computer, as only a simulated one does.
    pub fn is_local(&self) -> bool {
        self.rtde.channel.peer().ip().is_loopback()
    }

    /// Control period, s.
    pub const fn period_s() -> f64 {
        1.0 / Series::ESeries.rate_hz()
    }

    /// Waits for a state, and takes the newest one.
    ///
    /// # Errors
    /// [`ClientError::Silent`] or [`ClientError::Closed`] if none comes, [`ClientError::Wire`] if it is invalid.
    pub fn receive(&mut self, state: &mut TorqueState) -> Result<(), ClientError> {
        let after = self.rtde.config.state_timeout;
        let deadline = self.rtde.channel.now() + after;
        let mut found = false;
        loop {
            while let Some(taken) = take_data(&mut self.rtde.channel.received, self.outputs, TorqueState::read)? {
                if let Taken::Data(newest) = taken {
                    *state = newest;
                    found = true;
                }
            }
            if !self.rtde.channel.receive((!found).then_some(deadline))? {
                return if found {
                    Ok(())
                } else {
                    Err(ClientError::Silent { after })
                };
            }
        }
    }

    /// Sends an order under the next number, which it returns.
    ///
    /// # Errors
    /// [`ClientError::Closed`] or what the system says.
    pub fn send(&mut self, order: &Order) -> Result<i32, ClientError> {
        self.number = self.number.wrapping_add(1);
        let joints = match order {
            Order::Listen => &[0.0; JOINTS],
            Order::Torque(joints) | Order::Angles(joints) => joints,
        };
        let load = &self.load;
        let doubles = joints
            .iter()
            .chain([&load.mass_kg])
            .chain(&load.com_m)
            .chain(&load.inertia_kg_m2);
        let package: [u8; PACKAGE] = data_package(self.inputs, [order.number(), self.number], doubles);
        self.rtde.channel.send(&package)?;
        Ok(self.number)
    }

    /// Asks for these things, one after the other, and returns the last answer: the dashboard, or on PolyScope X the Robot API.
    ///
    /// # Errors
    /// A [`ClientError`] if that interface cannot be reached, does not answer in time, or refuses.
    pub fn ask(&self, commands: &[DashboardCommand]) -> Result<String, ClientError> {
        let Rtde { config, version, .. } = &self.rtde;
        if version.is_polyscope_x() {
            ask_robot_api(config, *version, commands)
        } else {
            ask_dashboard(config, commands)
        }
    }

    /// Sends the program to the primary interface. It runs when its first number is acknowledged.
    ///
    /// # Errors
    /// A [`ClientError`] if that interface cannot be reached.
    pub fn upload(&mut self) -> Result<(), ClientError> {
        let config = &self.rtde.config;
        let mut primary = Channel::connect(config, &config.addresses(config.primary_port())?)?;
        primary.send(PROGRAM.as_bytes())?;
        self.primary = Some(primary);
        Ok(())
    }
}
