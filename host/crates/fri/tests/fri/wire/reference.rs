//! The documented fields as `prost` messages, written here by hand: the independent reference.

#![allow(clippy::struct_field_names, reason = "the names are those of the documentation")]

#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct JointValues {
    #[prost(double, repeated, packed = "false", tag = "1")]
    pub value: Vec<f64>,
}
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct PackedValues {
    #[prost(double, repeated, tag = "1")]
    pub value: Vec<f64>,
}
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Header {
    #[prost(uint32, required, tag = "1")]
    pub message_identifier: u32,
    #[prost(uint32, required, tag = "2")]
    pub sequence_counter: u32,
    #[prost(uint32, required, tag = "3")]
    pub reflected_sequence_counter: u32,
}
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct RobotInfo {
    #[prost(int32, optional, tag = "1")]
    pub number_of_joints: Option<i32>,
    #[prost(int32, optional, tag = "2")]
    pub safety_state: Option<i32>,
    #[prost(int32, repeated, packed = "false", tag = "5")]
    pub drive_state: Vec<i32>,
    #[prost(int32, optional, tag = "6")]
    pub operation_mode: Option<i32>,
    #[prost(int32, optional, tag = "7")]
    pub control_mode: Option<i32>,
}
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Timestamp {
    #[prost(uint32, required, tag = "1")]
    pub sec: u32,
    #[prost(uint32, required, tag = "2")]
    pub nanosec: u32,
}
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct MonitorData {
    #[prost(message, optional, tag = "1")]
    pub measured_joint_position: Option<JointValues>,
    #[prost(message, optional, tag = "2")]
    pub measured_torque: Option<JointValues>,
    #[prost(message, optional, tag = "3")]
    pub commanded_joint_position: Option<JointValues>,
    #[prost(message, optional, tag = "4")]
    pub commanded_torque: Option<JointValues>,
    #[prost(message, optional, tag = "5")]
    pub external_torque: Option<JointValues>,
    // Not read by the crate: stands for everything that a cabinet sends beside.
    #[prost(bytes = "vec", repeated, tag = "8")]
    pub read_io_request: Vec<Vec<u8>>,
    #[prost(message, optional, tag = "15")]
    pub timestamp: Option<Timestamp>,
}
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct ConnectionInfo {
    #[prost(int32, required, tag = "1")]
    pub session_state: i32,
    #[prost(int32, required, tag = "2")]
    pub quality: i32,
    #[prost(uint32, optional, tag = "3")]
    pub send_period: Option<u32>,
    #[prost(uint32, optional, tag = "4")]
    pub receive_multiplier: Option<u32>,
}
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct IpoData {
    #[prost(message, optional, tag = "1")]
    pub joint_position: Option<JointValues>,
    #[prost(int32, optional, tag = "10")]
    pub client_command_mode: Option<i32>,
    #[prost(int32, optional, tag = "11")]
    pub overlay_type: Option<i32>,
    #[prost(double, optional, tag = "12")]
    pub tracking_performance: Option<f64>,
}
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Checksum {
    #[prost(int32, optional, tag = "1")]
    pub crc32: Option<i32>,
}
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct EndOfMessageData {
    #[prost(int32, optional, tag = "1")]
    pub message_length: Option<i32>,
    #[prost(message, optional, tag = "2")]
    pub message_checksum: Option<Checksum>,
}
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Monitoring {
    #[prost(message, required, tag = "1")]
    pub header: Header,
    #[prost(message, optional, tag = "2")]
    pub robot_info: Option<RobotInfo>,
    #[prost(message, optional, tag = "3")]
    pub monitor_data: Option<MonitorData>,
    #[prost(message, optional, tag = "4")]
    pub connection_info: Option<ConnectionInfo>,
    #[prost(message, optional, tag = "5")]
    pub ipo_data: Option<IpoData>,
    #[prost(bytes = "vec", repeated, tag = "6")]
    pub requested_transformations: Vec<Vec<u8>>,
    #[prost(message, optional, tag = "15")]
    pub end_of_message_data: Option<EndOfMessageData>,
}
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct CommandData {
    #[prost(message, optional, tag = "1")]
    pub joint_position: Option<JointValues>,
    #[prost(message, optional, tag = "2")]
    pub cartesian_wrench_feed_forward: Option<JointValues>,
    #[prost(message, optional, tag = "3")]
    pub joint_torque: Option<JointValues>,
}
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Command {
    #[prost(message, required, tag = "1")]
    pub header: Header,
    #[prost(message, optional, tag = "2")]
    pub command_data: Option<CommandData>,
    #[prost(message, optional, tag = "15")]
    pub end_of_message_data: Option<EndOfMessageData>,
}
