//! The true state behind the sensors: for tests and figures only.

use nalgebra::Vector3;
use spherecal_shared::robot::{Dynamics, Pose};

use super::contact::{TouchKind, Touches};
use super::simulation::Plant;
use super::world::{MAX_SPHERES, TrueCell};

/// The true state. For tests and figures only: no controller, campaign or identification may see
/// any of it.
#[derive(Clone, Debug)]
pub struct Truth<const N: usize> {
    /// Link angles, in rad.
    pub q: [f64; N],
    /// Link velocities, in rad/s.
    pub dq: [f64; N],
    /// TCP frame in F0 (m), bending included.
    pub tcp: Pose<f64>,
    /// Distance of the TCP from each sphere's centre, in m; infinite for one that was taken away.
    pub gap_m: heapless::Vec<f64, MAX_SPHERES>,
    /// Sphere (from 0) on which the nest sits with all three pads.
    pub seated: Option<usize>,
    /// Normal force of each pad, in N, static part.
    pub pad_n: [f64; 3],
    /// What else touches.
    pub rim: bool,
    /// The rim touches the plate.
    pub plate: bool,
    /// Contact force on the tool, normal static parts, in N, F0.
    pub contact_n: Vector3<f64>,
    /// Pull of the magnet on the tool, in N, F0.
    pub magnet_n: Vector3<f64>,
    /// Kinetic energy, in J.
    pub kinetic_j: f64,
    /// Potential energy of gravity, pads, magnet and joint springs, in J.
    pub potential_j: f64,
}

impl<const N: usize> Plant<N> {
    /// What is really so. For tests and figures only.
    pub fn truth(&self) -> Truth<N> {
        let q: [f64; N] = self.motion.q.data.0[0];
        let frames = self.world.arm.frames(&q);
        let bodies = self.world.arm.bodies(&frames);
        let mut tcp = self.world.arm.tcp_frame(&frames);
        tcp.position += self.bend;
        let mut mass = bodies.mass_matrix();
        for i in 0..N {
            mass[(i, i)] += self.joints.rotor[i];
        }
        let mut truth = Truth {
            q,
            dq: self.motion.v.data.0[0],
            gap_m: self
                .world
                .spheres
                .iter()
                .map(|s| s.map_or(f64::INFINITY, |s| (s - tcp.position).norm()))
                .collect(),
            tcp,
            seated: None,
            pad_n: [0.0; 3],
            rim: false,
            plate: false,
            contact_n: Vector3::zeros(),
            magnet_n: Vector3::zeros(),
            kinetic_j: 0.5 * self.motion.v.dot(&(mass * self.motion.v)),
            potential_j: bodies_potential(&self.world, &frames, self.payload_kg),
        };
        if let Some(elastic) = &self.joints.elastic {
            let wind = self.motion.motor - self.motion.q;
            for i in 0..N {
                truth.potential_j += 0.5 * elastic.stiffness[i] * wind[i] * wind[i];
                truth.kinetic_j += 0.5 * elastic.motor[i] * self.motion.motor_v[i] * self.motion.motor_v[i];
            }
        }
        let nearest = self.nearest(&tcp);
        let mut touches = Touches::new();
        self.touches_at(&tcp, nearest.as_ref(), &mut touches);
        for touch in touches.iter().filter(|t| t.depth > 0.0) {
            let force = touch.stiffness * touch.depth;
            truth.potential_j += 0.5 * force * touch.depth;
            truth.contact_n += touch.normal * force;
            match touch.kind {
                TouchKind::Pad(i) => truth.pad_n[usize::from(i)] = force,
                TouchKind::Rim => truth.rim = true,
                TouchKind::Plate => truth.plate = true,
                TouchKind::Obstacle => {}
            }
        }
        if let (Some(sphere), true) = (&nearest, self.magnet_on) {
            let (_, force, potential, _) = self.nest.pull(&tcp, sphere);
            truth.magnet_n = force;
            truth.potential_j += potential;
        }
        if truth.pad_n.iter().all(|f| *f > 0.0) {
            // The seat itself may be off.
            let most = 1e-4 + self.seat.norm();
            truth.seated = truth.gap_m.iter().position(|gap| *gap < most);
        }
        truth
    }

    /// The true world behind the sensors. For tests and figures only.
    pub fn world(&self) -> &TrueCell<N> {
        &self.world
    }
}

/// Potential energy of gravity, in J, zero with all masses at the height of F0.
fn bodies_potential<const N: usize>(world: &TrueCell<N>, frames: &[Pose<f64>; N], payload_kg: f64) -> f64 {
    let g = spherecal_shared::robot::GRAVITY_M_S2;
    let mut sum = 0.0;
    for (joint, frame) in world.robot.joints.iter().zip(frames) {
        sum += joint.link.mass_kg * g * frame.point(&joint.link.com()).z;
    }
    if let Some(flange) = frames.last() {
        sum += world.tool.body.mass_kg * g * flange.point(&world.tool.body.com()).z;
        sum += payload_kg * g * flange.point(&world.tool.tcp()).z;
    }
    sum
}
