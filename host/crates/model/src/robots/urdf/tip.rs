//! Where an arm ends: its tip by role, not by the number of joints.
//!
//! | rule | example |
//! |---|---|
//! | 1. the only `tool0` | `tool0`, `left_tool0` |
//! | 2. the SRDF beside the file: the arm's chain, else the link that carries the end effector | `panda_link8` |
//! | 3. the longest way of driven joints without parts of a gripper, a head or a wheel, up to a gripper or a fork | |
//!
//! At the end of rule 3, of the links that are rigidly behind the last joint, the one with the name of a flange or TCP is
//! taken, else the last before a fork. What is not clear is asked for, with the candidates.

use std::collections::HashMap;

use super::prefixes::Srdf;
use super::{JointMotion, Urdf, UrdfJoint, value_error};
use crate::robots::error::RobotFileError;

/// Most names that a message lists.
const LISTED: usize = 20;

pub(super) fn listed<'a>(names: impl Iterator<Item = &'a str> + Clone) -> String {
    let more = names.clone().count().saturating_sub(LISTED);
    let mut words = names.take(LISTED).collect::<Vec<_>>().join(", ");
    if more > 0 {
        words += &format!(" and {more} more");
    }
    words
}

/// Words in the names of joints and links that are no part of an arm.
const PARTS: [&str; 27] = [
    "gripper",
    "fngr",
    "finger",
    "fingers",
    "fingertip",
    "jaw",
    "jaws",
    "hand",
    "claw",
    "knuckle",
    "thumb",
    "propeller",
    "prop",
    "camera",
    "cam",
    "head",
    "neck",
    "wheel",
    "caster",
    "castor",
    "tablet",
    "laser",
    "lidar",
    "imu",
    "suction",
    "pincer",
    "clamp",
];
/// Words in the names of an arm's joints: such a joint may carry a link that is named after the gripper.
const ARM: [&str; 14] = [
    "wrist", "roll", "pitch", "yaw", "elbow", "shoulder", "forearm", "waist", "rotate", "rotation", "flex", "pan",
    "lift", "arm",
];
/// Words in the names of the parts that a gripper closes: an arm's joint may carry its hand, and not these.
const FINGERS: [&str; 6] = ["finger", "fingers", "fingertip", "fngr", "jaw", "jaws"];
/// Fewest driven joints before a fork that is a gripper.
const BEFORE_GRIPPER: usize = 3;
/// Most driven joints of a finger.
const FINGER: usize = 2;
/// Fewest driven joints behind a fork that make a second arm.
const SECOND_ARM: usize = 4;

/// The words of a name: `wrist_3Link` is wrist, link.
fn words(name: &str) -> Vec<String> {
    let mut out: Vec<String> = vec![String::new()];
    let mut small = false;
    for letter in name.chars() {
        if !letter.is_alphabetic() || (letter.is_uppercase() && small) {
            out.push(String::new());
        }
        small = letter.is_lowercase();
        if letter.is_alphabetic()
            && let Some(word) = out.last_mut()
        {
            word.extend(letter.to_lowercase());
        }
    }
    out.retain(|word| !word.is_empty());
    out
}

fn has(name: &str, known: &[&str]) -> bool {
    words(name).iter().any(|word| known.contains(&word.as_str()))
}

/// Whether a link is named `tool0`, alone or behind a prefix.
fn is_tool0(link: &str) -> bool {
    let lower = link.to_lowercase();
    lower
        .strip_suffix("tool0")
        .is_some_and(|rest| !rest.ends_with(char::is_alphanumeric))
}

/// What is known of a joint and what it carries.
#[derive(Clone, Copy, Debug, Default)]
struct Branch {
    /// It is a part of a gripper, a head or a wheel by its names.
    part: bool,
    /// Its own name says nothing, and its link is the last and named after a gripper: the wrist, or the jaw.
    doubtful: bool,
    /// Anything moves behind its child link.
    moves: bool,
    /// Most driven joints on a way that begins with it and holds no part; itself included.
    depth: usize,
}

/// The tree below a base.
pub(super) struct Arms<'u> {
    urdf: &'u Urdf,
    /// The link that was asked for, or every root with a joint that moves behind it.
    bases: Vec<&'u str>,
    /// Joints by parent link.
    out: HashMap<&'u str, Vec<usize>>,
    branches: Vec<Branch>,
}

impl<'u> Arms<'u> {
    /// The arms behind the link `base`; the file's root where it is empty. `order` holds all joints, each behind the one
    /// that carries it.
    pub(super) fn new(urdf: &'u Urdf, base: &str, order: &[usize]) -> Self {
        let mut out: HashMap<&str, Vec<usize>> = HashMap::new();
        for (i, joint) in urdf.joints.iter().enumerate() {
            out.entry(&joint.parent).or_default().push(i);
        }
        let mut branches = vec![Branch::default(); urdf.joints.len()];
        for &i in order.iter().rev() {
            let joint = &urdf.joints[i];
            let behind = out.get(joint.child.as_str()).map_or(&[][..], Vec::as_slice);
            let fixed = joint.motion == JointMotion::Fixed;
            let moves = behind
                .iter()
                .any(|&k| urdf.joints[k].motion != JointMotion::Fixed || branches[k].moves);
            let named = has(&joint.child, &PARTS);
            // `arm_f1x` says no more of a finger than that it is the arm's.
            let arms = words(&joint.name)
                .iter()
                .any(|word| ARM.contains(&word.as_str()) && !(word == "arm" && has(&joint.child, &FINGERS)));
            let doubtful = named && !fixed && !moves && !arms && !has(&joint.name, &PARTS);
            let most = behind
                .iter()
                .filter(|&&k| !branches[k].part)
                .map(|&k| branches[k].depth)
                .max();
            branches[i] = Branch {
                part: has(&joint.name, &PARTS) || (named && fixed) || doubtful,
                doubtful,
                moves,
                depth: usize::from(joint.is_driven()) + most.unwrap_or(0),
            };
        }
        let mut bases: Vec<&str> = Vec::new();
        if base.is_empty() {
            let child = |link: &str| urdf.joints.iter().any(|joint| joint.child == link);
            for &i in order {
                let (link, branch) = (urdf.joints[i].parent.as_str(), branches[i]);
                if (branch.depth > 0 || branch.moves) && !bases.contains(&link) && !child(link) {
                    bases.push(link);
                }
            }
        } else {
            bases.extend(urdf.links.iter().map(String::as_str).find(|link| *link == base));
        }
        Self {
            urdf,
            bases,
            out,
            branches,
        }
    }

    /// The joints that hang on a link. A tool of a calibrated file is no part of the arm.
    fn behind(&self, link: &str) -> impl Iterator<Item = (&'u UrdfJoint, Branch)> {
        let all = self.out.get(link).map_or(&[][..], Vec::as_slice);
        all.iter()
            .map(|&i| (&self.urdf.joints[i], self.branches[i]))
            .filter(|(joint, _)| !joint.carries_own_tcp())
    }

    /// The ends of the arms behind a link that is reached over `driven` joints: the last moved links, with the
    /// number of driven joints before each.
    fn ends(&self, link: &'u str, driven: usize, found: &mut Vec<(&'u str, usize)>) {
        let ways: Vec<(&UrdfJoint, Branch)> = self
            .behind(link)
            .filter(|(j, b)| !b.part && (j.motion != JointMotion::Fixed || b.moves))
            .collect();
        let moving = ways.iter().filter(|(j, b)| b.depth > 0 || j.mimic.is_some()).count();
        let most = ways.iter().map(|(_, b)| b.depth).max().unwrap_or(0);
        // A joint that follows one of the arm keeps the tool level, as in a palletiser: it is the arm's.
        let mut levels = ways
            .iter()
            .filter(|(j, _)| j.mimic.as_ref().is_some_and(|mimic| self.leads_to(&mimic.leader, link)));
        if let (0, Some((joint, _)), None) = (most, levels.next(), levels.next()) {
            self.ends(&joint.child, driven, found);
            return;
        }
        // Two short ways at the end of an arm are the fingers of a gripper.
        if most == 0 || (moving > 1 && driven >= BEFORE_GRIPPER && most <= FINGER) {
            found.push((link, driven));
            return;
        }
        for (joint, branch) in ways {
            // Beside an arm, a short way is a head, a sensor or a passive link.
            if branch.depth == most || branch.depth >= SECOND_ARM {
                self.ends(&joint.child, driven + usize::from(joint.is_driven()), found);
            }
        }
    }

    /// Whether a joint is on the way to a link.
    fn leads_to(&self, joint: &str, link: &str) -> bool {
        let mut at = link;
        // The bound ends a file whose links go in a circle.
        for _ in 0..self.urdf.joints.len() {
            match self.urdf.joints.iter().find(|j| j.child == at) {
                Some(found) if found.name == joint => return true,
                Some(found) => at = &found.parent,
                None => break,
            }
        }
        false
    }

    /// The link behind the moved link `link` that is the flange.
    fn flange(&self, link: &'u str) -> &'u str {
        let mut rigid = vec![link];
        let mut k = 0;
        while let Some(&at) = rigid.get(k) {
            let next = self
                .behind(at)
                .filter(|(j, b)| j.motion == JointMotion::Fixed && !b.part);
            rigid.extend(next.map(|(j, _)| j.child.as_str()));
            k += 1;
        }
        let named = |ends: &[&str]| {
            rigid.iter().copied().find(|l| {
                let lower = l.to_lowercase();
                let end = |s: &&str| {
                    lower
                        .strip_suffix(s)
                        .is_some_and(|rest| !rest.ends_with(char::is_alphanumeric))
                };
                ends.iter().any(end)
            })
        };
        named(&["tool0"])
            .or_else(|| named(&["flange", "link8"]))
            .or_else(|| {
                named(&[
                    "tcp",
                    "link_ee",
                    "ee_link",
                    "ee",
                    "ee_arm_link",
                    "end_effector",
                    "end_effector_link",
                    "endeffector_link",
                ])
            })
            .unwrap_or_else(|| self.line_end(link))
    }

    /// The end of the unbranched rigid line that begins at a link.
    fn line_end(&self, link: &'u str) -> &'u str {
        let mut at = link;
        for _ in 0..self.urdf.joints.len() {
            let mut next = self.behind(at);
            match (next.next(), next.next()) {
                (Some((joint, branch)), None) if joint.motion == JointMotion::Fixed && !branch.part => {
                    at = &joint.child;
                }
                _ => break,
            }
        }
        at
    }

    /// Whether a link is the base or behind it.
    fn reaches(&self, link: &str) -> bool {
        let mut at = link;
        for _ in 0..=self.urdf.joints.len() {
            if self.bases.contains(&at) {
                return true;
            }
            match self.urdf.joints.iter().find(|j| j.child == at) {
                Some(joint) => at = &joint.parent,
                None => return false,
            }
        }
        false
    }

    /// The tip, and why it is.
    /// Errors: no arm, or several.
    pub(super) fn tip(&self, srdf: Option<&Srdf>) -> Result<(String, String), RobotFileError> {
        let known = |link: &&String| self.urdf.links.contains(link) && self.reaches(link);
        let one = |links: Vec<&String>, why: &str| -> Option<Result<(String, String), RobotFileError>> {
            let mut links: Vec<&str> = links.iter().map(|l| l.as_str()).collect();
            links.sort_unstable();
            links.dedup();
            match links.as_slice() {
                [] => None,
                [link] => Some(Ok(((*link).to_owned(), why.to_owned()))),
                several => Some(Err(self.ask(several))),
            }
        };
        let tool0 = self.urdf.links.iter().filter(|l| is_tool0(l)).filter(known).collect();
        if let Some(found) = one(tool0, "it is the file's tool0") {
            return found;
        }
        if let Some(srdf) = srdf {
            let arm = |(group, _): &&(String, String)| !srdf.effectors.contains(group) && !has(group, &PARTS);
            let chains = srdf
                .chains
                .iter()
                .filter(arm)
                .map(|(_, tip)| tip)
                .filter(known)
                .collect();
            let found = one(chains, "the SRDF's chain ends there").or_else(|| {
                one(
                    srdf.parents.iter().filter(known).collect(),
                    "the SRDF's end effector is there",
                )
            });
            if let Some(found) = found {
                return found;
            }
        }
        let mut ends = Vec::new();
        for base in &self.bases {
            self.ends(base, 0, &mut ends);
        }
        // Beside an arm, a short tree of its own is a door, a positioner or a sensor.
        let most = ends.iter().map(|end| end.1).max().unwrap_or(0);
        ends.retain(|end| end.1 > 0 && (end.1 == most || end.1 >= SECOND_ARM));
        if let [(link, _)] = ends.as_slice() {
            // The wrist and the jaw, where names do not tell them apart. Several are the fingers of a gripper.
            let mut jaws = self.behind(self.line_end(link)).filter(|(_, b)| b.doubtful);
            if let (Some((jaw, _)), None) = (jaws.next(), jaws.next()) {
                return Err(self.ask(&[self.flange(link), jaw.child.as_str()]));
            }
            return Ok((self.flange(link).to_owned(), "the arm ends there".to_owned()));
        }
        let tips: Vec<&str> = ends.iter().map(|(link, _)| self.flange(link)).collect();
        Err(self.ask(&tips))
    }

    /// The question for a tip.
    fn ask(&self, candidates: &[&str]) -> RobotFileError {
        let (found, names) = if candidates.is_empty() {
            ("none, because no joint moves an arm", String::new())
        } else {
            (
                "several could be meant",
                format!(": {}", listed(candidates.iter().copied())),
            )
        };
        let remedy = format!(
            "name the last link of the arm as {0}#LINK or {0}#BASE:LINK{names}",
            self.urdf.path
        );
        value_error(&self.urdf.path, "tip of the arm".to_owned(), found, &remedy)
    }
}
