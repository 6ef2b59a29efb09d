//! The plant itself: state, one tick, and the truth for tests.

use nalgebra::{SVector, Vector3};
use rand_chacha::ChaCha8Rng;
use spherecal_shared::linalg::Cholesky;
use spherecal_shared::robot::{Arm, Dynamics, Frame, Robot, Tool};

use super::config::PlantConfig;
use super::contact::{Nest, Touch, TouchKind, Touches};
use super::coupling::Coupling;
use super::disturb::Obstacle;
use super::error::PlantError;
use super::integrate::{Elastic, Joints, Load, Motion, STOP_MARGIN_RAD};
use super::sensors::{Sensed, Sensors, TICK_S};
use super::world::{MAX_SPHERES, Stream, World, stream};
use spherecal_model::TrackerSession;

/// The simulated arm with its nest, spheres, sensors and tracker.
#[derive(Clone, Debug)]
pub struct Plant<const N: usize> {
    pub(super) config: PlantConfig,
    pub(super) world: World<N>,
    pub(super) sphere_homes: heapless::Vec<Option<Vector3<f64>>, MAX_SPHERES>,
    pub(super) nest: Nest,
    pub(super) joints: Joints<N>,
    pub(super) motion: Motion<N>,
    pub(super) sensors: Sensors<N>,
    limits: [f64; N],
    substeps: u32,
    free_steps: u32,
    settle_share: f64,
    tick: u64,
    last_tau: SVector<f64, N>,
    last: Sensed<N>,
    /// Mean transmitted torque of the last tick, in N m.
    transmitted: SVector<f64, N>,
    /// The torque that the joints' deflection has followed so far, in N m.
    deflecting: [f64; N],
    /// Motor minus encoder angles, in rad.
    lead: [f64; N],
    /// Displacement of the TCP by bending, and of the seated centre, in m.
    pub(super) bend: Vector3<f64>,
    seat: Vector3<f64>,
    coupling: Coupling,
    pub(super) centroid: Vector3<f64>,
    pub(super) hand_force: Vector3<f64>,
    pub(super) hand_moment: Vector3<f64>,
    pub(super) disturbance: SVector<f64, N>,
    pub(super) magnet_on: bool,
    pub(super) obstacle: Option<Obstacle>,
    /// Spheres that were taken away come back once the nest is clear of their places.
    pub(super) spheres_return: bool,
    /// A sphere that is being shoved aside (from 0), and how far still, in m, F0.
    pub(super) shoved: Option<(usize, Vector3<f64>)>,
    pub(super) payload_kg: f64,
    pub(super) session: TrackerSession,
    pub(super) tracker_rng: ChaCha8Rng,
}

/// Centroid of the sphere centres that are there, over the number of all.
pub(super) fn centroid_of(spheres: &[Option<Vector3<f64>>]) -> Vector3<f64> {
    let sum: Vector3<f64> = spheres.iter().flatten().sum();
    sum / spheres.len().max(1) as f64
}

impl<const N: usize> Plant<N> {
    /// A plant at rest with its encoders at `q` (rad), drawn around the nominal
    /// robot and tool.
    ///
    /// # Errors
    /// A robot, tool or configuration that is refused, or a robot without mass.
    pub fn new(nominal: &Robot, nominal_tool: &Tool, config: &PlantConfig, q: &[f64; N]) -> Result<Self, PlantError> {
        let world = World::draw(nominal, nominal_tool, config)?;
        let link = world.link_angles_at_rest(q);
        let bodies = world.arm.bodies(&world.arm.frames(&link));
        let gravity = bodies.gravity();
        let mut mass = bodies.mass_matrix();
        for i in 0..N {
            mass[(i, i)] += world.rotor[i];
        }
        if !link.iter().all(|x| x.is_finite()) || Cholesky::new(&mass).is_none() {
            return Err(PlantError::Massless);
        }
        let limit = |f: fn(&spherecal_shared::robot::Joint) -> f64, i: usize| nominal.joints.get(i).map_or(0.0, f);
        let stops = core::array::from_fn(|i| {
            (
                limit(|j| j.limits.min_rad, i) - STOP_MARGIN_RAD,
                limit(|j| j.limits.max_rad, i) + STOP_MARGIN_RAD,
            )
        });
        let e = &config.elasticity;
        let elastic = e.enabled.then(|| Elastic {
            stiffness: e.stiffness_nm_rad,
            damping: e.damping_nm_s,
            motor: world.rotor.map(|r| r.max(e.least_motor_kg_m2)),
        });
        let mut joints = Joints {
            coulomb: world.coulomb,
            viscous: world.viscous,
            beyond_sensor: config.friction.beyond_sensor,
            rotor: world.rotor,
            elastic,
            stops,
        };
        let mut motion = Motion::at_rest(&link);
        if let Some(elastic) = &joints.elastic {
            motion.motor += gravity / elastic.stiffness;
            joints.rotor = [0.0; N];
        }
        let sensors = Sensors::new(
            &config.sensors,
            stream(config.seed, Stream::Sensors),
            world.torque_bias,
            *q,
        );
        let spheres: heapless::Vec<_, MAX_SPHERES> = world.spheres.clone();
        let centroid = centroid_of(&spheres);
        let settle = config.compliance.settling_s;
        let mut plant = Self {
            nest: Nest::new(&config.nest, &config.plate),
            sphere_homes: spheres,
            joints,
            motion,
            sensors,
            limits: core::array::from_fn(|i| limit(|j| j.limits.torque_nm, i)),
            substeps: (TICK_S / config.substep_s).round() as u32,
            free_steps: (TICK_S / config.free_step_s).round() as u32,
            settle_share: if settle > 0.0 {
                1.0 - libm::exp(-TICK_S / settle)
            } else {
                1.0
            },
            tick: 0,
            last_tau: gravity,
            last: Sensed {
                tick: 0,
                q: *q,
                dq: [0.0; N],
                tau: [0.0; N],
                saturated: false,
                refused: false,
            },
            transmitted: gravity,
            deflecting: gravity.data.0[0],
            lead: core::array::from_fn(|i| world.motor_angles(q)[i] - q[i]),
            bend: Vector3::zeros(),
            seat: Vector3::zeros(),
            coupling: Coupling::new(config),
            centroid,
            hand_force: Vector3::zeros(),
            hand_moment: Vector3::zeros(),
            disturbance: SVector::zeros(),
            magnet_on: true,
            obstacle: None,
            spheres_return: false,
            shoved: None,
            payload_kg: 0.0,
            session: TrackerSession::default(),
            tracker_rng: stream(config.seed, Stream::Tracker),
            config: config.clone(),
            world,
        };
        plant.sense(false, false);
        Ok(plant)
    }

    /// Advances 1 ms with the joint torques `tau` (N m, base to flange) held,
    /// and returns what real hardware then shows.
    ///
    /// Torque beyond a joint's limit is cut to it; a command that is not finite
    /// is refused as a whole and the last good one stays.
    pub fn step(&mut self, tau: &[f64; N]) -> Sensed<N> {
        let refused = !tau.iter().all(|t| t.is_finite());
        let mut saturated = false;
        if !refused {
            for i in 0..N {
                let cut = tau[i].clamp(-self.limits[i], self.limits[i]);
                saturated |= cut != tau[i];
                self.last_tau[i] = cut;
            }
        }
        self.tick += 1;
        self.return_spheres();
        self.shove();
        self.transmitted = self.advance();
        self.sense(saturated, refused);
        self.last
    }

    /// Advances 1 ms with the brakes closed: the joints stop and stay where they
    /// are, and the sensors read what then loads them.
    pub fn step_braked(&mut self) -> Sensed<N> {
        self.motion.brake();
        self.return_spheres();
        self.shove();
        self.last_tau = self
            .world
            .arm
            .bodies(&self.world.arm.frames(&self.motion.q.data.0[0]))
            .gravity();
        self.transmitted = self.last_tau;
        self.tick += 1;
        self.sense(false, false);
        self.last
    }

    /// What the last step, or the start, showed.
    pub fn sensed(&self) -> &Sensed<N> {
        &self.last
    }

    /// One tick of motion; returns the mean torque at the sensors.
    fn advance(&mut self) -> SVector<f64, N> {
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
            tcp.origin += self.bend;
            let mut pulls = [(tcp.origin, self.hand_force); 2];
            let mut pulled = usize::from(self.hand_force != Vector3::zeros());
            self.touches_at(&tcp, nearest.as_ref(), &mut touches);
            if let (Some(sphere), true) = (&nearest, self.magnet_on) {
                let (pole, force, _, _) = self.nest.pull(&tcp, sphere);
                pulls[pulled] = (pole, force);
                pulled += 1;
            }
            let load = Load {
                tau: &self.last_tau,
                extra: &self.disturbance,
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

    /// Whether this tick meets nothing stiff: no contact within reach, no dry
    /// friction, no end stop, no push.
    fn is_smooth(&self, tcp: &Frame<f64>) -> bool {
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
            && (0..N).all(inside)
            && (!self.config.contact || (self.nearest(tcp).is_none() && !self.near_plate(tcp)))
    }

    /// The sphere within reach of the nest, if contact is on.
    pub(super) fn nearest(&self, tcp: &Frame<f64>) -> Option<Vector3<f64>> {
        if !self.config.contact {
            return None;
        }
        let reach = self.nest.range + 0.01;
        let mut nearest = None;
        let mut least = reach * reach;
        for centre in self.world.spheres.iter().flatten() {
            let square = (centre - tcp.origin).norm_squared();
            if square < least {
                least = square;
                nearest = Some(*centre);
            }
        }
        nearest
    }

    /// Whether the nest is low over the plate.
    fn near_plate(&self, tcp: &Frame<f64>) -> bool {
        let plate = &self.world.plate;
        plate.z().dot(&(tcp.origin - plate.origin)) + self.config.plate.surface_below_m
            < self.config.nest.body_radius_m + 0.02
    }

    /// All touches with the nest at `tcp` and a sphere within reach.
    pub(super) fn touches_at(&self, tcp: &Frame<f64>, sphere: Option<&Vector3<f64>>, touches: &mut Touches) {
        touches.clear();
        if let Some(sphere) = sphere {
            self.nest.touch_sphere(tcp, sphere, &self.seat, touches);
        }
        if self.config.contact {
            let below = self.config.plate.surface_below_m;
            self.nest
                .touch_plate(tcp, &self.world.plate, &self.centroid, below, touches);
        }
        if let Some(obstacle) = &self.obstacle {
            let normal = Vector3::from(obstacle.normal).normalize();
            let depth = normal.dot(&(Vector3::from(obstacle.point_m) - tcp.origin));
            if depth > 0.0 {
                // There is room: a sphere and the plate make at most nine touches.
                let _ = touches.push(Touch {
                    point: tcp.origin,
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

    /// The TCP at the given frames; the displacement by bending is renewed.
    fn shifted_tcp(&mut self, frames: &[Frame<f64>; N]) -> Frame<f64> {
        let mut tcp = self.world.arm.tcp_frame(frames);
        if self.world.bends() {
            self.bend = self.world.bending(frames, &tcp.origin);
        }
        tcp.origin += self.bend;
        tcp
    }

    /// Renews what the sensors show.
    fn sense(&mut self, saturated: bool, refused: bool) {
        let motor: [f64; N] = if self.joints.elastic.is_some() {
            self.motion.motor.data.0[0]
        } else {
            core::array::from_fn(|i| {
                self.deflecting[i] += self.settle_share * (self.transmitted[i] - self.deflecting[i]);
                self.motion.q[i] + self.world.deflection(i, self.deflecting[i])
            })
        };
        self.world.follow_encoders(&motor, &mut self.lead);
        let encoder = core::array::from_fn(|i| motor[i] - self.lead[i]);
        self.last = self.sensors.read(self.tick, &encoder, &self.transmitted.data.0[0]);
        self.last.saturated = saturated;
        self.last.refused = refused;
    }

    /// Rebuilds the arm after the payload changed.
    pub(super) fn reload(&mut self) {
        let mut tool = self.world.tool;
        let extra = spherecal_shared::robot::Inertia {
            mass_kg: self.payload_kg,
            com_m: tool.tcp_m,
            inertia_kg_m2: [0.0; 6],
        };
        tool.body = tool.body.combined(&extra);
        // A payload that makes the tool impossible is ignored.
        if let Ok(arm) = Arm::new(&self.world.robot, &tool) {
            self.world.arm = arm;
        }
    }
}
