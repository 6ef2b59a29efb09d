//! The plant itself: state, one tick, and the truth for tests.

use nalgebra::{SVector, Vector3};
use rand_chacha::ChaCha8Rng;
use spherecal_shared::linalg::Cholesky;
use spherecal_shared::robot::{Arm, Dynamics, Robot, Tool};

use super::config::{EncoderSide, PlantConfig};
use super::contact::{FlatObstacle, Nest};
use super::coupling::SeatScatter;
use super::delay::Delays;
use super::error::PlantError;
use super::integrate::{Elastic, JointMechanics, MotionState, STOP_MARGIN_RAD};
use super::joint::SlowState;
use super::random::{Stream, stream};
use super::sensors::{Sensed, Sensors, TICK_S};
use super::study::Standing;
use super::world::{MAX_SPHERES, TrueCell};
use spherecal_model::TrackerSession;

/// The simulated arm with its nest, spheres, sensors and tracker.
#[derive(Clone, Debug)]
pub struct Plant<const N: usize> {
    pub(super) config: PlantConfig,
    pub(super) world: TrueCell<N>,
    pub(super) sphere_homes: heapless::Vec<Option<Vector3<f64>>, MAX_SPHERES>,
    pub(super) nest: Nest,
    pub(super) joints: JointMechanics<N>,
    pub(super) motion: MotionState<N>,
    pub(super) sensors: Sensors<N>,
    limits: [f64; N],
    /// Motor inertia between commanded and measured torque, beyond the nominal robot's, in kg m².
    declared_motors: [f64; N],
    pub(super) substeps: u32,
    pub(super) free_steps: u32,
    settle_share: f64,
    tick: u64,
    pub(super) last_tau: SVector<f64, N>,
    last: Sensed<N>,
    /// Mean transmitted torque of the last tick, in N m.
    transmitted: SVector<f64, N>,
    /// The torque that the joints' deflection has reached so far, in N m.
    deflecting: [f64; N],
    /// Motor minus encoder angles, in rad.
    lead: [f64; N],
    /// The state of the joints that depends on their path, and the link angles (rad) up to which it
    /// is known.
    slow: SlowState<N>,
    traced: [f64; N],
    /// The arm remembers its way.
    remembers: bool,
    pub(super) delays: Delays<N>,
    /// What has reached the controller.
    shown: Sensed<N>,
    /// Shift of the plate by the warm-up so far, in m, F0.
    pub(super) drifted: Vector3<f64>,
    /// Displacement of the TCP by bending, and of the seated centre, in m.
    pub(super) bend: Vector3<f64>,
    pub(super) seat: Vector3<f64>,
    pub(super) coupling: SeatScatter,
    pub(super) centroid: Vector3<f64>,
    pub(super) hand_force: Vector3<f64>,
    pub(super) hand_moment: Vector3<f64>,
    pub(super) disturbance: SVector<f64, N>,
    pub(super) magnet_on: bool,
    pub(super) obstacle: Option<FlatObstacle>,
    /// Whether removed spheres return once the nest is clear of them.
    pub(super) spheres_return: bool,
    /// A sphere that is being pushed aside (from 0), and its remaining displacement, in m, F0.
    pub(super) shoved: Option<(usize, Vector3<f64>)>,
    pub(super) payload_kg: f64,
    pub(super) session: TrackerSession,
    /// The arm as the tracker sees it, from its first shot on.
    pub(super) standing: Option<Standing<N>>,
    pub(super) tracker_rng: ChaCha8Rng,
}

/// Ticks from one step of the warm-up to the next.
const WARM_TICKS: u64 = 1000;

/// Sum of the present sphere centres, divided by the number of all spheres.
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
        let world = TrueCell::draw(nominal, nominal_tool, config)?;
        let slow = world.slow(config.seed, Stream::Scatter);
        let link = world.link_angles(&world.arm, q, Some(&slow));
        let bodies = world.arm.bodies(&world.arm.frames(&link));
        let gravity = bodies.gravity() - world.cable.torque(&SVector::from(link));
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
            stiffness: world.compliance.map(|c| 1.0 / c),
            damping: world.gear.map(|size| size * e.damping_nm_s),
            motor: core::array::from_fn(|i| world.rotor[i].max(world.gear[i] * e.least_motor_kg_m2)),
        });
        let mut joints = JointMechanics {
            coulomb: world.coulomb,
            viscous: world.viscous,
            beyond_sensor: config.friction.beyond_sensor,
            rotor: world.rotor,
            elastic,
            stops,
        };
        let declared_motors = core::array::from_fn(|i| {
            let known = limit(|j| j.rotor_kg_m2, i);
            let least = if joints.elastic.is_some() {
                world.gear[i] * e.least_motor_kg_m2
            } else {
                0.0
            };
            (known + world.gear[i] * config.inertia.visible(i)).max(least) - known
        });
        let mut motion = MotionState::at_rest(&link);
        if let Some(elastic) = &joints.elastic {
            for i in 0..N {
                motion.motor[i] += gravity[i] / elastic.stiffness[i];
            }
            joints.rotor = [0.0; N];
        }
        let sensors = Sensors::new(
            &config.sensors,
            stream(config.seed, Stream::Sensors),
            world.torque_bias,
            core::array::from_fn(|i| config.disturbance.torque_play_share * limit(|j| j.limits.torque_nm, i)),
            *q,
        );
        let spheres: heapless::Vec<_, MAX_SPHERES> = world.spheres.clone();
        let centroid = centroid_of(&spheres);
        let settle = config.compliance.settling_s;
        let before = Sensed {
            tick: 0,
            q: *q,
            dq: [0.0; N],
            tau: [0.0; N],
            saturated: false,
            refused: false,
        };
        let mut plant = Self {
            nest: Nest::new(&config.nest, config.cell.plate.sphere_radius_m),
            sphere_homes: spheres,
            joints,
            motion,
            declared_motors,
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
            last: before,
            transmitted: gravity,
            deflecting: gravity.data.0[0],
            lead: core::array::from_fn(|i| world.motor_angles(q)[i] - q[i]),
            slow,
            traced: link,
            remembers: world.memory.iter().any(|m| !m.is_off()),
            delays: Delays::new(config.drive, stream(config.seed, Stream::Delay), gravity),
            shown: before,
            drifted: Vector3::zeros(),
            bend: Vector3::zeros(),
            seat: Vector3::zeros(),
            coupling: SeatScatter::new(config),
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
            standing: None,
            tracker_rng: stream(config.seed, Stream::Tracker),
            config: config.clone(),
            world,
        };
        plant.sense(false, false);
        plant.shown = plant.last;
        Ok(plant)
    }

    /// Advances 1 ms with constant joint torques `tau` (N m, base to flange), and returns what real
    /// hardware then shows.
    ///
    /// Torque beyond a joint's limit is cut to it. A command that is not finite is refused as a
    /// whole and the last good one stays.
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
        self.warm();
        let command = self.last_tau;
        if self.delays.is_off() {
            self.delays.pass(&command);
            self.transmitted = self.advance();
            self.sense(saturated, refused);
            self.shown = self.last;
        } else {
            self.last_tau = self.delays.command(&command);
            self.transmitted = self.advance();
            self.last_tau = command;
            self.sense(saturated, refused);
            self.shown = self.delays.state(&self.last, &self.shown);
        }
        self.shown
    }

    /// Advances 1 ms with the brakes closed: the joints stop and stay, and the sensors read their
    /// load.
    pub fn step_braked(&mut self) -> Sensed<N> {
        self.motion.brake();
        self.return_spheres();
        self.shove();
        self.last_tau = self
            .world
            .arm
            .bodies(&self.world.arm.frames(&self.motion.q.data.0[0]))
            .gravity()
            - self.world.cable.torque(&self.motion.q);
        self.transmitted = self.last_tau;
        self.tick += 1;
        self.warm();
        self.delays.brake(&self.last_tau);
        self.sense(false, false);
        self.shown = if self.delays.is_off() {
            self.last
        } else {
            self.delays.state(&self.last, &self.shown)
        };
        self.shown
    }

    /// What the drive's data sheet says of the motors, base to flange: the inertia that lies between
    /// commanded and measured torque, seen at the joint, in kg m².
    pub fn declared_motors(&self) -> &[f64; N] {
        &self.declared_motors
    }

    /// Delay of states and commands together that the drive declares, in s: without steps, and with half of the jitter of
    /// each, unless the configuration says another.
    pub fn latency_s(&self) -> f64 {
        let drive = &self.config.drive;
        let own = drive.state_delay_s + drive.command_delay_s + drive.jitter_s;
        drive.declared_s.unwrap_or(own)
    }

    /// What the last step, or the start, showed.
    pub fn sensed(&self) -> &Sensed<N> {
        &self.shown
    }

    /// Time since the start of the run, in s.
    pub(super) fn time_s(&self) -> f64 {
        self.tick as f64 * TICK_S
    }

    /// Lets links and plate drift, once a second.
    fn warm(&mut self) {
        if !self.world.warming.is_on() || !self.tick.is_multiple_of(WARM_TICKS) {
            return;
        }
        self.reload();
        let drift = self.world.warming.plate(self.time_s());
        let step = drift - self.drifted;
        self.drifted = drift;
        self.world.plate.position += step;
        self.centroid += step;
        for centre in self.world.spheres.iter_mut().chain(&mut self.sphere_homes).flatten() {
            *centre += step;
        }
    }

    /// Renews what the sensors show.
    fn sense(&mut self, saturated: bool, refused: bool) {
        let mut motor: [f64; N] = core::array::from_fn(|i| {
            self.deflecting[i] += self.settle_share * (self.transmitted[i] - self.deflecting[i]);
            if self.joints.elastic.is_none() || self.world.side == EncoderSide::Link {
                self.motion.q[i] + self.world.deflection(i, self.deflecting[i])
            } else {
                self.motion.motor[i] + self.world.deflections[i].nonlinear(self.deflecting[i])
            }
        });
        if self.remembers {
            let link: [f64; N] = self.motion.q.data.0[0];
            let by = core::array::from_fn(|i| link[i] - self.traced[i]);
            self.traced = link;
            self.slow.moved(&self.world.memory, &by);
            for i in 0..N {
                motor[i] += self.world.slow_lead(i, &self.slow);
            }
        }
        self.world.follow_encoders(&motor, &mut self.lead);
        let encoder = core::array::from_fn(|i| motor[i] - self.lead[i]);
        self.last = self.sensors.read(self.tick, &encoder, &self.transmitted.data.0[0]);
        self.last.saturated = saturated;
        self.last.refused = refused;
    }

    /// Rebuilds the arm after the payload changed or the links grew.
    pub(super) fn reload(&mut self) {
        let mut tool = self.world.tool;
        let extra = spherecal_shared::robot::Inertia {
            mass_kg: self.payload_kg,
            com_m: tool.tcp_m,
            inertia_kg_m2: [0.0; 6],
        };
        tool.body = tool.body.combined(&extra);
        let robot = if self.world.warming.is_on() {
            &self.world.warming.robot(&self.world.robot, self.time_s())
        } else {
            &self.world.robot
        };
        // A payload that makes the tool impossible is ignored.
        if let Ok(arm) = Arm::new(robot, &tool) {
            self.world.arm = arm;
        }
    }
}
