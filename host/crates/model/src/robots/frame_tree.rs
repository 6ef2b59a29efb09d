//! The frames of a robot as a tree with names: what a viewer needs to draw the arm.
//!
//! The names are those of the URDF that [`write_urdf`](super::write_urdf) writes, so a viewer that
//! loads this URDF finds each of its links. Two frames are added: *F0*, in which forces and TCP
//! positions are given, and the TCP.
//!
//! ```text
//!   root ─┬─ … links of the URDF … ─ flange ─ spherecal_tcp
//!         └─ spherecal_f0 (only if F0 is not the root frame)
//! ```

use nalgebra::Vector3;
use spherecal_shared::robot::{Pose, Tool};

use super::frames::{compose, distance, inverse, rot_axis, row_transform};
use super::model::{Origin, RobotModel};
use super::urdf::JointMotion;
use super::urdf_out::SAME;

/// Name of the frame F0 where it is not the root frame.
const F0: &str = "spherecal_f0";
/// Name of the TCP's frame.
const TCP: &str = "spherecal_tcp";

/// One frame, seen from its parent.
#[derive(Clone, Debug)]
struct Edge {
    parent: String,
    child: String,
    /// The child's frame in the parent's, joint at zero.
    origin: Pose<f64>,
    /// Number of the joint that turns the child, and its unit axis in the child's frame.
    axis: Option<(usize, Vector3<f64>)>,
}

/// A frame in its parent's frame at one configuration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameInParent<'a> {
    /// Name of the parent frame.
    pub parent: &'a str,
    /// Name of the frame.
    pub child: &'a str,
    /// The frame in the parent's frame; position in m.
    pub pose: Pose<f64>,
}

/// All frames of a robot with its tool. Each frame but the root is the child of one other frame.
#[derive(Clone, Debug)]
pub struct FrameTree {
    edges: Vec<Edge>,
    f0: String,
    joints: Vec<String>,
}

impl RobotModel {
    /// The tree of this robot's frames. `tool` is given in Fn, the last frame of the table.
    pub fn frame_tree(&self, tool: &Tool) -> FrameTree {
        let (root, tip) = &self.frame_names;
        let (mut edges, joints) = match &self.origin {
            Origin::Urdf(source) => {
                let (urdf, chain) = source.as_ref();
                let turning: Vec<usize> = chain
                    .path
                    .iter()
                    .copied()
                    .filter(|&i| urdf.joints[i].motion == JointMotion::Turns)
                    .collect();
                let edge = |(i, joint): (usize, &super::urdf::UrdfJoint)| Edge {
                    parent: joint.parent.clone(),
                    child: joint.child.clone(),
                    origin: joint.origin,
                    // Joints beside the chain, such as fingers, are drawn at zero.
                    axis: turning.iter().position(|&t| t == i).map(|n| (n, joint.axis)),
                };
                let names = turning.iter().map(|&i| urdf.joints[i].name.clone()).collect();
                (urdf.joints.iter().enumerate().map(edge).collect(), names)
            }
            _ => self.edges_of_table(),
        };
        let f0 = if distance(&self.base, &Pose::identity()) < SAME {
            root.clone()
        } else {
            edges.push(Edge {
                parent: root.clone(),
                child: F0.to_owned(),
                origin: self.base,
                axis: None,
            });
            F0.to_owned()
        };
        let tcp = Pose {
            position: tool.tcp(),
            ..Pose::identity()
        };
        edges.push(Edge {
            parent: tip.clone(),
            child: TCP.to_owned(),
            origin: compose(&inverse(&self.flange), &tcp),
            axis: None,
        });
        FrameTree { edges, f0, joints }
    }

    /// The frames of a robot without a URDF, as its new URDF names them.
    fn edges_of_table(&self) -> (Vec<Edge>, Vec<String>) {
        let (root, tip) = &self.frame_names;
        let mut parent = root.clone();
        let mut edges = Vec::new();
        for (n, row) in self.rows().iter().enumerate() {
            let own = row_transform(row, 0.0);
            let child = format!("link_{}", n + 1);
            edges.push(Edge {
                parent: std::mem::replace(&mut parent, child.clone()),
                child,
                origin: if n == 0 { compose(&self.base, &own) } else { own },
                axis: Some((n, Vector3::z())),
            });
        }
        edges.push(Edge {
            parent,
            child: tip.clone(),
            origin: self.flange,
            axis: None,
        });
        let joints = (1..=self.robot.dof()).map(|n| format!("joint_{n}")).collect();
        (edges, joints)
    }
}

impl FrameTree {
    /// Name of the frame F0: the first frame of the table.
    pub fn f0(&self) -> &str {
        &self.f0
    }

    /// Name of the TCP's frame. Its axes are those of Fn.
    pub fn tcp(&self) -> &'static str {
        TCP
    }

    /// Names of the joints, base to flange, as the URDF has them.
    pub fn joint_names(&self) -> &[String] {
        &self.joints
    }

    /// Every frame in its parent's frame at joint angles `q` (rad, base to flange). A joint without
    /// an angle is at zero.
    pub fn transforms<'a>(&'a self, q: &'a [f64]) -> impl Iterator<Item = FrameInParent<'a>> {
        self.edges.iter().map(|edge| {
            let turn = edge.axis.and_then(|(n, axis)| Some((*q.get(n)?, axis)));
            FrameInParent {
                parent: &edge.parent,
                child: &edge.child,
                pose: turn.map_or(edge.origin, |(angle, axis)| Pose {
                    rotation: edge.origin.rotation * rot_axis(&axis, angle),
                    position: edge.origin.position,
                }),
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeSet, HashMap};

    use spherecal_shared::robot::BUILT_IN;

    use super::super::{built_in, load_urdf_text, table_frames, write_urdf};
    use super::*;

    fn in_root(frames: &HashMap<&str, (&str, Pose<f64>)>, name: &str) -> Pose<f64> {
        match frames.get(name) {
            Some((parent, pose)) => compose(&in_root(frames, parent), pose),
            None => Pose::identity(),
        }
    }

    /// Asserts that the tree's TCP and flange are those of the table.
    fn check(model: &RobotModel) {
        let tool = Tool {
            tcp_m: [0.03, -0.02, 0.11],
            ..Tool::default()
        };
        let tree = model.frame_tree(&tool);
        for k in 0..20 {
            let q: Vec<f64> = (0..model.robot.dof())
                .map(|n| (f64::from(k) * 1.3 + n as f64 * 0.7).sin() * 2.0)
                .collect();
            let frames: HashMap<&str, (&str, Pose<f64>)> =
                tree.transforms(&q).map(|t| (t.child, (t.parent, t.pose))).collect();
            assert_eq!(frames.len(), tree.transforms(&q).count(), "a frame has two parents");
            let last = compose(&model.base, table_frames(&model.rows(), &q).last().expect("a joint"));
            let tcp = Pose {
                position: last.point(&tool.tcp()),
                rotation: last.rotation,
            };
            let name = &model.robot.name;
            assert!(
                distance(&in_root(&frames, tree.tcp()), &tcp) < 1e-9,
                "{name}: TCP at {q:?}"
            );
            assert!(
                distance(&in_root(&frames, tree.f0()), &model.base) < 1e-12,
                "{name}: F0"
            );
            let flange = in_root(&frames, &model.frame_names.1);
            assert!(
                distance(&flange, &model.flange_at(&q)) < 1e-9,
                "{name}: flange at {q:?}"
            );
        }
    }

    // Fails if the chain of transforms ends anywhere else than the forward kinematics, if a frame
    // has two parents, or if a link or joint of the URDF has another name there; for every built-in
    // robot, and for its URDF read back as a user's file.
    #[test]
    fn the_tree_is_the_robot_of_its_urdf() {
        for name in BUILT_IN {
            let model = built_in(name).expect("built in");
            check(&model);
            let text = write_urdf(&model, &model.rows(), &[]);
            let read = load_urdf_text("x.urdf", &text, None).expect("a robot");
            check(&read);
            let tree = model.frame_tree(&model.tool);
            let again = read.frame_tree(&model.tool);
            assert_eq!(tree.joint_names(), again.joint_names(), "{name}");
            let q = vec![0.0; model.robot.dof()];
            let links = |tree: &FrameTree| -> BTreeSet<String> {
                tree.transforms(&q)
                    .map(|t| t.child.to_owned())
                    .filter(|c| !c.starts_with("spherecal_"))
                    .collect()
            };
            assert_eq!(links(&tree), links(&again), "{name}");
        }
    }
}
