//! The chain from base to flange that a URDF's tree holds.

use std::collections::{HashMap, HashSet};

use spherecal_shared::robot::Pose;

use super::prefixes::Srdf;
use super::tip::{Arms, listed};
use super::{JointMotion, Urdf, UrdfJoint, value_error};
use crate::robots::error::RobotFileError;
use crate::robots::frames::compose;

/// The joints from base to tip (indices into [`Urdf::joints`]).
#[derive(Clone, Debug)]
pub struct UrdfChain {
    /// The first link: the file's root, or the one that was asked for.
    pub root: String,
    /// The last link: the flange.
    pub tip: String,
    /// Why this is the tip, in words.
    pub why: String,
    /// Every joint on the way, fixed ones included.
    pub path: Vec<usize>,
    /// How many of them, from the first, are passed from child to parent: the way goes up the tree, then down.
    pub up: usize,
    /// What hangs rigidly beyond the tip, as the tip's frame sees its end: a
    /// tool that the file knows.
    pub beyond: Option<(String, Pose<f64>)>,
}

impl Urdf {
    /// The chain that `ends` names as `TIP` or `BASE:TIP` (either may be empty). A tip that is not named is found by
    /// its role, see the module `tip`; `srdf` is the semantic description beside the file.
    ///
    /// # Errors
    /// A link that does not exist, a tip that is not clear, ends that are one link or not of one tree, a loop, or a joint
    /// on the way that moves in more than one direction.
    pub fn chain(&self, ends: Option<&str>, srdf: Option<&Srdf>) -> Result<UrdfChain, RobotFileError> {
        let into: HashMap<&str, usize> = self
            .joints
            .iter()
            .enumerate()
            .map(|(i, j)| (j.child.as_str(), i))
            .collect();
        let is_link = |name: &str| self.links.iter().any(|l| l == name);
        let (base, tip) = match ends {
            Some(tip) if is_link(tip) => ("", tip),
            Some(both) => both.split_once(':').unwrap_or(("", both)),
            None => ("", ""),
        };
        for (end, name) in [("base link", base), ("tip link", tip)] {
            if !name.is_empty() && !is_link(name) {
                let mut links: Vec<&str> = self.links.iter().map(String::as_str).collect();
                links.sort_by_cached_key(|link| strsim::levenshtein(link, name));
                let known = listed(links.into_iter());
                let remedy = format!("name one of the file's links: {known}");
                return Err(value_error(&self.path, end.to_owned(), name, &remedy));
            }
        }
        let order = self.roots_first(&into);
        if order.len() < self.joints.len() {
            let mut reached = vec![false; self.joints.len()];
            for &i in &order {
                reached[i] = true;
            }
            if let Some(i) = reached.iter().position(|r| !r) {
                self.path_to(&self.joints[i].child, &into)?;
            }
        }
        let (tip, why) = if tip.is_empty() {
            // Without a joint that moves, one whose type has a slip of the pen is the reason.
            let odd = self
                .joints
                .iter()
                .find(|j| j.motion == JointMotion::Other && !j.is_base());
            if let Some(joint) = odd.filter(|_| !self.joints.iter().any(UrdfJoint::is_driven)) {
                return Err(self.odd_type(joint));
            }
            Arms::new(self, base, &order).tip(srdf)?
        } else {
            (tip.to_owned(), "it was asked for".to_owned())
        };
        let mut path = self.path_to(&tip, &into)?;
        let mut up = 0;
        if base.is_empty() {
            // A floating or planar base: the arm begins on the body that it carries.
            let of_base = |&i: &usize| self.joints[i].motion == JointMotion::Fixed || self.joints[i].is_base();
            let before = path.iter().take_while(|i| of_base(i)).count();
            if let Some(last) = path.iter().take(before).rposition(|&i| self.joints[i].is_base()) {
                path.drain(..=last);
            }
        } else {
            let to_base = self.path_to(base, &into)?;
            let root =
                |path: &[usize], link: &str| path.first().map_or(link.to_owned(), |&i| self.joints[i].parent.clone());
            if base == tip || root(&path, &tip) != root(&to_base, base) {
                let remedy = format!("no joint leads from it to {tip}: name two links of one tree");
                return Err(value_error(&self.path, "base link".to_owned(), base, &remedy));
            }
            // Up to the last link that both ways from the root have in common, and down.
            let common = path.iter().zip(&to_base).take_while(|(a, b)| a == b).count();
            up = to_base.len() - common;
            path.splice(..common, to_base.into_iter().skip(common).rev());
        }
        if let Some(&i) = path.iter().find(|&&i| self.joints[i].motion == JointMotion::Other) {
            return Err(self.odd_type(&self.joints[i]));
        }
        let root = match path.first() {
            _ if up > 0 => base.to_owned(),
            Some(&i) => self.joints[i].parent.clone(),
            None => tip.clone(),
        };
        let beyond = self.beyond(&tip);
        Ok(UrdfChain {
            root,
            tip,
            why,
            path,
            up,
            beyond,
        })
    }

    /// The refusal of a joint on the way that neither turns nor slides nor is fixed.
    fn odd_type(&self, joint: &UrdfJoint) -> RobotFileError {
        let remedy = if joint.is_base() {
            format!("name a base behind it as {}#BASE:TIP", self.path)
        } else {
            "write revolute, continuous, prismatic, fixed, floating or planar".to_owned()
        };
        let field = format!("joint \"{}\": type", joint.name);
        value_error(&self.path, field, &joint.kind, &remedy)
    }

    /// The joints in an order in which each stands behind the one that carries it; joints of a loop are left out.
    fn roots_first(&self, into: &HashMap<&str, usize>) -> Vec<usize> {
        let mut behind: HashMap<&str, Vec<usize>> = HashMap::new();
        for (i, joint) in self.joints.iter().enumerate() {
            behind.entry(&joint.parent).or_default().push(i);
        }
        let first = |&i: &usize| !into.contains_key(self.joints[i].parent.as_str());
        let mut order: Vec<usize> = (0..self.joints.len()).filter(first).collect();
        let mut k = 0;
        while let Some(&i) = order.get(k) {
            order.extend(behind.get(self.joints[i].child.as_str()).into_iter().flatten());
            k += 1;
        }
        order
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
