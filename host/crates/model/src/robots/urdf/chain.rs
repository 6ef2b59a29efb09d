//! The chain from base to flange that a URDF's tree holds.

use std::collections::{HashMap, HashSet};

use spherecal_shared::robot::Pose;

use super::{JointMotion, Urdf, value_error};
use crate::robots::error::RobotFileError;
use crate::robots::frames::compose;

/// The joints from root to tip (indices into [`Urdf::joints`]).
#[derive(Clone, Debug)]
pub struct UrdfChain {
    /// The root link.
    pub root: String,
    /// The last link: the flange.
    pub tip: String,
    /// Every joint on the way, fixed ones included.
    pub path: Vec<usize>,
    /// What hangs rigidly beyond the tip, as the tip's frame sees its end: a
    /// tool that the file knows.
    pub beyond: Option<(String, Pose<f64>)>,
}

/// Most names that a message lists.
const LISTED: usize = 20;

/// Names for a message.
fn listed<'a>(names: impl Iterator<Item = &'a str> + Clone) -> String {
    let more = names.clone().count().saturating_sub(LISTED);
    let mut words = names.take(LISTED).collect::<Vec<_>>().join(", ");
    if more > 0 {
        words += &format!(" and {more} more");
    }
    words
}

impl Urdf {
    /// The chain to `tip`, or, without one, the longest chain of turning joints
    /// and its flange: `tool0` or `flange` where the file names one, else the
    /// last link.
    ///
    /// # Errors
    /// A tip that does not exist, several equally long chains, a loop, or a
    /// joint on the way that does not turn.
    pub fn chain(&self, tip: Option<&str>) -> Result<UrdfChain, RobotFileError> {
        let error = |field: &str, value: &str, remedy: String| RobotFileError::Value {
            path: self.path.clone(),
            field: field.to_owned(),
            value: value.to_owned(),
            remedy,
        };
        let into: HashMap<&str, usize> = self
            .joints
            .iter()
            .enumerate()
            .map(|(i, j)| (j.child.as_str(), i))
            .collect();
        let tip = match tip {
            Some(tip) if self.links.iter().any(|l| l == tip) => tip.to_owned(),
            Some(tip) => {
                return Err(error(
                    "tip link",
                    tip,
                    format!(
                        "name one of the file's links: {}",
                        listed(self.links.iter().map(String::as_str))
                    ),
                ));
            }
            None => self.guess_tip(&into)?,
        };
        let path = self.path_to(&tip, &into)?;
        for &i in &path {
            let joint = &self.joints[i];
            if joint.motion == JointMotion::Other || joint.mimics {
                return Err(error(
                    &format!("joint \"{}\": type", joint.name),
                    if joint.mimics { "mimic" } else { &joint.kind },
                    format!(
                        "only chains of revolute joints can be calibrated; name another tip as {}#LINK",
                        self.path
                    ),
                ));
            }
        }
        let root = path
            .first()
            .map_or_else(|| tip.clone(), |&i| self.joints[i].parent.clone());
        let beyond = self.beyond(&tip);
        Ok(UrdfChain {
            root,
            tip,
            path,
            beyond,
        })
    }

    /// The joints from the root to a link.
    fn path_to(&self, tip: &str, into: &HashMap<&str, usize>) -> Result<Vec<usize>, RobotFileError> {
        let mut path = Vec::new();
        let mut seen = HashSet::new();
        let mut link = tip;
        while let Some(&i) = into.get(link) {
            if !seen.insert(i) {
                return Err(value_error(
                    &self.path,
                    format!("joint \"{}\": parent", self.joints[i].name),
                    &self.joints[i].parent,
                    "the links form a loop; a URDF is a tree",
                ));
            }
            path.push(i);
            link = &self.joints[i].parent;
        }
        path.reverse();
        Ok(path)
    }

    /// The flange of the longest chain of turning joints.
    fn guess_tip(&self, into: &HashMap<&str, usize>) -> Result<String, RobotFileError> {
        // Each turning joint and how many lie on the way to it, itself included;
        // a way through a sliding joint does not count.
        let mut best: Vec<usize> = Vec::new();
        let mut most = 0;
        for (i, joint) in self.joints.iter().enumerate() {
            if joint.motion != JointMotion::Turns || joint.mimics {
                continue;
            }
            let path = self.path_to(&joint.child, into)?;
            if path
                .iter()
                .any(|&k| self.joints[k].motion == JointMotion::Other || self.joints[k].mimics)
            {
                continue;
            }
            let turns = path
                .iter()
                .filter(|&&k| self.joints[k].motion == JointMotion::Turns)
                .count();
            if turns > most {
                (most, best) = (turns, vec![i]);
            } else if turns == most {
                best.push(i);
            }
        }
        let &[last] = best.as_slice() else {
            let tips: Vec<&str> = best.iter().map(|&i| self.joints[i].child.as_str()).collect();
            return Err(value_error(
                &self.path,
                "chain of turning joints".to_owned(),
                if tips.is_empty() {
                    "none"
                } else {
                    "several equally long"
                },
                &format!(
                    "name the tip as {}#LINK{}{}",
                    self.path,
                    if tips.is_empty() { "" } else { ", for example one of " },
                    listed(tips.iter().copied())
                ),
            ));
        };
        // Everything rigid behind the last turning joint, in breadth.
        let mut rigid = vec![self.joints[last].child.as_str()];
        let mut k = 0;
        while let Some(&link) = rigid.get(k) {
            for joint in self
                .joints
                .iter()
                .filter(|j| j.motion == JointMotion::Fixed && j.parent == link)
            {
                if !rigid.contains(&joint.child.as_str()) {
                    rigid.push(&joint.child);
                }
            }
            k += 1;
        }
        let named = |suffixes: &[&str]| {
            rigid.iter().find(|l| {
                let lower = l.to_lowercase();
                suffixes
                    .iter()
                    .any(|s| lower == *s || lower.ends_with(&format!("_{s}")))
            })
        };
        let tip = named(&["tool0"])
            .or_else(|| named(&["flange", "link8"]))
            .or_else(|| named(&["link_ee", "ee_link", "ee"]))
            .or(rigid.last())
            .copied()
            .unwrap_or_default();
        Ok(tip.to_owned())
    }

    /// What hangs rigidly beyond a link in one unbranched line.
    fn beyond(&self, tip: &str) -> Option<(String, Pose<f64>)> {
        let mut frame = Pose::identity();
        let mut link = tip;
        for _ in 0..self.joints.len() {
            let mut next = self.joints.iter().filter(|j| j.parent == link);
            match (next.next(), next.next()) {
                (Some(joint), None) if joint.motion == JointMotion::Fixed => {
                    frame = compose(&frame, &joint.origin);
                    link = &joint.child;
                }
                _ => break,
            }
        }
        (link != tip).then(|| (link.to_owned(), frame))
    }
}
