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
    let found = configurations_in(
        chain,
        &[[-0.05, 1.0], [-0.6, 0.6], [0.13, 1.15]].map(|side| side.map(|x| x * scale)),
        count,
    );
    if found.len() == count {
        return found;
    }
    (1..=count).map(configuration).collect()
}

/// A box in a robot's base frame in which it is to work: least and greatest x, y and z, in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorkBox(pub [[f64; 2]; 3]);

/// Largest coordinate of a box, in mm.
const MOST_BOX_MM: f64 = 20_000.0;
/// Fewest configurations in a box over which an error is stated.
const FEWEST: usize = 20;

impl WorkBox {
    /// Reads `X0:X1,Y0:Y1,Z0:Z1` in mm.
    ///
    /// # Errors
    /// What the text should be.
    pub fn parse(text: &str) -> Result<Self, &'static str> {
        let form = "write three ranges in mm in the robot's base frame, such as 300:700,-200:200,100:600";
        let mut sides = [[0.0; 2]; 3];
        let mut words = text.split(',');
        for side in &mut sides {
            let (from, to) = words.next().and_then(|word| word.split_once(':')).ok_or(form)?;
            for (slot, number) in side.iter_mut().zip([from, to]) {
                *slot = number.trim().parse().map_err(|_| form)?;
            }
        }
        if words.next().is_some() {
            return Err(form);
        }
        Self::from_mm(sides)
    }

    /// Of ranges in mm.
    ///
    /// # Errors
    /// What the ranges should be.
    pub fn from_mm(sides: [[f64; 2]; 3]) -> Result<Self, &'static str> {
        if !sides.iter().flatten().all(|x| x.abs() <= MOST_BOX_MM) {
            return Err("give ranges in mm, within 20000");
        }
        if sides.iter().any(|side| side[0] >= side[1]) {
            return Err("the first number of a range is smaller than the second");
        }
        Ok(Self(sides.map(|side| side.map(|x| x * 1e-3))))
    }

    /// Up to `count` configurations of an arm with the TCP in the box, in rad.
    ///
    /// # Errors
    /// A box that the arm hardly reaches.
    pub fn configurations(&self, chain: &Chain, count: usize) -> Result<Vec<Vec<f64>>, &'static str> {
        let found = configurations_in(chain, &self.0, count);
        if found.len() < FEWEST {
            return Err(
                "the TCP is in this box in fewer than 20 of 20,000 postures: check that it is in mm, and in the robot's base frame",
            );
        }
        Ok(found)
    }
}

/// Up to `count` configurations of an arm, in rad, whose TCP is in a box of its base frame: least and greatest x, y and z, in m.
/// They are spread evenly over 95 % of each joint's range, at most half a turn either way.
fn configurations_in(chain: &Chain, box_m: &[[f64; 2]; 3], count: usize) -> Vec<Vec<f64>> {
    let inside = |p: &Vector3<f64>| {
        box_m
            .iter()
            .zip(p.iter())
            .all(|(side, x)| (side[0]..=side[1]).contains(x))
    };
    (1..CANDIDATES)
        .map(|k| spread(chain.limits(), k, SHARE, std::f64::consts::PI))
        .filter(|q| inside(&chain.pose(q).position))
        .take(count)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a box that cannot be is taken, if configurations have the TCP outside of theirs, or if a box out of reach has any.
    #[test]
    fn a_box_is_read_and_filled() {
        for wrong in [
            "",
            "1:2,3:4",
            "1:2,3:4,5:6,7:8",
            "1:2,3:4,5",
            "a:2,3:4,5:6",
            "2:1,3:4,5:6",
            "0:nan,0:1,0:1",
            "0:30000,0:1,0:1",
        ] {
            assert!(WorkBox::parse(wrong).is_err(), "{wrong}");
        }
        let model = robots::load("ur5e").expect("built in");
        let chain = Chain::new(&model.robot, &model.tool_in_table()).expect("a chain");
        let work = WorkBox::parse("300:600, -200:200, 100:500").expect("a box");
        let found = work.configurations(&chain, 200).expect("within reach");
        assert!(found.len() > 100, "{}", found.len());
        for q in found {
            let p = chain.pose(&q).position;
            assert!(
                (0.3..=0.6).contains(&p.x) && (-0.2..=0.2).contains(&p.y) && (0.1..=0.5).contains(&p.z),
                "{p}"
            );
        }
        let far = WorkBox::parse("3000:6000,-200:200,100:500").expect("a box");
        assert!(far.configurations(&chain, 200).is_err());
    }
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
