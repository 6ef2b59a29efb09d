//! Several chains of one tree, each with a tip of its own: two arms on a torso.
//!
//! ```text
//!   base ── trunk: joints that all chains have in common ──┬── joints of chain 1 ── tip 1
//!                                                          └── joints of chain 2 ── tip 2
//! ```

use spherecal_shared::robot::{MdhRow, Pose};

use super::error::RobotFileError;
use super::frames::{compose, inverse};
use super::model::{Origin, RobotModel};
use super::path::JointKind;
use super::urdf::{JointMotion, Urdf, UrdfChain};
use super::urdf_out::{Corrected, add_tcp, corrected, edited, own_tcp, tcp_frame};

/// What several chains of one URDF have in common.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Trunk {
    /// Joints that move and are part of every chain, from the base.
    pub joints: Vec<String>,
    /// The link behind the last of them, on which the chains part: the base where there is none.
    pub end: String,
}

fn refuse(urdf: &Urdf, tip: &str, remedy: &str) -> RobotFileError {
    RobotFileError::Value {
        path: urdf.path.clone(),
        field: "tip link".to_owned(),
        value: tip.to_owned(),
        remedy: remedy.to_owned(),
    }
}

fn moves(urdf: &Urdf, i: usize) -> bool {
    matches!(urdf.joints[i].motion, JointMotion::Turns | JointMotion::Slides)
}

impl Trunk {
    /// What chains of one URDF have in common.
    ///
    /// # Errors
    /// Chains of several files or bases, a base that a joint of a chain carries, and a joint that slides behind the trunk.
    pub fn of(chains: &[RobotModel]) -> Result<Self, RobotFileError> {
        let mut sources: Vec<&(Urdf, UrdfChain)> = Vec::with_capacity(chains.len());
        for model in chains {
            match &model.origin {
                Origin::Urdf(source) => sources.push(source),
                Origin::BuiltIn | Origin::Toml => {
                    return Err(RobotFileError::Value {
                        path: model.robot.name.as_str().to_owned(),
                        field: "tip link".to_owned(),
                        value: model.frame_names.1.clone(),
                        remedy: "several tips are those of one URDF: give FILE.urdf#BASE:TIP,TIP".to_owned(),
                    });
                }
            }
        }
        let Some(&(urdf, first)) = sources.first() else {
            return Ok(Self {
                joints: Vec::new(),
                end: String::new(),
            });
        };
        let mut common = first.path.len();
        for (_, chain) in &sources {
            if chain.up > 0 || chain.root != first.root {
                return Err(refuse(
                    urdf,
                    &chain.tip,
                    "several tips need one base link that carries them all",
                ));
            }
            common = common.min(chain.path.iter().zip(&first.path).take_while(|(a, b)| a == b).count());
        }
        let trunk: Vec<usize> = first.path[..common]
            .iter()
            .copied()
            .filter(|&i| moves(urdf, i))
            .collect();
        for (model, (_, chain)) in chains.iter().zip(&sources) {
            let path = model.joint_path()?;
            let own = path.joints.get(trunk.len()..).unwrap_or_default();
            if own.is_empty() {
                return Err(refuse(
                    urdf,
                    &chain.tip,
                    "another tip is behind it: no joint is of this chain alone",
                ));
            }
            if own.iter().any(|joint| joint.kind == JointKind::Slides) {
                let remedy = "a joint slides behind those that all tips share: calibrate this tip alone";
                return Err(refuse(urdf, &chain.tip, remedy));
            }
        }
        Ok(Self {
            joints: trunk.iter().map(|&i| urdf.joints[i].name.clone()).collect(),
            end: trunk
                .last()
                .map_or_else(|| first.root.clone(), |&i| urdf.joints[i].child.clone()),
        })
    }
}

/// A calibrated chain behind the trunk.
#[derive(Clone, Debug)]
pub struct Limb<'a> {
    /// The nominal chain from the trunk's end to the tip.
    pub model: &'a RobotModel,
    /// Its calibrated table.
    pub rows: Vec<MdhRow<f64>>,
    /// The frame in which the table begins, in the trunk's calibrated last frame.
    pub mount: Pose<f64>,
    /// TCP in the frame of the tip, in m.
    pub tcp_m: [f64; 3],
}

/// Origin of a joint, given how it stands behind the joint that moves before it on its chain: what lies fixed between them
/// stays as it is.
fn behind_fixed(urdf: &Urdf, chain: &UrdfChain, joint: usize, origin: &Pose<f64>) -> Pose<f64> {
    let mut between = Pose::identity();
    for &i in chain.path.iter().take_while(|&&i| i != joint) {
        between = if moves(urdf, i) {
            Pose::identity()
        } else {
            compose(&between, &urdf.joints[i].origin)
        };
    }
    compose(&inverse(&between), origin)
}

/// The URDF of a robot with several calibrated chains: `whole` is the chain from the base to the first tip, and `trunk` has
/// the origins of the joints that all share, each in the frame of the joint that moves before it. Every tip gets its tool
/// centre point as a link, `<tip>_tcp`. Everything else stays as it was; `notes` become a comment.
pub fn write_urdf_of_limbs(whole: &RobotModel, trunk: &[Pose<f64>], limbs: &[Limb<'_>], notes: &[String]) -> String {
    let Origin::Urdf(source) = &whole.origin else {
        return String::new();
    };
    let (urdf, chain) = source.as_ref();
    let mut all = Corrected::default();
    let moving = chain.path.iter().filter(|&&i| moves(urdf, i));
    for (&i, origin) in moving.zip(trunk) {
        all.origins.push((i, behind_fixed(urdf, chain, i, origin)));
    }
    for limb in limbs {
        let Origin::Urdf(source) = &limb.model.origin else {
            continue;
        };
        let (own, chain) = source.as_ref();
        let mut origins = corrected(limb.model, own, chain, &limb.rows).origins;
        if let Some((i, origin)) = origins.first_mut() {
            let fixed = inverse(&behind_fixed(own, chain, *i, &Pose::identity()));
            let at = compose(&limb.mount, &compose(&fixed, origin));
            *origin = compose(&inverse(&fixed), &at);
        }
        all.origins.extend(origins);
        if let Some(i) = own_tcp(urdf, &chain.tip) {
            all.origins.push((i, tcp_frame(&limb.tcp_m)));
        }
    }
    let mut out = edited(urdf, all, notes);
    for limb in limbs {
        let tip = &limb.model.frame_names.1;
        if own_tcp(urdf, tip).is_none() {
            add_tcp(&mut out, tip, &urdf.links, tip, &limb.tcp_m);
        }
    }
    out
}
