//! What a caller wants of a bag, its messages, and which of its topics are taken.
//!
//! Without a choice of the caller: the only topic of joint states, and the only one of `PointStamped`. Other types are
//! taken only where the caller names their topic: a bag often has poses that the robot computed itself, and numbers that
//! mean something else.

use std::collections::BTreeMap;
use std::path::Path;
use std::rc::Rc;

use spherecal_budget::files::TOPICS;
use spherecal_model::excerpt;

use super::error::{BadMessage, BagError};
use super::messages::{JOINT_STATE, MessageRefusal, TARGETS, TargetKind, target_kind};

/// The type of targets that is taken without being named.
pub(crate) const POINT: &str = TARGETS[0].0;
/// Most topics that a message lists.
const LISTED: usize = 8;

/// The topics of a bag with the number of their messages.
#[derive(Debug, Default)]
pub(crate) struct Topics {
    seen: BTreeMap<String, (Rc<Topic>, u64)>,
}

/// What is taken from a bag.
#[derive(Clone, Debug)]
pub(crate) struct ChosenTopics {
    pub(crate) joints: Rc<Topic>,
    pub(crate) targets: Rc<Topic>,
}

/// The kind of targets that a topic has, if it can be taken: its type is known, and it is named, or nothing is named and
/// its type is taken without that.
pub(crate) fn taken(topic: &Topic, named: &[String]) -> Option<TargetKind> {
    let wanted = if named.is_empty() {
        topic.kind == POINT
    } else {
        named.contains(&topic.name)
    };
    wanted.then(|| target_kind(&topic.kind))?
}

impl Topics {
    /// Counts a message; returns its number on its topic, from 1. `None` for too many topics.
    pub(crate) fn count(&mut self, topic: &Rc<Topic>) -> Option<u64> {
        if let Some((_, count)) = self.seen.get_mut(&topic.name) {
            *count += 1;
            return Some(*count);
        }
        if self.seen.len() >= TOPICS {
            return None;
        }
        self.seen.insert(topic.name.clone(), (topic.clone(), 1));
        Some(1)
    }

    pub(crate) fn messages(&self, topic: &Topic) -> u64 {
        self.seen.get(&topic.name).map_or(0, |(_, count)| *count)
    }

    /// The topics to take.
    /// Errors: none or several that could be meant, and names that are not in the bag.
    pub(crate) fn choose(&self, bag: &str, named: &[String]) -> Result<ChosenTopics, BagError> {
        let refuse = |what: String, remedy: String| BagError::Topics {
            path: bag.to_owned(),
            what,
            remedy,
        };
        if let Some(name) = named.iter().find(|name| !self.seen.contains_key(*name)) {
            return Err(refuse(
                format!("has no message on the topic \"{}\"", excerpt(name)),
                format!("name topics of the bag: {}", self.list(|_| true)),
            ));
        }
        let joints = |t: &Topic| t.kind == JOINT_STATE && (named.is_empty() || named.contains(&t.name));
        let targets = |t: &Topic| taken(t, named).is_some();
        let joints = self.only(joints, "joint states", &format!("a topic of {JOINT_STATE}"), &refuse)?;
        let cdr = |topic: &Topic| {
            if topic.encoding != "cdr" {
                return Err(refuse(
                    format!(
                        "topic {} ({}) is encoded as \"{}\", and ROS 2 writes \"cdr\"",
                        excerpt(&topic.name),
                        excerpt(&topic.kind),
                        excerpt(&topic.encoding)
                    ),
                    "give a bag of ROS 2; `spherecal export --format ros2` makes one of spherecal's telemetry, and \
                     `rosbags-convert` one of a bag of ROS 1"
                        .to_owned(),
                ));
            }
            Ok(())
        };
        cdr(&joints)?;
        let types: Vec<&str> = TARGETS.iter().map(|(name, _)| *name).collect();
        let or_named = format!(
            "a topic of {POINT} (a measured point; in a frame sphere_N a contact with sphere N), or one of {} that \
             --topics names",
            types[1..].join(", ")
        );
        let targets = self.only(targets, "measured points or contacts", &or_named, &refuse)?;
        cdr(&targets)?;
        Ok(ChosenTopics { joints, targets })
    }

    /// The only topic that is wanted.
    fn only(
        &self,
        wanted: impl Fn(&Topic) -> bool,
        what: &str,
        needed: &str,
        refuse: &impl Fn(String, String) -> BagError,
    ) -> Result<Rc<Topic>, BagError> {
        let mut found = self.seen.values().map(|(topic, _)| topic).filter(|topic| wanted(topic));
        match (found.next(), found.next()) {
            (Some(topic), None) => Ok(topic.clone()),
            (None, _) => Err(refuse(
                format!("has no topic with {what} that is taken; it has {}", self.list(|_| true)),
                format!("record {needed}"),
            )),
            (Some(_), Some(_)) => Err(refuse(
                format!("has several topics with {what}: {}", self.list(&wanted)),
                "name the topic of the joint states and that of the points or contacts: --topics /joint_states,/point"
                    .to_owned(),
            )),
        }
    }

    fn list(&self, wanted: impl Fn(&Topic) -> bool) -> String {
        let all: Vec<String> = self
            .seen
            .values()
            .filter(|(topic, _)| wanted(topic))
            .map(|(topic, _)| format!("{} ({})", excerpt(&topic.name), excerpt(&topic.kind)))
            .collect();
        match all.len() {
            0 => "no messages".to_owned(),
            n if n > LISTED => format!("{} and {} more", all[..LISTED].join(", "), n - LISTED),
            _ => all.join(", "),
        }
    }
}

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

/// What is wanted of a bag.
#[derive(Clone, Debug, PartialEq)]
pub struct Wanted {
    /// Names of the robot's joints as the joint states have them, base to flange.
    pub joints: Vec<String>,
    /// Other names of the same joints, taken where a joint state has not all of `joints`; or none.
    pub other_joints: Vec<String>,
    /// Topics that are taken; empty to take the only ones that could be meant.
    pub topics: Vec<String>,
    /// Parent and child frame of the transform that is the target, on a topic of `tf2_msgs/msg/TFMessage`.
    pub transform: Option<(String, String)>,
    /// Width of the band in which a joint counts as resting, in rad.
    pub rest_rad: f64,
    /// Whether `effort` is the measured torque in N m.
    pub effort_nm: bool,
}

impl Wanted {
    /// The usual band of a rest, in rad.
    pub const REST_RAD: f64 = 0.5e-3;

    /// Joint states of these joints, and whatever else is usual.
    pub fn new(joints: Vec<String>) -> Self {
        Self {
            joints,
            other_joints: Vec::new(),
            topics: Vec::new(),
            transform: None,
            rest_rad: Self::REST_RAD,
            effort_nm: false,
        }
    }
}

/// The refusal of message `number` of a topic in a file.
pub(crate) fn bad_message(path: &Path, topic: &Topic, number: u64, (what, remedy): MessageRefusal) -> BagError {
    BagError::from(Box::new(BadMessage {
        path: path.display().to_string(),
        topic: topic.name.clone(),
        kind: topic.kind.clone(),
        number,
        what,
        remedy,
    }))
}
