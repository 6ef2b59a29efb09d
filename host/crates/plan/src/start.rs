//! Where work at a sphere begins, and home: configurations in which the arm stands clear.
//!
//! An arm has several solutions for one pose. In some of them an elbow or a link is in the plate.
//! [`PlacedCell`] takes only those that keep the rules, the joint limits and every margin of the
//! [`Scene`], and prefers those with the largest distance to the joint limits.

use nalgebra::Vector3;

use super::cell::{Cell, PlatePose};
use super::contact_mass;
use super::error::PlanError;
use super::path::{Obstacle, Rules};
use super::scene::Scene;
use super::types::Waypoint;
use spherecal_identify::Sphere;
use spherecal_model::chain::{Chain, TcpPose, quaternion};

/// A cell with its plate in one placement.
pub(super) struct PlacedCell<'a> {
    pub(super) cell: &'a Cell,
    pub(super) chain: &'a Chain,
    pub(super) rules: &'a Rules,
    pub(super) plate: &'a PlatePose,
    /// What the arm must keep clear of.
    pub(super) scene: Scene,
}

/// Where work at a sphere begins.
#[derive(Clone)]
pub(super) struct Start {
    /// The neutral pose at the sphere's centre.
    pub(super) neutral: TcpPose,
    /// Its joint angles, in rad.
    pub(super) joints: Vec<f64>,
    pub(super) approach: Waypoint,
}

impl<'a> PlacedCell<'a> {
    pub(super) fn new(cell: &'a Cell, chain: &'a Chain, rules: &'a Rules, plate: &'a PlatePose) -> Self {
        let scene = Scene::planned(cell, chain, plate);
        Self {
            cell,
            chain,
            rules,
            plate,
            scene,
        }
    }

    /// All clear starts at a sphere with the elbow at its neutral angle, those with the largest
    /// distance to the joint limits first: at least one.
    /// Errors: what stands in the way of the last solution, or that there is none.
    pub(super) fn starts(&self, sphere: &Sphere, yaw: f64) -> Result<Vec<Start>, PlanError> {
        let neutral = self.cell.neutral_pose(self.chain, self.plate, sphere, yaw);
        let refuse = |obstacle| out_of_reach(sphere.id, &neutral.position, obstacle);
        let mut obstacle = Obstacle::OutOfReach;
        let mut starts = Vec::new();
        for joints in self.solutions(&neutral, Some(sphere.id)).map_err(refuse)? {
            match self.start_at(neutral, joints) {
                Ok(start) => starts.push(start),
                Err(why) => obstacle = why,
            }
        }
        if starts.is_empty() {
            return Err(refuse(obstacle));
        }
        Ok(starts)
    }

    /// The start at a neutral pose that is already solved, with the approach above it.
    /// Errors: an arm that would meet the sphere with too much mass, the obstacle on the straight way up, or at its
    /// end.
    pub(super) fn start_at(&self, neutral: TcpPose, joints: Vec<f64>) -> Result<Start, Obstacle> {
        let direction = self.cell.approach_direction(self.plate);
        let above = TcpPose {
            position: neutral.position - direction * self.cell.approach_height_m,
            ..neutral
        };
        contact_mass::check(
            &self.cell.robot,
            &self.cell.tool,
            &self.cell.contact,
            &joints,
            &direction,
        )?;
        let approach = self.rules.follow(self.chain, &neutral, &joints, &above)?;
        self.scene.standing(&approach, None)?;
        Ok(Start {
            neutral,
            joints,
            approach: waypoint(&above, approach),
        })
    }

    /// The starts of `starts` that a clear straight joint motion from home (rad) reaches. If there is
    /// none, the first to which a way through vias leads.
    /// Errors: no way leads to any of them.
    pub(super) fn entered(&self, home: &Waypoint, sphere: u32, starts: Vec<Start>) -> Result<Vec<Start>, PlanError> {
        let (clear, others): (Vec<_>, Vec<_>) = starts.into_iter().partition(|start| self.straight(home, start));
        if !clear.is_empty() {
            return Ok(clear);
        }
        let position = others
            .first()
            .map_or_else(Vector3::zeros, |start| start.neutral.position);
        let over = |start: &Start| self.scene.way(&home.joints, &start.approach.joints).is_some();
        match others.into_iter().find(over) {
            Some(start) => Ok(vec![start]),
            None => Err(out_of_reach(sphere, &position, Obstacle::NoWay)),
        }
    }

    /// Whether the straight joint motion from home to the approach of a start is clear.
    pub(super) fn straight(&self, home: &Waypoint, start: &Start) -> bool {
        self.scene.is_clear(&home.joints, &start.approach.joints)
    }

    /// The tool's yaw: the cell's own, or the one of twelve whose worst sphere has the largest
    /// distance to the joint limits.
    /// Errors: a sphere has no start at any yaw.
    pub(super) fn tool_yaw(&self) -> Result<f64, PlanError> {
        if let Some(yaw) = self.cell.tool_yaw_rad {
            return Ok(yaw);
        }
        let mut best: Option<(f64, f64)> = None;
        let mut refusal = PlanError::NoSpheres;
        for k in 0..12 {
            let yaw = f64::from(k) * core::f64::consts::TAU / 12.0;
            let mut room = f64::INFINITY;
            for sphere in &self.cell.spheres {
                match self.starts(sphere, yaw) {
                    Ok(starts) => {
                        let best = starts.first().map(|start| self.chain.limit_margin(&start.joints));
                        room = room.min(best.unwrap_or(f64::NEG_INFINITY));
                    }
                    Err(why) => {
                        room = f64::NEG_INFINITY;
                        refusal = why;
                    }
                }
            }
            if room.is_finite() && best.is_none_or(|(r, _)| room > r) {
                best = Some((room, yaw));
            }
        }
        best.map(|(_, yaw)| yaw).ok_or(refusal)
    }

    /// The clear solutions of a pose that keep the rules for passing, those with the largest distance
    /// to the joint limits first. `seated`: the sphere on which the nest sits.
    fn solutions(&self, pose: &TcpPose, seated: Option<u32>) -> Result<Vec<Vec<f64>>, Obstacle> {
        let passing = self.rules.passing();
        let mut found: Vec<Vec<f64>> = Vec::new();
        let mut obstacle = Obstacle::OutOfReach;
        for q in self.chain.solve(pose) {
            let kept = passing.configuration(self.chain, &q);
            match kept.and_then(|()| self.scene.standing(&q, seated)) {
                Ok(()) => found.push(q),
                Err(why) => obstacle = why,
            }
        }
        if found.is_empty() {
            return Err(obstacle);
        }
        let room = |q: &Vec<f64>| self.chain.limit_margin(q);
        found.sort_by(|a, b| room(b).total_cmp(&room(a)));
        Ok(found)
    }
}

/// Home: the neutral orientation high above the middle of the first plate.
///
/// # Errors
/// There is no plate, or none within the arm's reach.
pub fn home(cell: &Cell, chain: &Chain, rules: &Rules) -> Result<Waypoint, PlanError> {
    let plate = cell.plates.first().ok_or(PlanError::NoPlate)?;
    let placed = PlacedCell::new(cell, chain, rules, plate);
    let pose = TcpPose {
        position: Vector3::from(plate.centre_m) - cell.approach_direction(plate) * cell.home_height_m,
        rotation: cell.neutral(plate, placed.tool_yaw()?),
        elbow: chain.has_elbow().then_some(0.0),
    };
    let found = placed.solutions(&pose, None);
    let joints = found.map_err(|obstacle| out_of_reach(0, &pose.position, obstacle))?;
    let joints = joints.into_iter().next().unwrap_or_default();
    Ok(waypoint(&pose, joints))
}

fn out_of_reach(sphere: u32, position: &Vector3<f64>, obstacle: Obstacle) -> PlanError {
    let p = position * 1e3;
    PlanError::SphereOutOfReach {
        sphere,
        x_mm: p.x,
        y_mm: p.y,
        z_mm: p.z,
        obstacle,
    }
}

fn waypoint(pose: &TcpPose, joints: Vec<f64>) -> Waypoint {
    Waypoint {
        position_m: pose.position.into(),
        orientation: quaternion(&pose.rotation),
        elbow_rad: pose.elbow,
        joints,
    }
}
