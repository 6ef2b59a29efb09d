//! What may happen to the plant from outside, for fault injection and for the
//! simulated hand: explicit methods, none of which the controller can see but
//! through its sensors.

use nalgebra::{SVector, Vector3};

use super::draw::draw_spheres;
use super::simulation::{Plant, centroid_of};

/// A flat obstacle for the TCP: a half-space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacle {
    /// A point of its surface in F0, in m.
    pub point_m: [f64; 3],
    /// Outward normal of its surface in F0 (any length but zero).
    pub normal: [f64; 3],
    /// Stiffness, in N/m; a soft body is 1e4, steel 1e6.
    pub stiffness_n_m: f64,
}

/// Fault of one joint's torque sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TorqueSensorFault {
    /// Reads zero.
    Dead,
    /// Reads this much too high, in N m.
    Bias(f64),
}

impl<const N: usize> Plant<N> {
    /// A hand, a person or anything that pushes at the TCP: force (N) and moment
    /// (N m) on the tool, F0 axes, until it is set again.
    pub fn set_hand_wrench(&mut self, force_n: [f64; 3], moment_nm: [f64; 3]) {
        self.hand_force = Vector3::from(force_n);
        self.hand_moment = Vector3::from(moment_nm);
    }

    /// Torque from outside on the joints (a push at the elbow), in N m, until it is set again.
    pub fn set_joint_disturbance(&mut self, tau_nm: [f64; N]) {
        self.disturbance = SVector::from(tau_nm);
    }

    /// Switches the magnet off (lost while coupled) or on again.
    pub fn set_magnet(&mut self, on: bool) {
        self.magnet_on = on;
    }

    /// Moves the plate with its spheres to another of its placements, from 0;
    /// returns whether there is such a one.
    pub fn move_plate(&mut self, place: u32) -> bool {
        let Some(plate) = self.world.plates.get(place as usize) else {
            return false;
        };
        self.world.plate = *plate;
        self.world.spheres = draw_spheres(&self.config, plate);
        self.sphere_homes.clone_from(&self.world.spheres);
        self.centroid = centroid_of(&self.world.spheres);
        true
    }

    /// Takes sphere `index` (from 0) away. Does nothing for an index that is not there.
    pub fn remove_sphere(&mut self, index: usize) {
        if let Some(slot) = self.world.spheres.get_mut(index) {
            *slot = None;
        }
    }

    /// Puts sphere `index` back where it was drawn.
    pub fn restore_sphere(&mut self, index: usize) {
        if let (Some(slot), Some(home)) = (self.world.spheres.get_mut(index), self.sphere_homes.get(index)) {
            *slot = *home;
        }
    }

    /// Moves sphere `index` by a displacement in F0, in m.
    pub fn move_sphere(&mut self, index: usize, by_m: [f64; 3]) {
        if let Some(Some(centre)) = self.world.spheres.get_mut(index) {
            *centre += Vector3::from(by_m);
        }
    }

    /// Puts an obstacle in the way of the TCP, or takes it away.
    pub fn set_obstacle(&mut self, obstacle: Option<Obstacle>) {
        self.obstacle = obstacle.filter(|o| Vector3::from(o.normal).norm() > 0.0);
    }

    /// Hangs an additional point mass (kg, may be negative down to a light tool)
    /// at the TCP: a payload that nobody declared.
    pub fn set_payload(&mut self, mass_kg: f64) {
        self.payload_kg = mass_kg;
        self.reload();
    }

    /// Freezes encoder `joint` (from 0) at its present value, or frees it.
    pub fn stick_encoder(&mut self, joint: usize, stuck: bool) {
        self.sensors.stick(joint, stuck);
    }

    /// Injects a fault into torque sensor `joint` (from 0), or clears it.
    pub fn fail_torque_sensor(&mut self, joint: usize, fault: Option<TorqueSensorFault>) {
        self.sensors.fail_torque(joint, fault);
    }
}
