//! Two robots, link by link.

use spherecal_shared::robot::Pose;

use super::frames::{compose, inverse, row_transform};
use super::model::RobotModel;
use crate::halton::halton;

/// Configurations at which the flanges are compared.
const CONFIGURATIONS: usize = 500;

/// How a link differs between two robots.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkDifference {
    /// The joint behind the link, or the flange's name.
    pub name: String,
    /// How far the second robot's frame is from the first one's, in the first one's axes, m.
    pub shift_m: [f64; 3],
    /// Its small turn about those axes, rad.
    pub turn_rad: [f64; 3],
}

/// How two robots differ.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotDifference {
    /// Base to flange; the first one contains the base.
    pub links: Vec<LinkDifference>,
    /// Mean distance of the two flanges over the first robot's joint ranges, both in their base, m.
    pub mean_m: f64,
    /// The largest of these distances, m.
    pub max_m: f64,
}

/// The frames of a robot's table in their predecessors, all joints at zero: base and first row, the other rows, the flange.
fn links(model: &RobotModel) -> Vec<Pose<f64>> {
    let mut before = model.base;
    let mut out: Vec<_> = model
        .rows()
        .iter()
        .map(|row| {
            compose(
                &std::mem::replace(&mut before, Pose::identity()),
                &row_transform(row, 0.0),
            )
        })
        .collect();
    out.push(model.flange);
    out
}

/// How `other` differs from `own`, frame by frame of their tables. `None` if they have different numbers of joints.
pub fn compare(own: &RobotModel, other: &RobotModel) -> Option<RobotDifference> {
    let joints = own.robot.dof();
    if other.robot.dof() != joints {
        return None;
    }
    let name = |k: usize| {
        let of = |model: &RobotModel| model.joint_names.get(k).filter(|name| !name.is_empty()).cloned();
        match k {
            k if k == joints => own.frame_names.1.clone(),
            k => of(own)
                .or_else(|| of(other))
                .unwrap_or_else(|| format!("joint_{}", k + 1)),
        }
    };
    let pairs = links(own).into_iter().zip(links(other)).enumerate();
    let links = pairs.map(|(k, (a, b))| {
        let off = compose(&inverse(&a), &b);
        let r = &off.rotation;
        LinkDifference {
            name: name(k),
            shift_m: off.position.into(),
            turn_rad: [
                (r[(2, 1)] - r[(1, 2)]) / 2.0,
                (r[(0, 2)] - r[(2, 0)]) / 2.0,
                (r[(1, 0)] - r[(0, 1)]) / 2.0,
            ],
        }
    });
    let distance = |k: usize| {
        let limits = own.robot.joints.iter().map(|joint| &joint.limits).enumerate();
        let q: Vec<f64> = limits
            .map(|(j, l)| l.min_rad + (l.max_rad - l.min_rad) * halton(k + 1, j))
            .collect();
        (own.flange_at(&q).position - other.flange_at(&q).position).norm()
    };
    let distances: Vec<f64> = (0..CONFIGURATIONS).map(distance).collect();
    Some(RobotDifference {
        links: links.collect(),
        mean_m: distances.iter().sum::<f64>() / CONFIGURATIONS as f64,
        max_m: distances.iter().copied().fold(0.0, f64::max),
    })
}
