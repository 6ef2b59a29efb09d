//! What a moving arm must keep clear of, and how far away it is.
//!
//! [`Scene`] holds the spheres on their posts, the plate, the arm itself, the workspace and the joint
//! limits. For joint angles it gives one *clearance* per item: the distance that is left beyond the
//! item's margin, in m, negative where the arm is too near. The campaign plans every move of a free
//! arm on it ([`Scene::way`]), and the retreat from a sphere ([`Scene::retreat`]).
//!
//! The shapes are simple and a little too large. The nest is a cylinder about the tool's z axis with
//! a conical seat. Links are capsules between the origins of consecutive frames. The plate is a disc.

use nalgebra::Vector3;
use spherecal_shared::procedure::Limits;
use spherecal_shared::robot::Pose;

use super::cell::{Cell, Obstacles, PlatePose};
use super::path::{CollisionObject, Obstacle};
use super::types::Plan;
use spherecal_identify::Sphere;
use spherecal_model::chain::Chain;

/// Distance that nest and links keep to spheres, posts and plate, in m: the error of the nominal
/// model and of a waypoint that was taught by hand.
const MARGIN_M: f64 = 0.008;
/// Radius of the nest's body, and its ends along the tool's z axis seen from the seated centre, in m
/// (Figure 2 of the paper).
const NEST_RADIUS_M: f64 = 0.042;
const NEST_BACK_M: f64 = -0.060;
const RIM_M: f64 = 0.0025;
/// Radius of the tool between flange and nest, of the last links, and of the links near the base,
/// in m.
const TOOL_RADIUS_M: f64 = 0.045;
const LINK_RADIUS_M: f64 = 0.055;
const BASE_RADIUS_M: f64 = 0.070;
/// Radius of the posts on which the spheres stand, in m.
const POST_RADIUS_M: f64 = 0.012;
/// How far the plate reaches beyond its outermost sphere, in m.
const PLATE_RIM_M: f64 = 0.080;
/// Length that counts as much as an angle of 1 rad, in m.
const M_PER_RAD: f64 = 0.5;

#[derive(Clone, Copy, Debug)]
struct Surface {
    centre: Vector3<f64>,
    normal: Vector3<f64>,
    radius: f64,
}

/// A ball that must not be touched: a sphere, or a part of its post.
#[derive(Clone, Copy, Debug)]
struct Ball {
    sphere: u32,
    centre: Vector3<f64>,
    radius: f64,
}

/// A link: its ends and its radius, in m.
type Link = (Vector3<f64>, Vector3<f64>, f64);

/// An arm in its cell, with one placement of the plate.
#[derive(Clone, Debug)]
pub struct Scene {
    pub(super) chain: Chain,
    pub(super) home: Option<Vec<f64>>,
    balls: Vec<Ball>,
    surface: Option<Surface>,
    pub(super) limits: Limits,
    /// Direction away from the plate.
    pub(super) up: Vector3<f64>,
    sphere_radius: f64,
}

impl Scene {
    /// The scene of a plan with the plate in placement `place`. The controller stops the arm at
    /// `limits`. A sphere that was found elsewhere than planned is given in `found`: its id, and
    /// its centre in F0, in m.
    pub fn new(plan: &Plan, chain: &Chain, place: u32, limits: &Limits, found: &[(u32, Vector3<f64>)]) -> Self {
        let visits: Vec<_> = plan.spheres.iter().filter(|visit| visit.place == place).collect();
        let up = visits
            .iter()
            .map(|visit| -Vector3::from(visit.approach_direction))
            .sum::<Vector3<f64>>()
            .try_normalize(0.1)
            .unwrap_or_else(Vector3::z);
        let mut centres: Vec<(u32, Vector3<f64>)> = Vec::new();
        for visit in visits {
            if !centres.iter().any(|(id, _)| *id == visit.sphere_id) {
                let known = found.iter().find(|(id, _)| *id == visit.sphere_id);
                let centre = known.map_or_else(|| visit.position_m.into(), |(_, centre)| *centre);
                centres.push((visit.sphere_id, centre));
            }
        }
        let home = Some(plan.home.joints.clone());
        Self::build(chain, home, up, &centres, plan.obstacles, limits)
    }

    /// The scene of a cell with the plate at its nominal pose `plate`, before there is a plan. Joint
    /// limits and workspace are those of the default procedure.
    pub(super) fn planned(cell: &Cell, chain: &Chain, plate: &PlatePose) -> Self {
        let centre = |sphere: &Sphere| (sphere.id, cell.sphere_in_base(plate, sphere));
        let centres: Vec<(u32, Vector3<f64>)> = cell.spheres.iter().map(centre).collect();
        let up = plate.normal().into_inner();
        Self::build(chain, None, up, &centres, cell.obstacles, &Limits::default())
    }

    fn build(
        chain: &Chain,
        home: Option<Vec<f64>>,
        up: Vector3<f64>,
        centres: &[(u32, Vector3<f64>)],
        shape: Obstacles,
        limits: &Limits,
    ) -> Self {
        let mut balls = Vec::new();
        for (sphere, centre) in centres {
            balls.push(Ball {
                sphere: *sphere,
                centre: *centre,
                radius: shape.sphere_radius_m,
            });
            for part in 1..=3 {
                let below = shape.sphere_radius_m
                    + (shape.surface_below_m - shape.sphere_radius_m) * (f64::from(part) - 0.5) / 3.0;
                balls.push(Ball {
                    sphere: *sphere,
                    centre: centre - up * below,
                    radius: POST_RADIUS_M,
                });
            }
        }
        let middle = centres.iter().map(|(_, c)| c).sum::<Vector3<f64>>() / centres.len().max(1) as f64;
        let reach = centres.iter().map(|(_, c)| (c - middle).norm()).fold(0.0, f64::max);
        let surface = (!centres.is_empty()).then(|| Surface {
            centre: middle - up * shape.surface_below_m,
            normal: up,
            radius: reach + PLATE_RIM_M,
        });
        Self {
            chain: chain.clone(),
            home,
            balls,
            surface,
            limits: *limits,
            up,
            sphere_radius: shape.sphere_radius_m,
        }
    }

    /// Whether an arm at `q` (rad) keeps its margins to spheres, posts, plate and itself. The sphere
    /// `seated` and its post do not count: the nest sits on it.
    /// Errors: the part that is nearest, and how far it is within its margin.
    pub(super) fn standing(&self, q: &[f64], seated: Option<u32>) -> Result<(), Obstacle> {
        let clearances = self.clearances(q);
        let balls = self.balls.iter().map(|ball| CollisionObject::Sphere(ball.sphere));
        let parts = balls
            .chain(self.surface.iter().map(|_| CollisionObject::Plate))
            .chain([CollisionObject::Arm]);
        let nearest = parts
            .zip(&clearances)
            .filter(|(part, _)| seated.is_none_or(|id| *part != CollisionObject::Sphere(id)))
            .min_by(|a, b| a.1.total_cmp(b.1));
        match nearest {
            Some((part, clearance)) if *clearance < 0.0 => Err(Obstacle::TooNear {
                part,
                by_mm: -clearance * 1e3,
            }),
            _ => Ok(()),
        }
    }

    /// The nest's frame, and the last links and the tool up to the nest: their ends and radii, in m. `None` without joints.
    fn shapes(&self, frames: &[Pose<f64>]) -> Option<(Pose<f64>, Vec<Link>)> {
        let flange = frames.last()?;
        let nest = Pose {
            position: self.chain.tcp_of(frames),
            rotation: flange.rotation,
        };
        let back = nest.position + nest.z() * NEST_BACK_M;
        let n = frames.len();
        let origin = |k: usize| frames.get(k).map_or_else(Vector3::zeros, |f| f.position);
        // A tool that is shorter than the nest, as the bare flange is, ends the last link there.
        let in_nest = nest.z().dot(&(flange.position - back)) > 0.0;
        let end = if in_nest { back } else { flange.position };
        let mut links: Vec<Link> = (n.saturating_sub(4)..n - 1)
            .map(|k| (origin(k), if k + 2 == n { end } else { origin(k + 1) }, LINK_RADIUS_M))
            .collect();
        links.push((end, back, TOOL_RADIUS_M));
        Some((nest, links))
    }

    /// Whether nest or links of an arm at `q` (rad) are under the plate: there is no way up from there that the shapes of
    /// this scene could judge.
    pub(super) fn is_below_the_plate(&self, q: &[f64]) -> bool {
        let shapes = self.shapes(&self.chain.frames(q));
        let below = |surface: &Surface| shapes.is_some_and(|(nest, links)| surface.is_over(&nest, &links));
        self.surface.as_ref().is_some_and(below)
    }

    /// The clearances at joint angles `q` (rad), in m: one per ball, then plate, arm, workspace and
    /// joint limits.
    pub(super) fn clearances(&self, q: &[f64]) -> Vec<f64> {
        let frames = self.chain.frames(q);
        let Some((nest, links)) = self.shapes(&frames) else {
            return Vec::new();
        };
        let tcp = nest.position;
        let origin = |k: usize| frames.get(k).map_or_else(Vector3::zeros, |f| f.position);
        let n = frames.len();

        let mut all = Vec::with_capacity(self.balls.len() + 4);
        for ball in &self.balls {
            let to_nest = nest_distance(&nest, &ball.centre) - ball.radius;
            let nearest = links
                .iter()
                .map(|(a, b, radius)| (ball.centre - closest(a, b, &ball.centre)).norm() - radius - ball.radius)
                .fold(to_nest.max(self.in_seat(&nest, ball)), f64::min);
            all.push(nearest - MARGIN_M);
        }
        if let Some(surface) = &self.surface {
            all.push(surface.above(&nest, &links) - MARGIN_M);
        }
        // Nest and tool against the links up to the elbow.
        let mut own = f64::INFINITY;
        let mut from = Vector3::zeros();
        for k in 0..=n.saturating_sub(4) {
            let to = origin(k);
            let gap = apart(&from, &to, &origin(n - 1), &tcp);
            own = own.min(gap - BASE_RADIUS_M - TOOL_RADIUS_M);
            from = to;
        }
        all.push(own);
        all.push(self.inside(&tcp));
        all.push((self.chain.limit_margin(q) - self.limits.position_margin_rad) * M_PER_RAD);
        all
    }

    /// Distance of a seated ball to the seat, in m: 0 where it touches. The seat is a cone that
    /// lies inside the pads. Minus infinity outside it.
    fn in_seat(&self, nest: &Pose<f64>, ball: &Ball) -> f64 {
        let centre = nest.rotation.tr_mul(&(ball.centre - nest.position));
        let (across, along) = (centre.xy().norm(), centre.z);
        let edge = (self.sphere_radius + RIM_M * 0.577) / 0.8165;
        if ball.radius < self.sphere_radius || across > edge || along < -self.sphere_radius {
            return f64::NEG_INFINITY;
        }
        along * 0.577 - across * 0.8165
    }

    /// Distance of the TCP to the nearest bound at which the controller stops it, in m.
    fn inside(&self, tcp: &Vector3<f64>) -> f64 {
        let limits = &self.limits;
        let mut least = Vector3::from(limits.plate_normal).dot(tcp) - limits.plate_offset_m;
        for axis in 0..3 {
            least = least
                .min(tcp[axis] - limits.workspace_min_m[axis])
                .min(limits.workspace_max_m[axis] - tcp[axis]);
        }
        least
    }
}

impl Surface {
    /// Height of the lowest point of nest and links above the plate, in m. What is beside the plate
    /// does not count.
    fn above(&self, nest: &Pose<f64>, links: &[Link]) -> f64 {
        let mut least = f64::INFINITY;
        let mut look = |point: &Vector3<f64>, radius: f64| {
            let height = self.normal.dot(&(point - self.centre));
            let beside = (point - self.centre - self.normal * height).norm();
            if beside <= self.radius + radius {
                least = least.min(height - radius);
            }
        };
        let z = nest.z();
        let tilt = (1.0 - self.normal.dot(&z).powi(2)).max(0.0).sqrt();
        look(&(nest.position + z * RIM_M), NEST_RADIUS_M * tilt);
        for (a, b, radius) in links {
            for part in 0..=2 {
                look(&(a + (b - a) * (f64::from(part) / 2.0)), *radius);
            }
        }
        least
    }
}

impl Surface {
    /// Whether the TCP or a part of the links' axes is under the plate by more than a margin.
    fn is_over(&self, nest: &Pose<f64>, links: &[Link]) -> bool {
        let parts = links.iter().flat_map(|(a, b, _)| [*a, (a + b) * 0.5, *b]);
        parts.chain([nest.position]).any(|point| {
            let height = self.normal.dot(&(point - self.centre));
            height < -MARGIN_M && (point - self.centre - self.normal * height).norm() <= self.radius
        })
    }
}

/// Distance of a point to the cylinder about the nest, in m; negative inside.
fn nest_distance(nest: &Pose<f64>, point: &Vector3<f64>) -> f64 {
    let p = nest.rotation.tr_mul(&(point - nest.position));
    let radial = p.xy().norm() - NEST_RADIUS_M;
    let axial = (p.z - RIM_M).max(NEST_BACK_M - p.z);
    if radial <= 0.0 && axial <= 0.0 {
        return radial.max(axial);
    }
    radial.max(0.0).hypot(axial.max(0.0))
}

/// The point of a segment that is closest to `p`.
fn closest(a: &Vector3<f64>, b: &Vector3<f64>, p: &Vector3<f64>) -> Vector3<f64> {
    let line = b - a;
    let square = line.norm_squared();
    if square < 1e-12 {
        return *a;
    }
    a + line * ((p - a).dot(&line) / square).clamp(0.0, 1.0)
}

/// Distance between two segments, to a millimetre: by alternating projection.
fn apart(a: &Vector3<f64>, b: &Vector3<f64>, c: &Vector3<f64>, d: &Vector3<f64>) -> f64 {
    let mut p = (a + b) * 0.5;
    let mut q = closest(c, d, &p);
    for _ in 0..20 {
        p = closest(a, b, &q);
        q = closest(c, d, &p);
    }
    (p - q).norm()
}
