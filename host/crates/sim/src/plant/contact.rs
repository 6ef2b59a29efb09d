//! Contact of the nest with spheres and plate, and the magnet.
//!
//! **Nest.** A cube corner about the TCP's z axis, open towards +z: three planes, each tangent to
//! the seated sphere at `p_i = R u_i` with `u_i = (√⅔ cos φ_i, √⅔ sin φ_i, −√⅓)`, φ = 0, 120, 240
//! degrees. The planes end at the rim, the height `rim_height_m` above the seated centre. Beyond it
//! follow the edge, the flat land of the nest's body out to `body_radius_m`, and its side. A sphere
//! that meets the edge slides in only as far as friction allows. A sphere that meets the land stays
//! there, because nothing centres it.
//!
//! **Pads** are analytic: penetration `δ`, force `max(0, k δ + d δ̇)` along the normal, friction `μ
//! f v_t / √(v_t² + v_0²)`. Regularised friction creeps under sustained load, at most at `v_0`.
//!
//! **Magnet.** The pole is 30 mm behind the seated sphere's centre on the nest's axis. The pull is
//! along the line from pole to sphere centre, `F_0 / (1 + gap/s)²`, where `gap` is the distance
//! beyond the seated one. So the pull on a seated sphere is `F_0`, and the field has a potential.
//!
//! Only impulses over several milliseconds are meaningful: impact peaks depend on the step.

use nalgebra::Vector3;
use spherecal_shared::robot::Pose;

use super::config::NestConfig;

/// Most touches at once: three pads, three edges and a land, four plate points, an obstacle.
pub(super) const MAX_TOUCHES: usize = 12;

/// Distance of the magnet's pole behind the seated sphere's centre, in m.
const POLE_M: f64 = 0.030;

/// Distance at which a contact is anticipated, in m. The implicit step then meets the surface with
/// its spring, not with the penetration of a sub-step.
const AHEAD_M: f64 = 5e-4;

/// Radius of the plate's surface about its centroid, in m.
const PLATE_RADIUS_M: f64 = 0.35;

/// What touches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TouchKind {
    /// A pad of the nest (0 to 2) on a sphere.
    Pad(u8),
    /// Edge, land or side of the nest's body on a sphere.
    Rim,
    /// The rim on the plate's surface.
    Plate,
    /// The TCP on an injected obstacle.
    Obstacle,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct ContactPoint {
    /// Point in F0, in m.
    pub(super) point: Vector3<f64>,
    /// Unit direction of the normal force on the tool, in F0.
    pub(super) normal: Vector3<f64>,
    /// Penetration, in m; negative for a gap that this sub-step may close.
    pub(super) depth: f64,
    /// Stiffness (N/m), damping (N s/m) and friction coefficient.
    pub(super) stiffness: f64,
    pub(super) damping: f64,
    pub(super) friction: f64,
    /// Speed under which friction is viscous, in m/s.
    pub(super) slow: f64,
    pub(super) kind: TouchKind,
}

pub(super) type Touches = heapless::Vec<ContactPoint, MAX_TOUCHES>;

/// The nest's shape, precomputed.
#[derive(Clone, Debug)]
pub(super) struct Nest {
    config: NestConfig,
    radius: f64,
    /// Outward direction of each pad in the nest's frame.
    pads: [Vector3<f64>; 3],
    /// Radial direction of each pad.
    radial: [Vector3<f64>; 3],
    /// Radial distance of the planes' edges, in m.
    edge: f64,
    /// Height of the sphere centre over the seated one beyond which a plane cannot be met, in m.
    reach: f64,
    /// Sphere-to-TCP distance beyond which there is neither contact nor pull, in m.
    pub(super) range: f64,
}

impl Nest {
    /// A nest for spheres of `radius`, in m.
    pub(super) fn new(config: &NestConfig, radius: f64) -> Self {
        let (sine, cosine) = ((2.0_f64 / 3.0).sqrt(), (1.0_f64 / 3.0).sqrt());
        let radial: [Vector3<f64>; 3] = core::array::from_fn(|i| {
            let (s, c) = libm::sincos(core::f64::consts::TAU / 3.0 * i as f64);
            Vector3::new(c, s, 0.0)
        });
        let body = config.body_radius_m.hypot(config.rim_height_m) + radius;
        Self {
            config: *config,
            radius,
            pads: radial.map(|e| e * sine - Vector3::z() * cosine),
            radial,
            edge: (radius + config.rim_height_m * cosine) / sine,
            reach: config.rim_height_m + radius * cosine,
            range: body.max(config.magnet_range_m + 2.0 * POLE_M),
        }
    }

    /// Pull and potential of the magnet at a gap: N and J.
    pub(super) fn magnet(&self, gap: f64) -> (f64, f64) {
        let c = &self.config;
        if !c.magnet || gap >= c.magnet_range_m {
            return (0.0, 0.0);
        }
        let (peak, scale) = (c.magnet_n, c.magnet_scale_m);
        let potential = |g: f64| -peak * scale / (1.0 + g / scale);
        let floor = potential(c.magnet_range_m);
        if gap <= 0.0 {
            return (peak, potential(0.0) - floor + peak * gap);
        }
        let ratio = 1.0 / (1.0 + gap / scale);
        (peak * ratio * ratio, potential(gap) - floor)
    }

    /// Pole of the magnet, force on the tool (N), potential (J) and gap (m), all in F0.
    #[inline]
    pub(super) fn pull(&self, tcp: &Pose<f64>, sphere: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>, f64, f64) {
        let pole = tcp.position - tcp.z() * POLE_M;
        let line = sphere - pole;
        let distance = line.norm();
        let gap = distance - POLE_M;
        let (force, potential) = self.magnet(gap);
        (pole, line * (force / distance.max(1e-6)), potential, gap)
    }

    /// Touches between the nest and one sphere. `seat` is the seated centre in
    /// the nest's frame (seating repeatability), in m.
    #[inline]
    pub(super) fn touch_sphere(
        &self,
        tcp: &Pose<f64>,
        sphere: &Vector3<f64>,
        seat: &Vector3<f64>,
        touches: &mut Touches,
    ) {
        let centre = tcp.rotation.tr_mul(&(sphere - tcp.position)) - seat;
        let inside = centre.xy().norm_squared() <= self.config.body_radius_m.powi(2);
        for (i, (u, e)) in self.pads.iter().zip(&self.radial).enumerate() {
            let along = e.dot(&centre);
            if inside && along < self.edge && centre.z <= self.reach {
                let depth = u.dot(&centre);
                if depth > -AHEAD_M && centre.z > -self.radius {
                    let normal = tcp.rotation * u;
                    self.push(
                        touches,
                        sphere + normal * self.radius,
                        normal,
                        depth,
                        TouchKind::Pad(i as u8),
                    );
                }
            } else {
                self.touch_body(tcp, sphere, &centre, e, along, touches);
            }
        }
    }

    /// Edge, land or side of the body behind one pad: a circular segment of
    /// `body_radius_m` beyond the plane's edge, from the rim downwards.
    fn touch_body(
        &self,
        tcp: &Pose<f64>,
        sphere: &Vector3<f64>,
        centre: &Vector3<f64>,
        e: &Vector3<f64>,
        along: f64,
        touches: &mut Touches,
    ) {
        let body = self.config.body_radius_m;
        let aside = Vector3::new(-e.y, e.x, 0.0);
        let across = aside.dot(centre);
        let corner = (body * body - self.edge * self.edge).max(0.0).sqrt();
        let shrink = body / libm::hypot(along, across).max(1e-9);
        let (a, b) = if along < self.edge {
            (self.edge, across.clamp(-corner, corner))
        } else if shrink >= 1.0 {
            (along, across)
        } else if along * shrink >= self.edge {
            (along * shrink, across * shrink)
        } else {
            (self.edge, corner.copysign(across))
        };
        let closest = e * a + aside * b + Vector3::z() * centre.z.clamp(-0.06, self.config.rim_height_m);
        let line = centre - closest;
        let distance = line.norm();
        if distance < self.radius + AHEAD_M && distance > 1e-9 {
            let normal = tcp.rotation * (-line / distance);
            self.push(
                touches,
                sphere + normal * distance,
                normal,
                self.radius - distance,
                TouchKind::Rim,
            );
        }
    }

    /// How far (m) a force (N) presses the pads in. Three of them at right angles are as stiff in every direction as one.
    pub(super) fn pressed_by(&self, force_n: f64) -> f64 {
        force_n / self.config.stiffness_n_m
    }

    #[inline]
    fn push(&self, touches: &mut Touches, point: Vector3<f64>, normal: Vector3<f64>, depth: f64, kind: TouchKind) {
        // The list holds every touch that can happen at once; more are dropped.
        let _ = touches.push(ContactPoint {
            point,
            normal,
            depth,
            stiffness: self.config.stiffness_n_m,
            damping: self.config.damping_n_s_m,
            friction: self.config.friction,
            slow: self.config.friction_speed_m_s,
            kind,
        });
    }

    /// Touches between the rim and the plate's surface; the surface is
    /// `below` under the plane of the plate's frame.
    pub(super) fn touch_plate(
        &self,
        tcp: &Pose<f64>,
        plate: &Pose<f64>,
        centroid: &Vector3<f64>,
        below: f64,
        touches: &mut Touches,
    ) {
        let up = plate.z();
        let rim = tcp.position + tcp.z() * self.config.rim_height_m;
        let height = up.dot(&(rim - plate.position)) + below;
        if height > self.config.body_radius_m || (rim - centroid).norm() > PLATE_RADIUS_M {
            return;
        }
        for k in 0..4 {
            let (s, c) = libm::sincos(core::f64::consts::FRAC_PI_2 * f64::from(k));
            let out = Vector3::new(c, s, 0.0) * self.config.body_radius_m;
            let point = rim + tcp.rotation * out;
            let depth = -(up.dot(&(point - plate.position)) + below);
            if depth > -AHEAD_M {
                self.push(touches, point, up, depth, TouchKind::Plate);
            }
        }
    }
}

/// A flat obstacle for the TCP: a half-space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlatObstacle {
    /// A point of its surface in F0, in m.
    pub point_m: [f64; 3],
    /// Outward normal of its surface in F0 (any length but zero).
    pub normal: [f64; 3],
    /// Stiffness, in N/m; a soft body is 1e4, steel 1e6.
    pub stiffness_n_m: f64,
}
