//! What people want to know of the chain of a URDF: its joints in words, and the joints beside it.

use super::error::RobotFileError;
use super::model::{Origin, RobotModel};
use super::path::JointPath;
use super::urdf::{JointMotion, UrdfJoint};
use crate::excerpt;

impl RobotModel {
    /// The chain from base to tip in words: its frames and joints by name, and why it ends there. `None` for a robot that
    /// is not from a URDF.
    pub fn chain_words(&self) -> Option<String> {
        let Origin::Urdf(source) = &self.origin else {
            return None;
        };
        let (urdf, chain) = source.as_ref();
        let names: Vec<String> = chain
            .path
            .iter()
            .enumerate()
            .map(|(k, &i)| (k < chain.up, &urdf.joints[i]))
            .filter(|(_, joint)| matches!(joint.motion, JointMotion::Turns | JointMotion::Slides))
            .map(|(up, joint)| {
                let mimic = joint.mimic.as_ref();
                let marks = [
                    mimic.map(|mimic| format!("follows {}", excerpt(&mimic.leader))),
                    (joint.motion == JointMotion::Slides && mimic.is_none()).then(|| "slides".to_owned()),
                    up.then(|| "upwards".to_owned()),
                ];
                let marks: Vec<String> = marks.into_iter().flatten().collect();
                if marks.is_empty() {
                    excerpt(&joint.name)
                } else {
                    format!("{} ({})", excerpt(&joint.name), marks.join(", "))
                }
            })
            .collect();
        Some(format!(
            "{} - {} - {}: {}",
            excerpt(&chain.root),
            names.join(", "),
            excerpt(&chain.tip),
            chain.why
        ))
    }

    /// Names of the joints of the file that move and are no columns of the chain; and of those of them that carry its
    /// base. A base that joints of the chain carry has its instrument on it: none carries that one.
    ///
    /// # Errors
    /// As [`RobotModel::joint_path`].
    pub fn other_joints(&self) -> Result<(Vec<String>, Vec<String>), RobotFileError> {
        let Origin::Urdf(source) = &self.origin else {
            return Ok((Vec::new(), Vec::new()));
        };
        let (urdf, chain) = source.as_ref();
        let columns = self.joint_path()?.columns;
        let moves = |joint: &&UrdfJoint| joint.motion != JointMotion::Fixed && !columns.contains(&joint.name);
        let others = urdf.joints.iter().filter(moves).map(|joint| joint.name.clone());
        let mut carriers = Vec::new();
        let mut link = &chain.root;
        // The bound ends a file whose links go in a circle.
        let most = if chain.up > 0 { 0 } else { urdf.joints.len() };
        for _ in 0..most {
            let Some(joint) = urdf.joints.iter().find(|j| j.child == *link) else {
                break;
            };
            carriers.extend(Some(joint).filter(moves).map(|joint| joint.name.clone()));
            link = &joint.parent;
        }
        Ok((others.collect(), carriers))
    }

    /// Least and greatest position of each column of a path of this robot, in rad or m; without bounds where the file has
    /// none.
    pub fn column_ranges(&self, path: &JointPath) -> Vec<(f64, f64)> {
        let bounds = |(k, column): (usize, &String)| {
            let of_table = self.robot.joints.get(k).map(|j| (j.limits.min_rad, j.limits.max_rad));
            let of_file = match &self.origin {
                Origin::Urdf(source) => source.0.joints.iter().find(|j| j.name == *column).map(|j| j.range),
                Origin::BuiltIn | Origin::Toml => of_table,
            };
            of_file.unwrap_or((f64::NEG_INFINITY, f64::INFINITY))
        };
        path.columns.iter().enumerate().map(bounds).collect()
    }

    /// Joints of the file that move and are not on the chain, each with its type and its parent link.
    pub fn left_out(&self) -> Vec<String> {
        let Origin::Urdf(source) = &self.origin else {
            return Vec::new();
        };
        let (urdf, chain) = source.as_ref();
        let beside = |(i, joint): &(usize, &UrdfJoint)| joint.motion != JointMotion::Fixed && !chain.path.contains(i);
        let words = |(_, joint): (usize, &UrdfJoint)| {
            let kind = if joint.mimic.is_some() { "mimic" } else { &joint.kind };
            format!("{} ({kind}, on {})", excerpt(&joint.name), excerpt(&joint.parent))
        };
        urdf.joints.iter().enumerate().filter(beside).map(words).collect()
    }
}
