//! The workspace of a robot: where its calibration must be good.

use nalgebra::Vector3;

use crate::chain::Chain;
use crate::halton::spread;

/// Reach of the iiwa 7 with the paper's tool, in m: the box of the paper's Table 4 belongs to it.
const REACH_M: f64 = 1.4;
/// Share of each joint's range in which the configurations are.
const SHARE: f64 = 0.95;
/// Configurations whose largest distance from the base is the reach.
const FOR_REACH: usize = 500;
/// Configurations of which those in the box are taken.
const CANDIDATES: usize = 20_000;

/// `count` configurations of an arm, in rad, whose TCP is in its workspace.
///
/// They are spread evenly over 95 % of each joint's range (at most half a turn either way), and kept where the TCP is in
/// front of the arm: x from -0.05 to 1.0 m, y within 0.6 m, z from 0.13 to 1.15 m, scaled by the arm's reach over 1.4 m.
/// That is the box of the paper's Table 4 for any arm. An arm that hardly comes before its base has configurations anywhere in
/// its joint ranges.
pub fn workspace(chain: &Chain, count: usize) -> Vec<Vec<f64>> {
    let configuration = |k: usize| spread(chain.limits(), k, SHARE, std::f64::consts::PI);
    let at = |k: usize| chain.pose(&configuration(k)).position.norm();
    let scale = (1..=FOR_REACH).map(at).fold(0.1, f64::max) / REACH_M;
    let inside = |p: &Vector3<f64>| {
        (-0.05..=1.0).contains(&(p.x / scale)) && (p.y / scale).abs() <= 0.6 && (0.13..=1.15).contains(&(p.z / scale))
    };
    let found: Vec<Vec<f64>> = (1..CANDIDATES)
        .map(configuration)
        .filter(|q| inside(&chain.pose(q).position))
        .take(count)
        .collect();
    if found.len() == count {
        return found;
    }
    (1..=count).map(configuration).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robots;
    use spherecal_shared::robot::BUILT_IN;

    // Fails if a built-in robot's workspace leaves the joint limits, the front of the arm or the reach of the arm, or if a
    // robot that cannot come before its base has none.
    #[test]
    fn the_workspace_is_in_front_of_the_arm() {
        for name in BUILT_IN {
            let model = robots::load(name).expect("built in");
            let chain = Chain::new(&model.robot, &model.tool_in_table()).expect("a chain");
            let found = workspace(&chain, 200);
            assert_eq!(found.len(), 200, "{name}");
            for q in &found {
                assert!(chain.limit_margin(q) > 0.0, "{name}: {q:?}");
                let p = chain.pose(q).position;
                assert!(p.x > -0.15 && p.z > 0.05 && p.norm() < 3.0, "{name}: {p}");
            }
        }
    }
}
