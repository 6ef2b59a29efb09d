//! The paper's pose grid (Section 4.2): on each sphere five angles about three
//! axes, and at each orientation five elbow angles.

use nalgebra::Rotation3;
use serde::{Deserialize, Serialize};

use super::path::Obstacle;
use super::start::{PlacedCell, Start};
use spherecal_model::chain::{Chain, TcpPose};

/// The angles of a grid about the neutral pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Grid {
    /// Angles about x, y and z of the tool, in rad.
    pub orientation_rad: Vec<f64>,
    /// Elbow angles from the neutral one, in rad; ignored on arms without an elbow.
    pub elbow_rad: Vec<f64>,
}

impl Default for Grid {
    fn default() -> Self {
        Self::paper()
    }
}

/// One reachable pose of a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct GridPose {
    /// Place in the full grid, from 0 (elbow fastest, then x, y, z).
    pub index: u32,
    /// The pose.
    pub pose: TcpPose,
    /// Joint angles continuous with the neutral pose, in rad.
    pub joints: Vec<f64>,
}

impl Grid {
    /// −20 to 20 degrees in steps of 10, for orientation and elbow: 625 poses per sphere.
    pub fn paper() -> Self {
        let angles: Vec<f64> = (-2..=2).map(|k| 10f64.to_radians() * f64::from(k)).collect();
        Self {
            orientation_rad: angles.clone(),
            elbow_rad: angles,
        }
    }

    /// Number of poses on one sphere.
    pub fn len(&self, chain: &Chain) -> usize {
        let elbows = if chain.has_elbow() { self.elbow_rad.len() } else { 1 };
        self.orientation_rad.len().pow(3) * elbows
    }

    /// All poses about `neutral`: turned by Rz Ry Rx in the tool's frame.
    pub fn poses(&self, neutral: &TcpPose) -> Vec<TcpPose> {
        let elbows: Vec<Option<f64>> = match neutral.elbow {
            Some(middle) => self.elbow_rad.iter().map(|e| Some(middle + e)).collect(),
            None => vec![None],
        };
        let mut poses = Vec::new();
        for z in &self.orientation_rad {
            for y in &self.orientation_rad {
                for x in &self.orientation_rad {
                    for elbow in &elbows {
                        poses.push(TcpPose {
                            position: neutral.position,
                            rotation: neutral.rotation * Rotation3::from_euler_angles(*x, *y, *z),
                            elbow: *elbow,
                        });
                    }
                }
            }
        }
        poses
    }

    /// The poses that the arm reaches by continuous motion from a start at a sphere, and in which it
    /// stands clear; and what is in the way of the others.
    pub(super) fn reachable(
        &self,
        placed: &PlacedCell<'_>,
        sphere: u32,
        start: &Start,
    ) -> (Vec<GridPose>, Vec<(u32, Obstacle)>) {
        let (mut good, mut bad) = (Vec::new(), Vec::new());
        for (index, pose) in (0..).zip(self.poses(&start.neutral)) {
            let end = placed
                .rules
                .follow(placed.chain, &start.neutral, &start.joints, &pose)
                .and_then(|joints| {
                    placed.rules.configuration(placed.chain, &joints)?;
                    placed.rules.astray(placed.chain, &pose, &joints)?;
                    placed.scene.standing(&joints, Some(sphere))?;
                    Ok(joints)
                });
            match end {
                Ok(joints) => good.push(GridPose { index, pose, joints }),
                Err(obstacle) => bad.push((index, obstacle)),
            }
        }
        (good, bad)
    }
}
