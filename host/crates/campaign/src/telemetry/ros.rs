//! What all messages of ROS 2 share: their definitions in a file, their time and their frame.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

/// A message type of the telemetry file.
pub(super) trait RosMessage: Serialize {
    /// Topic of its channel.
    const TOPIC: &'static str;
    /// Name of its type.
    const TYPE: &'static str;
    /// Its fields, as its `.msg` file has them.
    const FIELDS: &'static str;
}

/// Types that messages are made of: name and fields.
const TYPES: [(&str, &str); 9] = [
    ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n"),
    ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"),
    ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/Point32", "float32 x\nfloat32 y\nfloat32 z\n"),
    ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"),
    (
        "geometry_msgs/Quaternion",
        "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    ),
    (
        "geometry_msgs/Wrench",
        "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n",
    ),
    (
        "geometry_msgs/Transform",
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    ),
    (
        "geometry_msgs/TransformStamped",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
    ),
];

/// The definition of a message type as a file carries it: its fields, then each type that it is made of.
pub(super) fn definition<M: RosMessage>() -> String {
    let rule = "=".repeat(80);
    let (mut text, mut parts) = (M::FIELDS.to_owned(), 0);
    // A part may be made of parts itself: they are behind it.
    while let Some((name, fields)) = part(&text, parts) {
        text += &format!("{rule}\nMSG: {name}\n{fields}");
        parts += 1;
    }
    text
}

/// The type that stands in `text` as the `number`th of those which differ.
fn part(text: &str, number: usize) -> Option<(&'static str, &'static str)> {
    let mut found: Vec<(&str, &str)> = Vec::new();
    for line in text.lines() {
        let kind = line.split(['[', ' ']).next();
        let known = TYPES.iter().find(|(name, _)| kind == Some(name));
        found.extend(known.filter(|known| !found.contains(known)));
    }
    found.get(number).copied()
}

/// A time, UTC.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Time {
    /// Whole seconds since 1970. ROS counts them in 32 bits: until 2038.
    pub sec: i32,
    /// The rest, in ns.
    pub nanosec: u32,
}

impl Time {
    /// From a time in ns since 1970.
    pub fn from_ns(time_ns: u64) -> Self {
        Self {
            sec: i32::try_from(time_ns / 1_000_000_000).unwrap_or(i32::MAX),
            nanosec: (time_ns % 1_000_000_000) as u32,
        }
    }
}

/// Time and frame of a message: `std_msgs/msg/Header`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header<'a> {
    /// Time, UTC.
    pub stamp: Time,
    /// Name of the frame whose axes are used; empty for none.
    pub frame_id: Cow<'a, str>,
}

impl<'a> Header<'a> {
    pub(super) fn new(utc_ns: u64, frame: &'a str) -> Self {
        Self {
            stamp: Time::from_ns(utc_ns),
            frame_id: frame.into(),
        }
    }
}
