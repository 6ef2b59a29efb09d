//! External disturbances of the plant, for fault injection and for the simulated hand. They are
//! explicit methods. The controller can see them only through its sensors.

use nalgebra::{SVector, Vector3};

use super::config::DriveConfig;
use super::contact::FlatObstacle;
use super::draw::draw_spheres;
use super::sensors::TorqueSensorFault;
use super::simulation::{Plant, centroid_of};

/// A disturbance of the plant as a value, for code that has the plant only as a drive
/// ([`Plant::suffer`]). Joints from 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Disturbance {
    /// A push at the TCP, in N, F0, until the next one.
    Push([f64; 3]),
    /// The magnet pulls, or does not.
    Magnet(bool),
    /// The sphere next to the TCP is taken away.
    TakeNearestSphere,
    /// Removed spheres return to their drawn positions, each as soon as the nest is clear of it.
    RestoreSpheres,
    /// The sphere nearest to the TCP is displaced, F0, in m, by a push of at most 100 N that waits
    /// until the sphere can move.
    MoveNearestSphere([f64; 3]),
    /// A wall at a distance from the TCP (m), across its motion, or below a TCP at rest, with a
    /// stiffness (N/m).
    ObstacleAhead(f64, f64),
    /// An obstacle, or none.
    Obstacle(Option<FlatObstacle>),
    /// A point mass at the TCP, in kg.
    Payload(f64),
    /// An encoder is frozen, or freed.
    StickEncoder(usize, bool),
    /// A torque sensor's fault, or none.
    Torque(usize, Option<TorqueSensorFault>),
    /// Other delays of the drive.
    Delay(DriveConfig),
}

/// The nest is clear of a sphere's position if it is this far behind it along its own axis, or this
/// far from it on any side, in m. Its body ends 42 mm from its axis.
const CLEAR_BEHIND_M: f64 = 0.025;
const CLEAR_BESIDE_M: f64 = 0.080;
/// Largest force with which a sphere is pushed against the arm, in N.
const SHOVE_N: f64 = 100.0;
/// Largest motion of a pushed sphere in a control period, in m: 0.2 m/s.
const SHOVE_STEP_M: f64 = 2e-4;
/// Slower than this the TCP stands, in m/s.
const STANDS_M_S: f64 = 0.005;

impl<const N: usize> Plant<N> {
    /// Lets one of the disturbances happen.
    pub fn suffer(&mut self, what: &Disturbance) {
        match *what {
            Disturbance::Push(force_n) => self.set_hand_wrench(force_n, [0.0; 3]),
            Disturbance::Magnet(on) => self.set_magnet(on),
            Disturbance::TakeNearestSphere => {
                if let Some(index) = self.nearest_index() {
                    self.remove_sphere(index);
                }
            }
            Disturbance::RestoreSpheres => {
                self.spheres_return = true;
                self.return_spheres();
            }
            Disturbance::MoveNearestSphere(by_m) => {
                let nearest = || self.nearest_index().map(|index| (index, Vector3::zeros()));
                self.shoved = self
                    .shoved
                    .or_else(nearest)
                    .map(|(index, rest)| (index, rest + Vector3::from(by_m)));
            }
            Disturbance::ObstacleAhead(ahead_m, stiffness_n_m) => {
                let (tcp, velocity) = self.tcp_motion();
                let way = if velocity.norm() > STANDS_M_S {
                    velocity.normalize()
                } else {
                    -Vector3::z()
                };
                self.set_obstacle(Some(FlatObstacle {
                    point_m: (tcp + way * ahead_m).into(),
                    normal: (-way).into(),
                    stiffness_n_m,
                }));
            }
            Disturbance::Obstacle(obstacle) => self.set_obstacle(obstacle),
            Disturbance::Payload(kg) => self.set_payload(kg),
            Disturbance::StickEncoder(joint, stuck) => self.stick_encoder(joint, stuck),
            Disturbance::Torque(joint, fault) => self.fail_torque_sensor(joint, fault),
            Disturbance::Delay(delays) => self.set_delays(delays),
        }
    }

    /// TCP (F0, m) and its velocity (m/s).
    fn tcp_motion(&self) -> (Vector3<f64>, Vector3<f64>) {
        let frames = self.world.arm.frames(&self.motion.q.data.0[0]);
        let tcp = self.world.arm.tcp_frame(&frames).position;
        let twist = self.world.arm.jacobian(&frames, &tcp) * self.motion.v;
        (tcp + self.bend, Vector3::new(twist[0], twist[1], twist[2]))
    }

    /// Returns spheres that are due and have room: a sphere cannot appear within steel.
    pub(super) fn return_spheres(&mut self) {
        if !self.spheres_return {
            return;
        }
        let frames = self.world.arm.frames(&self.motion.q.data.0[0]);
        let tool = self.world.arm.tcp_frame(&frames);
        self.spheres_return = false;
        for (slot, home) in self.world.spheres.iter_mut().zip(&self.sphere_homes) {
            let (None, Some(place)) = (&slot, home) else {
                continue;
            };
            let to = place - (tool.position + self.bend);
            if to.dot(&tool.z()) > CLEAR_BEHIND_M || to.norm() > CLEAR_BESIDE_M {
                *slot = *home;
            } else {
                self.spheres_return = true;
            }
        }
    }

    /// Moves a pushed sphere by its remaining displacement, as far as the pads' springs permit it: a step at full speed alone
    /// presses them by more than the push has.
    pub(super) fn shove(&mut self) {
        let Some((index, rest)) = self.shoved else {
            return;
        };
        let room = self.nest.pressed_by(SHOVE_N - self.truth().contact_n.norm());
        if room <= 0.0 {
            return;
        }
        let step = rest * (SHOVE_STEP_M.min(room) / rest.norm()).min(1.0);
        self.move_sphere(index, step.into());
        let rest = rest - step;
        self.shoved = (rest.norm() > f64::EPSILON).then_some((index, rest));
    }

    /// The sphere next to the TCP, from 0.
    fn nearest_index(&self) -> Option<usize> {
        let (tcp, _) = self.tcp_motion();
        let distance = |centre: &Option<Vector3<f64>>| centre.map_or(f64::INFINITY, |c| (c - tcp).norm());
        let nearest = self
            .world
            .spheres
            .iter()
            .enumerate()
            .min_by(|a, b| distance(a.1).total_cmp(&distance(b.1)))?;
        nearest.1.is_some().then_some(nearest.0)
    }

    /// Force (N) and moment (N m) of a hand, a person or an object on the tool, F0 axes, until it
    /// is set again.
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

    /// Moves the plate with its spheres to another of its placements, from 0. Returns whether that
    /// placement exists.
    pub fn move_plate(&mut self, place: u32) -> bool {
        let Some(plate) = self.world.plates.get(place as usize) else {
            return false;
        };
        let mut plate = *plate;
        plate.position += self.drifted;
        self.world.plate = plate;
        self.world.spheres = draw_spheres(&self.config, &plate);
        self.sphere_homes.clone_from(&self.world.spheres);
        self.centroid = centroid_of(&self.world.spheres);
        true
    }

    /// Removes sphere `index` (from 0). Does nothing if it does not exist.
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
    pub fn set_obstacle(&mut self, obstacle: Option<FlatObstacle>) {
        self.obstacle = obstacle.filter(|o| Vector3::from(o.normal).norm() > 0.0);
    }

    /// Adds a point mass at the TCP, an undeclared payload (kg; may be negative down to a light
    /// tool).
    pub fn set_payload(&mut self, mass_kg: f64) {
        self.payload_kg = mass_kg;
        self.reload();
    }

    /// Changes the delays of the drive from now on. Messages in transit keep their old arrival
    /// times.
    pub fn set_delays(&mut self, delays: DriveConfig) {
        self.delays.set(delays);
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
