//! A message of a bag, and its topic.

use std::rc::Rc;

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Topic {
    pub(crate) name: String,
    /// Name of its type, as `package/msg/Type`.
    pub(crate) kind: String,
    /// How its messages are encoded.
    pub(crate) encoding: String,
}

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
