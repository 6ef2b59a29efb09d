//! One control tick of the plant's motion: finds contacts, chooses the integrator, and runs the
//! sub-steps.

use nalgebra::{SVector, Vector3};
use spherecal_shared::robot::{Dynamics, Pose};

use super::contact::{ContactPoint, TouchKind, Touches};
use super::integrate::ExternalForces;
use super::sensors::TICK_S;
use super::simulation::Plant;

impl<const N: usize> Plant<N> {
    /// One tick of motion; returns the mean torque at the sensors.
    pub(super) fn advance(&mut self) -> SVector<f64, N> {
        let frames = self.world.arm.frames(&self.motion.q.data.0[0]);
        let tcp = self.shifted_tcp(&frames);
        if self.is_smooth(&tcp) {
            self.coupling.near = false;
            let h = TICK_S / f64::from(self.free_steps);
            let mut mean = SVector::zeros();
            let arm = &self.world.arm;
            for k in 0..self.free_steps {
                let start = if k == 0 {
                    frames
                } else {
                    arm.frames(&self.motion.q.data.0[0])
                };
                match self.motion.step_free(arm, &start, &self.joints, &self.last_tau, h) {
                    Some(seen) => mean += seen / f64::from(self.free_steps),
                    None => return self.last_tau,
                }
            }
            return mean;
        }
        let h = TICK_S / f64::from(self.substeps);
        let nearest = self.nearest(&tcp);
        if let Some(sphere) = nearest {
            self.seat = self.coupling.seat(&tcp, &self.world.plate, &sphere, &self.config);
        } else {
            self.coupling.near = false;
        }
        let mut mean = SVector::zeros();
        let mut touches = Touches::new();
        let mut frames = frames;
        for k in 0..self.substeps {
            if k > 0 {
                frames = self.world.arm.frames(&self.motion.q.data.0[0]);
            }
            let bodies = self.world.arm.bodies(&frames);
            let mut tcp = self.world.arm.tcp_frame(&frames);
            tcp.position += self.bend;
            let mut pulls = [(tcp.position, self.hand_force); 2];
            let mut pulled = usize::from(self.hand_force != Vector3::zeros());
            self.touches_at(&tcp, nearest.as_ref(), &mut touches);
            if let (Some(sphere), true) = (&nearest, self.magnet_on) {
                let (pole, force, _, _) = self.nest.pull(&tcp, sphere);
                pulls[pulled] = (pole, force);
                pulled += 1;
            }
            let extra = self.disturbance + self.world.cable.torque(&self.motion.q);
            let load = ExternalForces {
                tau: &self.last_tau,
                extra: &extra,
                pulls: &pulls[..pulled],
                moment: self.hand_moment,
                touches: &touches,
            };
            match self.motion.step_stiff(&frames, &bodies, &self.joints, &load, h) {
                Some(seen) => mean += seen / f64::from(self.substeps),
                None => return self.last_tau,
            }
        }
        mean
    }

    /// Whether this tick has no stiff force: no contact within reach, no dry friction, no end stop,
    /// no push, no cable.
    fn is_smooth(&self, tcp: &Pose<f64>) -> bool {
        let inside = |i: usize| {
            let (low, high) = self.joints.stops[i];
            self.motion.q[i] > low + 0.02 && self.motion.q[i] < high - 0.02
        };
        self.joints.elastic.is_none()
            && self.joints.coulomb.iter().all(|c| *c == 0.0)
            && self.joints.viscous.iter().all(|b| *b <= 1.0)
            && self.obstacle.is_none()
            && self.hand_force == Vector3::zeros()
            && self.hand_moment == Vector3::zeros()
            && self.disturbance == SVector::<f64, N>::zeros()
            && !self.world.cable.is_on()
            && (0..N).all(inside)
            && (!self.config.contact || (self.nearest(tcp).is_none() && !self.near_plate(tcp)))
    }

    /// The sphere within reach of the nest, if contact is on.
    pub(super) fn nearest(&self, tcp: &Pose<f64>) -> Option<Vector3<f64>> {
        if !self.config.contact {
            return None;
        }
        let reach = self.nest.range + 0.01;
        let mut nearest = None;
        let mut least = reach * reach;
        for centre in self.world.spheres.iter().flatten() {
            let square = (centre - tcp.position).norm_squared();
            if square < least {
                least = square;
                nearest = Some(*centre);
            }
        }
        nearest
    }

    /// Whether the nest is low over the plate.
    fn near_plate(&self, tcp: &Pose<f64>) -> bool {
        let plate = &self.world.plate;
        plate.z().dot(&(tcp.position - plate.position)) + self.config.cell.plate.surface_below_m
            < self.config.nest.body_radius_m + 0.02
    }

    /// All touches with the nest at `tcp` and a sphere within reach.
    pub(super) fn touches_at(&self, tcp: &Pose<f64>, sphere: Option<&Vector3<f64>>, touches: &mut Touches) {
        touches.clear();
        if let Some(sphere) = sphere {
            self.nest.touch_sphere(tcp, sphere, &self.seat, touches);
        }
        if self.config.contact {
            let below = self.config.cell.plate.surface_below_m;
            self.nest
                .touch_plate(tcp, &self.world.plate, &self.centroid, below, touches);
        }
        if let Some(obstacle) = &self.obstacle {
            let normal = Vector3::from(obstacle.normal).normalize();
            let depth = normal.dot(&(Vector3::from(obstacle.point_m) - tcp.position));
            if depth > 0.0 {
                // There is room: a sphere and the plate make at most nine touches.
                let _ = touches.push(ContactPoint {
                    point: tcp.position,
                    normal,
                    depth,
                    stiffness: obstacle.stiffness_n_m,
                    damping: obstacle.stiffness_n_m * 1e-3,
                    friction: 0.3,
                    slow: 1e-3,
                    kind: TouchKind::Obstacle,
                });
            }
        }
    }

    /// The TCP at the given frames; updates the displacement by bending.
    fn shifted_tcp(&mut self, frames: &[Pose<f64>; N]) -> Pose<f64> {
        let mut tcp = self.world.arm.tcp_frame(frames);
        if self.world.bends() {
            self.bend = self.world.bending(frames, &tcp.position);
        }
        tcp.position += self.bend;
        tcp
    }
}
