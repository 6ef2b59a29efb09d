//! A message of a bag, and its topic.

use std::rc::Rc;

/// Longest record that is read, in bytes: the most that a stream keeps in memory. A chunk of a bag has some MiB, and a picture of
/// 4K in full colour 25 MiB.
pub const MOST_RECORD_BYTES: usize = 64 << 20;

/// A topic of one file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Topic {
    pub(crate) name: String,
    /// Name of its type, as `package/msg/Type`.
    pub(crate) kind: String,
    /// How its messages are encoded.
    pub(crate) encoding: String,
}

/// A message.
pub(crate) struct BagMessage<'a> {
    pub(crate) topic: &'a Rc<Topic>,
    /// When it was recorded, in ns.
    pub(crate) time_ns: i64,
    pub(crate) data: &'a [u8],
}

/// `sensor_msgs/JointState` as `sensor_msgs/msg/JointState`.
pub(crate) fn full_name(kind: &str) -> String {
    match kind.split_once('/') {
        Some((package, name)) if !name.contains('/') => format!("{package}/msg/{name}"),
        _ => kind.to_owned(),
    }
}
