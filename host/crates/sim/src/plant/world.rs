//! The truth of one plant: what the seed drew. Nothing here reaches the
//! controller, the campaign or the identification.
//!
//! Each error source has a random stream of its own, so that switching one off
//! leaves the others as they were.

use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use spherecal_shared::robot::{Arm, Dynamics, Frame, Robot, Tool};

use super::config::PlantConfig;
use super::draw::{draw_geometry, draw_joint_errors, draw_masses, draw_plates, draw_spheres};
use super::error::PlantError;

/// Most spheres of a plate.
pub const MAX_SPHERES: usize = 8;

/// Random streams of the error sources.
#[derive(Clone, Copy)]
pub(super) enum Stream {
    Geometry = 1,
    Tool,
    Compliance,
    Encoder,
    Friction,
    Inertia,
    Certificate,
    Placement,
    Bias,
    Seating,
    Sensors,
    Tracker,
    Sessions,
    Workspace,
    Hand,
}

/// The generator of one stream of a seed.
pub(super) fn stream(seed: u64, which: Stream) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(which as u64);
    rng
}

/// A standard normal number.
pub(super) fn normal(rng: &mut ChaCha8Rng) -> f64 {
    rng.sample(StandardNormal)
}

/// A vector of three standard normal numbers.
pub(super) fn normal3(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::new(normal(rng), normal(rng), normal(rng))
}

/// Uniform between two bounds, equal ones allowed.
pub(super) fn between(rng: &mut ChaCha8Rng, [low, high]: [f64; 2]) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

/// `amplitude sin(order angle + phase)`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tone {
    pub(super) order: f64,
    pub(super) amplitude: f64,
    pub(super) phase: f64,
}

/// What one joint's encoder hides: a function of the encoder's angle.
#[derive(Clone, Debug, Default)]
pub(super) struct JointError {
    /// Cosine and sine coefficients of orders 1, 2, ..., in rad.
    pub(super) harmonics: Vec<[f64; 2]>,
    /// Gear and smooth errors.
    pub(super) tones: Vec<Tone>,
    /// Dependence on the next joint's angle.
    pub(super) cross: Vec<Tone>,
}

impl JointError {
    /// Error (rad) and its slope at the encoder angle `e`, with the neighbour's angle.
    pub(super) fn at(&self, e: f64, neighbour: f64) -> (f64, f64) {
        let (mut value, mut slope) = (0.0, 0.0);
        if !self.harmonics.is_empty() {
            let (s1, c1) = libm::sincos(e);
            let (mut s, mut c) = (s1, c1);
            for (k, [cosine, sine]) in self.harmonics.iter().enumerate() {
                value += cosine * c + sine * s;
                slope += (k + 1) as f64 * (sine * c - cosine * s);
                (s, c) = (s * c1 + c * s1, c * c1 - s * s1);
            }
        }
        for tone in &self.tones {
            let (s, c) = libm::sincos(tone.order * e + tone.phase);
            value += tone.amplitude * s;
            slope += tone.amplitude * tone.order * c;
        }
        for tone in &self.cross {
            value += tone.amplitude * libm::sin(tone.order * neighbour + tone.phase);
        }
        (value, slope)
    }
}

/// Everything that was drawn.
#[derive(Clone, Debug)]
pub struct World<const N: usize> {
    /// The true arm with its true tool.
    pub arm: Arm<f64, N>,
    /// The true description behind [`Self::arm`].
    pub robot: Robot,
    /// The true tool.
    pub tool: Tool,
    /// True plate pose in F0.
    pub plate: Frame<f64>,
    /// True sphere centres in F0, in m; `None` for a sphere that was taken away.
    pub spheres: heapless::Vec<Option<Vector3<f64>>, MAX_SPHERES>,
    /// Joint compliance, in rad/(N m).
    pub compliance: [f64; N],
    /// Dry friction, in N m.
    pub coulomb: [f64; N],
    /// Viscous friction, in N m s/rad.
    pub viscous: [f64; N],
    /// Rotor inertia that shows at the link, in kg m².
    pub rotor: [f64; N],
    /// Bias of the torque sensors, in N m.
    pub torque_bias: [f64; N],
    /// The same in each of its placements.
    pub(super) plates: Vec<Frame<f64>>,
    pub(super) errors: [JointError; N],
    quadratic: f64,
    hysteresis: f64,
    link_bending: f64,
    base_bending: f64,
}

impl<const N: usize> World<N> {
    /// Draws a world around the nominal robot.
    ///
    /// # Errors
    /// A configuration or robot that is refused.
    pub fn draw(nominal: &Robot, nominal_tool: &Tool, config: &PlantConfig) -> Result<Self, PlantError> {
        config.check()?;
        // Refuses a bad nominal robot, or one of another number of joints, before anything is drawn.
        Arm::<f64, N>::new(nominal, nominal_tool)?;
        let seed = config.seed;
        let mut robot = draw_geometry::<N>(nominal, nominal_tool, config)?;
        let mut tool = *nominal_tool;
        if config.tool.enabled {
            let mut rng = stream(seed, Stream::Tool);
            for coordinate in &mut tool.tcp_m {
                *coordinate += config.tool.tcp_sigma_m * normal(&mut rng);
            }
        }
        draw_masses(&mut robot, &mut tool, config);
        let rotor = core::array::from_fn(|i| {
            let visible = if config.inertia.rotors && i < config.inertia.rotor_kg_m2.len() {
                config.inertia.rotor_kg_m2[i] * config.inertia.rotor_share
            } else {
                0.0
            };
            nominal.joints.get(i).map_or(0.0, |j| j.rotor_kg_m2) + visible
        });
        let arm = Arm::new(&robot, &tool)?;
        let plates = draw_plates(config);
        let plate = plates.first().copied().unwrap_or_else(Frame::identity);
        let c = &config.compliance;
        let switch = |value: f64| if c.enabled { value } else { 0.0 };
        let mut rng = stream(seed, Stream::Compliance);
        let compliance = core::array::from_fn(|_| {
            let factor = between(&mut rng, [1.0 - c.spread, 1.0 + c.spread]);
            // As a state, elasticity takes the place of the quasi-static deflection.
            if config.elasticity.enabled {
                0.0
            } else {
                switch(c.joint_rad_per_nm * factor)
            }
        });
        let f = &config.friction;
        let mut rng = stream(seed, Stream::Friction);
        let on = if f.enabled { 1.0 } else { 0.0 };
        let coulomb = core::array::from_fn(|_| on * between(&mut rng, f.coulomb_nm));
        let viscous = core::array::from_fn(|_| on * between(&mut rng, f.viscous_nm_s));
        let mut rng = stream(seed, Stream::Bias);
        let torque_bias = core::array::from_fn(|i| {
            let range = robot.joints.get(i).map_or(0.0, |j| j.limits.torque_nm);
            config.sensors.torque_bias_share * range * normal(&mut rng)
        });
        Ok(Self {
            arm,
            tool,
            spheres: draw_spheres(config, &plate),
            plate,
            plates,
            compliance,
            coulomb,
            viscous,
            rotor,
            torque_bias,
            errors: draw_joint_errors(config),
            quadratic: switch(c.quadratic_rad_per_nm2),
            hysteresis: switch(c.hysteresis_rad),
            link_bending: switch(c.link_rad_per_nm),
            base_bending: switch(c.base_rad_per_nm),
            robot,
        })
    }

    /// Deflection of joint `i` under a transmitted torque, in rad: motor side minus
    /// link (a torque that lifts the link winds the joint up, and the link lags).
    #[inline]
    pub fn deflection(&self, i: usize, torque: f64) -> f64 {
        let mut angle = self.compliance[i] * torque;
        if self.quadratic != 0.0 {
            angle += self.quadratic * torque * torque.abs();
        }
        if self.hysteresis != 0.0 {
            angle += self.hysteresis * libm::tanh(torque / 0.5);
        }
        angle
    }

    /// Encoder angles that belong to motor-side angles (link plus deflection).
    pub fn encoder_angles(&self, motor: &[f64; N]) -> [f64; N] {
        let mut lead = [0.0; N];
        for _ in 0..3 {
            self.follow_encoders(motor, &mut lead);
        }
        core::array::from_fn(|i| motor[i] - lead[i])
    }

    /// One Newton step for each joint's error `lead` (motor minus encoder, in
    /// rad); from the last tick's it is exact to far below an encoder's step.
    pub(super) fn follow_encoders(&self, motor: &[f64; N], lead: &mut [f64; N]) {
        for i in 0..N {
            let (value, slope) = self.errors[i].at(motor[i] - lead[i], motor[(i + 1) % N]);
            lead[i] += (value - lead[i]) / (1.0 + slope);
        }
    }

    /// Motor-side angles that belong to encoder angles.
    pub fn motor_angles(&self, encoder: &[f64; N]) -> [f64; N] {
        let mut motor = *encoder;
        // The neighbour's angle is the motor's; one repetition settles it.
        for _ in 0..3 {
            let before = motor;
            motor = core::array::from_fn(|i| {
                let (value, _) = self.errors[i].at(encoder[i], before[(i + 1) % N]);
                encoder[i] + value
            });
        }
        motor
    }

    /// Link angles of an arm at rest in free space whose encoders read `encoder`.
    pub fn link_angles_at_rest(&self, encoder: &[f64; N]) -> [f64; N] {
        let motor = self.motor_angles(encoder);
        let mut link = motor;
        for _ in 0..4 {
            let gravity = self.arm.bodies(&self.arm.frames(&link)).gravity();
            link = core::array::from_fn(|i| motor[i] - self.deflection(i, gravity[i]));
        }
        link
    }

    /// Whether links or base bend.
    pub(super) fn bends(&self) -> bool {
        self.link_bending != 0.0 || self.base_bending != 0.0
    }

    /// Displacement of the point `p` (m, F0) by bending of links and base under
    /// the weight of all that they carry, in m.
    pub(super) fn bending(&self, frames: &[Frame<f64>; N], p: &Vector3<f64>) -> Vector3<f64> {
        let mut shift = Vector3::zeros();
        let (mut mass, mut moment) = (0.0, Vector3::zeros());
        let weight = |mass: f64, moment: &Vector3<f64>, about: &Vector3<f64>| {
            let down = Vector3::new(0.0, 0.0, -spherecal_shared::robot::GRAVITY_M_S2);
            (moment - about * mass).cross(&down)
        };
        for (i, joint) in self.robot.joints.iter().enumerate().take(N).rev() {
            let body = if i + 1 == N {
                joint.link.combined(&self.tool.body)
            } else {
                joint.link
            };
            mass += body.mass_kg;
            moment += frames[i].point(&body.com()) * body.mass_kg;
            let origin = frames[i].origin;
            let z = frames[i].z();
            let about = weight(mass, &moment, &origin);
            let across = about - z * z.dot(&about);
            shift += (across * self.link_bending).cross(&(p - origin));
        }
        let base = weight(mass, &moment, &Vector3::zeros());
        let tilt = Vector3::new(base.x, base.y, 0.0) * self.base_bending;
        shift + tilt.cross(p)
    }

    /// True TCP in F0 at true link angles, bending included.
    pub fn tcp(&self, link: &[f64; N]) -> Frame<f64> {
        let frames = self.arm.frames(link);
        let mut tcp = self.arm.tcp_frame(&frames);
        if self.bends() {
            tcp.origin += self.bending(&frames, &tcp.origin);
        }
        tcp
    }
}

/// Rotation by roll, pitch and yaw about fixed axes, in rad.
pub(super) fn rpy([roll, pitch, yaw]: [f64; 3]) -> Matrix3<f64> {
    Rotation3::from_euler_angles(roll, pitch, yaw).into_inner()
}
