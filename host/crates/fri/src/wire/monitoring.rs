//! What the cabinet sends each period.

use super::command::MessageHeader;
use super::framing::{END_FIELD, EndOfMessage};
use super::protobuf::{FieldReader, FieldValue, FieldWriter};
use super::{
    ClientCommandMode, ControlMode, DriveState, MAX_MESSAGE_SIZE, OperationMode, OverlayType, Quality, SafetyState,
    SessionState, WireError,
};
use crate::JOINTS;

const IDENTIFIER: u32 = 0x0024_5142;

/// `robotInfo`: what the robot is allowed to do. A field that the cabinet does not send is `None`: unknown.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RobotInfo {
    /// `numberOfJoints`.
    pub number_of_joints: Option<u32>,
    /// `safetyState`.
    pub safety: Option<SafetyState>,
    /// `driveState` of each joint.
    pub drives: Option<[DriveState; JOINTS]>,
    /// `operationMode`.
    pub operation: Option<OperationMode>,
    /// `controlMode`.
    pub control: Option<ControlMode>,
}

/// The cabinet's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timestamp {
    /// Seconds.
    pub sec: u32,
    /// Nanoseconds.
    pub nanosec: u32,
}

/// `connectionInfo`: how the session stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConnectionInfo {
    /// `sessionState`.
    pub session: SessionState,
    /// `quality`.
    pub quality: Quality,
    /// `sendPeriod`: time between two monitoring messages, ms.
    pub send_period_ms: Option<u32>,
    /// `receiveMultiplier`: the cabinet expects an answer to each n-th message.
    pub receive_multiplier: Option<u32>,
}

impl Default for ConnectionInfo {
    fn default() -> Self {
        Self {
            session: SessionState::Idle,
            quality: Quality::Poor,
            send_period_ms: None,
            receive_multiplier: None,
        }
    }
}

/// `ipoData`: the cabinet's own interpolator.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct IpoData {
    /// `jointPosition`: interpolated joint positions, rad.
    pub joint_position: Option<[f64; JOINTS]>,
    /// `clientCommandMode`.
    pub command_mode: Option<ClientCommandMode>,
    /// `overlayType`.
    pub overlay: Option<OverlayType>,
    /// `trackingPerformance`: 0 to 1.
    pub tracking_performance: Option<f64>,
}

/// What the cabinet measures and does (`FRIMonitoringMessage`).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MonitoringMessage {
    /// Counts the cabinet's messages.
    pub sequence: u32,
    /// The sequence number of the newest command that the cabinet received.
    pub reflected_sequence: u32,
    /// What the robot is allowed to do.
    pub robot: RobotInfo,
    /// `measuredJointPosition`, rad.
    pub measured_position: [f64; JOINTS],
    /// `measuredTorque`, gravity included, N m.
    pub measured_torque: [f64; JOINTS],
    /// `commandedJointPosition`, rad.
    pub commanded_position: Option<[f64; JOINTS]>,
    /// `commandedTorque`, N m.
    pub commanded_torque: Option<[f64; JOINTS]>,
    /// `externalTorque`: the cabinet's estimate, N m.
    pub external_torque: Option<[f64; JOINTS]>,
    /// `timestamp`.
    pub time: Option<Timestamp>,
    /// How the session stands.
    pub connection: ConnectionInfo,
    /// The cabinet's interpolator, sent while commanding.
    pub ipo: Option<IpoData>,
    /// Length and checksum, where the cabinet states them.
    pub end: Option<EndOfMessage>,
}

impl MonitoringMessage {
    /// Decodes a message.
    ///
    /// # Errors
    /// A [`WireError`] for bytes that are no monitoring message: no header, no connection info, no measured positions or
    /// torques, not seven joints, a number that is not finite, an enumeration without meaning.
    pub fn decode(bytes: &[u8]) -> Result<Self, WireError> {
        if bytes.len() > MAX_MESSAGE_SIZE {
            return Err(WireError::TooLong { got: bytes.len() });
        }
        let (mut header, mut robot, mut connection) = (None, RobotInfo::default(), None);
        let (mut data, mut ipo, mut end) = (MonitorData::default(), None, None);
        let mut read = FieldReader::new("FRIMonitoringMessage", bytes);
        loop {
            let before = read.at();
            let Some((field, value)) = read.next()? else { break };
            match field {
                1 => header = Some(MessageHeader::decode(value.bytes("header")?, IDENTIFIER)?),
                2 => robot = robot_info(value.bytes("robotInfo")?)?,
                3 => data = MonitorData::decode(value.bytes("monitorData")?)?,
                4 => connection = Some(connection_info(value.bytes("connectionInfo")?)?),
                5 => ipo = Some(ipo_data(value.bytes("ipoData")?)?),
                END_FIELD => {
                    let before = bytes.get(..before).unwrap_or_default();
                    end = Some(EndOfMessage::decode(value.bytes("endOfMessageData")?, before)?);
                }
                _ => {}
            }
        }
        let missing = |field| WireError::Missing { field };
        let header = header.ok_or(missing("header"))?;
        Ok(Self {
            sequence: header.sequence,
            reflected_sequence: header.reflected,
            robot,
            measured_position: data.measured_position.ok_or(missing("measuredJointPosition"))?,
            measured_torque: data.measured_torque.ok_or(missing("measuredTorque"))?,
            commanded_position: data.commanded_position,
            commanded_torque: data.commanded_torque,
            external_torque: data.external_torque,
            time: data.time,
            connection: connection.ok_or(missing("connectionInfo"))?,
            ipo,
            end,
        })
    }

    /// Encodes the message; returns its size in bytes. `checksum` appends `endOfMessageData`.
    ///
    /// # Errors
    /// [`WireError::TooLong`] never happens with the fields of this message; the type demands it.
    pub fn encode(&self, out: &mut [u8; MAX_MESSAGE_SIZE], checksum: bool) -> Result<usize, WireError> {
        let mut write = FieldWriter::new(out);
        MessageHeader {
            sequence: self.sequence,
            reflected: self.reflected_sequence,
        }
        .write(&mut write, IDENTIFIER);
        write.message(2, |w| {
            optional(w, 1, self.robot.number_of_joints.map(u64::from));
            optional(w, 2, self.robot.safety.map(SafetyState::number));
            for drive in self.robot.drives.iter().flatten() {
                w.number(5, drive.number());
            }
            optional(w, 6, self.robot.operation.map(OperationMode::number));
            optional(w, 7, self.robot.control.map(ControlMode::number));
        });
        write.message(3, |w| {
            w.doubles(1, &self.measured_position);
            w.doubles(2, &self.measured_torque);
            for (field, values) in [
                (3, &self.commanded_position),
                (4, &self.commanded_torque),
                (5, &self.external_torque),
            ] {
                if let Some(values) = values {
                    w.doubles(field, values);
                }
            }
            if let Some(time) = self.time {
                w.message(15, |w| {
                    w.number(1, time.sec.into());
                    w.number(2, time.nanosec.into());
                });
            }
        });
        write.message(4, |w| {
            w.number(1, self.connection.session.number());
            w.number(2, self.connection.quality.number());
            optional(w, 3, self.connection.send_period_ms.map(u64::from));
            optional(w, 4, self.connection.receive_multiplier.map(u64::from));
        });
        if let Some(ipo) = &self.ipo {
            write.message(5, |w| {
                if let Some(position) = &ipo.joint_position {
                    w.doubles(1, position);
                }
                optional(w, 10, ipo.command_mode.map(ClientCommandMode::number));
                optional(w, 11, ipo.overlay.map(OverlayType::number));
                if let Some(performance) = ipo.tracking_performance {
                    w.double(12, performance);
                }
            });
        }
        if checksum {
            EndOfMessage::write(&mut write);
        }
        write.finish()
    }
}

fn optional(out: &mut FieldWriter<'_>, field: u32, value: Option<u64>) {
    if let Some(value) = value {
        out.number(field, value);
    }
}

#[derive(Default)]
struct MonitorData {
    measured_position: Option<[f64; JOINTS]>,
    measured_torque: Option<[f64; JOINTS]>,
    commanded_position: Option<[f64; JOINTS]>,
    commanded_torque: Option<[f64; JOINTS]>,
    external_torque: Option<[f64; JOINTS]>,
    time: Option<Timestamp>,
}

impl MonitorData {
    fn decode(bytes: &[u8]) -> Result<Self, WireError> {
        let mut data = Self::default();
        let mut read = FieldReader::new("monitorData", bytes);
        while let Some((field, value)) = read.next()? {
            match field {
                1 => data.measured_position = Some(value.doubles("measuredJointPosition")?),
                2 => data.measured_torque = Some(value.doubles("measuredTorque")?),
                3 => data.commanded_position = Some(value.doubles("commandedJointPosition")?),
                4 => data.commanded_torque = Some(value.doubles("commandedTorque")?),
                5 => data.external_torque = Some(value.doubles("externalTorque")?),
                15 => {
                    let mut time = Timestamp::default();
                    let mut inner = FieldReader::new("timestamp", value.bytes("timestamp")?);
                    while let Some((field, value)) = inner.next()? {
                        match field {
                            1 => time.sec = value.u32("sec")?,
                            2 => time.nanosec = value.u32("nanosec")?,
                            _ => {}
                        }
                    }
                    data.time = Some(time);
                }
                _ => {}
            }
        }
        Ok(data)
    }
}

fn robot_info(bytes: &[u8]) -> Result<RobotInfo, WireError> {
    let mut info = RobotInfo::default();
    let mut drives = [DriveState::Off; JOINTS];
    let mut count = 0;
    let mut drive = |number: u64| {
        let place = drives.get_mut(count).ok_or(WireError::Count {
            field: "driveState",
            expected: JOINTS,
            got: JOINTS + 1,
        })?;
        *place = DriveState::from_number(number)?;
        count += 1;
        Ok(())
    };
    let mut read = FieldReader::new("robotInfo", bytes);
    while let Some((field, value)) = read.next()? {
        match field {
            1 => info.number_of_joints = Some(value.u32("numberOfJoints")?),
            2 => info.safety = Some(SafetyState::from_number(value.u64("safetyState")?)?),
            5 => match value {
                // Packed: one byte each, because all numbers are below 128.
                FieldValue::Bytes(packed) => packed.iter().try_for_each(|d| drive(u64::from(*d)))?,
                value => drive(value.u64("driveState")?)?,
            },
            6 => info.operation = Some(OperationMode::from_number(value.u64("operationMode")?)?),
            7 => info.control = Some(ControlMode::from_number(value.u64("controlMode")?)?),
            _ => {}
        }
    }
    info.drives = match count {
        0 => None,
        JOINTS => Some(drives),
        got => {
            return Err(WireError::Count {
                field: "driveState",
                expected: JOINTS,
                got,
            });
        }
    };
    Ok(info)
}

fn connection_info(bytes: &[u8]) -> Result<ConnectionInfo, WireError> {
    let (mut session, mut quality, mut send_period_ms, mut receive_multiplier) = (None, None, None, None);
    let mut read = FieldReader::new("connectionInfo", bytes);
    while let Some((field, value)) = read.next()? {
        match field {
            1 => session = Some(SessionState::from_number(value.u64("sessionState")?)?),
            2 => quality = Some(Quality::from_number(value.u64("quality")?)?),
            3 => send_period_ms = Some(value.u32("sendPeriod")?),
            4 => receive_multiplier = Some(value.u32("receiveMultiplier")?),
            _ => {}
        }
    }
    Ok(ConnectionInfo {
        session: session.ok_or(WireError::Missing { field: "sessionState" })?,
        quality: quality.ok_or(WireError::Missing { field: "quality" })?,
        send_period_ms,
        receive_multiplier,
    })
}

fn ipo_data(bytes: &[u8]) -> Result<IpoData, WireError> {
    let mut ipo = IpoData::default();
    let mut read = FieldReader::new("ipoData", bytes);
    while let Some((field, value)) = read.next()? {
        match field {
            1 => ipo.joint_position = Some(value.doubles("ipoData.jointPosition")?),
            10 => ipo.command_mode = Some(ClientCommandMode::from_number(value.u64("clientCommandMode")?)?),
            11 => ipo.overlay = Some(OverlayType::from_number(value.u64("overlayType")?)?),
            12 => ipo.tracking_performance = Some(value.double("trackingPerformance")?),
            _ => {}
        }
    }
    Ok(ipo)
}
