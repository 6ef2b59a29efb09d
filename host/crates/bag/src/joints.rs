//! The robot's joints in joint states.

use spherecal_model::excerpt;

use super::error::BagError;
use super::messages::{JointStateMessage, MessageRefusal};
use super::targets::Targets;
use super::topics::{BagMessage, Wanted};

/// Takes the robot's joints from joint states.
pub(crate) struct JointReader<'a> {
    wanted: &'a Wanted,
    /// The bytes of the names that `order` belongs to.
    key: Vec<u8>,
    /// Where each of the robot's joints stands in a message with these names; `None` where one is missing.
    order: Option<Vec<usize>>,
    pub(crate) q: Vec<f64>,
    pub(crate) effort: Option<Vec<f64>>,
    /// The names of a message without all joints.
    other_names: Option<Vec<String>>,
    /// Messages with and without all joints.
    pub(crate) whole: u64,
    pub(crate) partial: u64,
    /// Whether efforts were there and were not taken.
    pub(crate) efforts: bool,
}

impl<'a> JointReader<'a> {
    pub(crate) fn new(wanted: &'a Wanted) -> Self {
        Self {
            wanted,
            key: Vec::new(),
            order: None,
            q: Vec::new(),
            effort: None,
            other_names: None,
            whole: 0,
            partial: 0,
            efforts: false,
        }
    }

    /// Takes a message; returns its time in ns, if it has all joints of the robot.
    pub(crate) fn take(&mut self, message: &BagMessage<'_>, by_header: bool) -> Result<Option<i64>, MessageRefusal> {
        let state = JointStateMessage::read(message.data)?;
        if state.names_key != self.key || self.whole + self.partial == 0 {
            self.key.clear();
            self.key.extend_from_slice(state.names_key);
            let names = state.names();
            let place = |joint: &String| names.iter().position(|name| name == joint);
            let places = |joints: &[String]| joints.iter().map(place).collect::<Option<Vec<usize>>>();
            let others = Some(&self.wanted.other_joints).filter(|others| !others.is_empty());
            self.order = places(&self.wanted.joints).or_else(|| places(others?));
            if self.order.is_none() && self.other_names.is_none() {
                self.other_names = Some(names.iter().map(|name| excerpt(name)).collect());
            }
        }
        let Some(order) = &self.order else {
            self.partial += 1;
            return Ok(None);
        };
        self.whole += 1;
        self.q.clear();
        for (&k, joint) in order.iter().zip(&self.wanted.joints) {
            let angle = state.position.get(k).ok_or_else(|| {
                (
                    format!(
                        "it names joint \"{}\" and has {} positions",
                        excerpt(joint),
                        state.position.len()
                    ),
                    "record joint states with the positions of all joints that they name".to_owned(),
                )
            })?;
            self.q.push(angle);
        }
        let efforts: Option<Vec<f64>> = order.iter().map(|&k| state.effort.get(k)).collect();
        self.effort = efforts.filter(|efforts| efforts.iter().all(|tau| tau.is_finite()));
        self.efforts |= self.effort.is_some();
        let time = state.time_ns.filter(|_| by_header);
        Ok(Some(time.unwrap_or(message.time_ns)))
    }

    /// Refuses a bag whose joint states are of another robot.
    pub(crate) fn check_joints(&self, bag: &str, found: &Targets) -> Result<(), BagError> {
        if self.whole > 0 {
            return Ok(());
        }
        let names = self.other_names.clone().unwrap_or_default();
        let missing: Vec<String> = self
            .wanted
            .joints
            .iter()
            .filter(|joint| !names.contains(joint))
            .map(|joint| excerpt(joint))
            .collect();
        let near = missing.first().and_then(|joint| {
            let like = |name: &&String| strsim::jaro_winkler(joint, name) > 0.7;
            names
                .iter()
                .find(|name| name.ends_with(&**joint))
                .or_else(|| names.iter().find(like))
        });
        let hint = near
            .map(|name| format!(" (\"{name}\" looks like it)"))
            .unwrap_or_default();
        Err(BagError::Topics {
            path: bag.to_owned(),
            what: format!(
                "no joint state of {} has all joints of the robot: {} missing{hint}; the bag names {}",
                excerpt(&found.chosen.joints.name),
                listed(&missing),
                listed(&names)
            ),
            remedy: "give the URDF of the robot that was recorded, or name the bag's joints, base to flange, with \
                     --joint-columns A,B,C"
                .to_owned(),
        })
    }
}

fn listed(names: &[String]) -> String {
    const LISTED: usize = 12;
    match names.len() {
        0 => "none".to_owned(),
        n if n > LISTED => format!("{} and {} more", names[..LISTED].join(", "), n - LISTED),
        _ => names.join(", "),
    }
}
