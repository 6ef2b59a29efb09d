//! The static truth of one cell, as drawn from the seed. The dynamic plant and the static worlds
//! both use it. It never reaches the controller, the campaign or the identification.
//!
//! Each error source has its own random stream, so switching one off does not change the others.
//!
//! From an encoder's angle `e` to the link's, joint by joint (module `joint`):
//!
//! ```text
//!   gear = e + h(e, other) + scatter          harmonics, gear, smooth and cross-joint errors
//!   link = gear − deflection(τ) − lost         τ: torque transmitted to the link
//! ```
//!
//! The TCP follows from the links by the true geometry, which grows as the cell warms up, and is
//! displaced by the bending of links and base.

use nalgebra::Vector3;
pub use spherecal_model::MAX_SPHERES;
use spherecal_shared::robot::{Arm, Dynamics, Pose, Robot, Tool};

use super::cable::Cable;
use super::config::{EncoderSide, PlantConfig};
use super::draw::{
    anywhere, draw_bending, draw_compliance, draw_geometry, draw_joint_errors, draw_joint_functions, draw_masses,
    draw_memory, draw_offsets, draw_plates, draw_spheres,
};
use super::error::PlantError;
use super::joint::{Deflection, JointError, PathMemory, SlowState};
use super::random::{Stream, between, normal, stream};
use super::thermal::Warming;

/// Largest torque limit of the arms on which compliance, damping and rotors were measured, in N m: the iiwa 7. (A Franka has 87.)
const MEASURED_NM: f64 = 176.0;

/// Size of the gear of a joint with this torque limit (N m): a larger gear is stiffer, more damped and has a heavier motor in
/// proportion. For stiffness it follows from similar shapes: torque and stiffness both grow with the third power of the diameter. For
/// damping and motor it is assumed, so that a joint rings as long, and as fast about links that are as much heavier.
pub(super) fn gear_size(torque_nm: f64) -> f64 {
    (torque_nm / MEASURED_NM).max(1.0)
}

/// All draws of one cell: the true arm, tool, plate and spheres.
#[derive(Clone, Debug)]
pub struct TrueCell<const N: usize> {
    /// The true arm with its true tool.
    pub arm: Arm<f64, N>,
    /// The true description behind [`Self::arm`].
    pub robot: Robot,
    /// The true tool.
    pub tool: Tool,
    /// True plate pose in F0.
    pub plate: Pose<f64>,
    /// True sphere centres in F0, in m; `None` for a sphere that was taken away.
    pub spheres: heapless::Vec<Option<Vector3<f64>>, MAX_SPHERES>,
    /// Joint compliance, in rad/(N m), whether it is quasi-static or a state.
    pub compliance: [f64; N],
    /// Dry friction, in N m.
    pub coulomb: [f64; N],
    /// Viscous friction, in N m s/rad.
    pub viscous: [f64; N],
    /// Size of each joint's gear, as a multiple of that of a joint of 176 N m; at least 1. See [`gear_size`].
    pub(super) gear: [f64; N],
    /// Rotor inertia that shows at the link, in kg m².
    pub rotor: [f64; N],
    /// Bias of the torque sensors, in N m.
    pub torque_bias: [f64; N],
    pub(super) cable: Cable<N>,
    /// True plate pose in F0 in each of its placements.
    pub(super) plates: Vec<Pose<f64>>,
    pub(super) errors: [JointError; N],
    pub(super) deflections: [Deflection; N],
    pub(super) memory: [PathMemory; N],
    pub(super) warming: Warming,
    pub(super) side: EncoderSide,
    /// Bending of each link about x and y of its joint's frame, in rad/(N m).
    pub(super) bending: [[f64; 2]; N],
    /// Tilt of the base about x and y of F0, in rad/(N m).
    pub(super) tilt: [f64; 2],
    /// Factor on the drawn geometry.
    pub geometry_scale: f64,
}

impl<const N: usize> TrueCell<N> {
    /// Draws a cell around the nominal robot. `geometry.overall_mean_m` applies to 500
    /// configurations in joint space.
    ///
    /// # Errors
    /// A configuration or robot that is refused.
    pub fn draw(nominal: &Robot, nominal_tool: &Tool, config: &PlantConfig) -> Result<Self, PlantError> {
        Self::draw_on(nominal, nominal_tool, config, &[])
    }

    /// Like [`Self::draw`], with the configurations (rad) to which `geometry.overall_mean_m`
    /// applies.
    ///
    /// # Errors
    /// A configuration or robot that is refused.
    pub fn draw_on(
        nominal: &Robot,
        nominal_tool: &Tool,
        config: &PlantConfig,
        reference: &[[f64; N]],
    ) -> Result<Self, PlantError> {
        config.check()?;
        // Refuses a bad nominal robot, or one of another number of joints, before anything is drawn.
        Arm::<f64, N>::new(nominal, nominal_tool)?;
        let seed = config.seed;
        let (mut robot, geometry_scale) = draw_geometry::<N>(nominal, nominal_tool, config)?;
        draw_offsets(&mut robot, config);
        let mut tool = *nominal_tool;
        if config.tool.enabled {
            let mut rng = stream(seed, Stream::Tool);
            for coordinate in &mut tool.tcp_m {
                *coordinate += config.tool.tcp_sigma_m * normal(&mut rng);
            }
        }
        draw_masses(&mut robot, &mut tool, config);
        let gear = core::array::from_fn(|i| nominal.joints.get(i).map_or(1.0, |j| gear_size(j.limits.torque_nm)));
        let mut rng = stream(seed, Stream::Rotors);
        let rotor = core::array::from_fn(|i| {
            let error = 1.0 + config.inertia.rotor_sigma * normal(&mut rng);
            nominal.joints.get(i).map_or(0.0, |j| j.rotor_kg_m2) + gear[i] * config.inertia.visible(i) * error.max(0.0)
        });
        let arm = Arm::new(&robot, &tool)?;
        let plates = draw_plates(config);
        let plate = plates.first().copied().unwrap_or_else(Pose::identity);
        let compliance = draw_compliance(config, &gear);
        let c = &config.compliance;
        let switch = |value: f64| if c.enabled { value } else { 0.0 };
        let deflections = core::array::from_fn(|i| {
            let limit = nominal.joints.get(i).map_or(0.0, |j| j.limits.torque_nm);
            let share = if limit > 0.0 {
                c.quadratic_share * compliance[i] / limit
            } else {
                0.0
            };
            Deflection {
                compliance: compliance[i],
                quadratic: switch(c.quadratic_rad_per_nm2 + share),
                hysteresis: switch(c.hysteresis_rad),
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
            let own = config.disturbance.torque_bias_nm.get(i).copied().unwrap_or(0.0);
            config.sensors.torque_bias_share * range * normal(&mut rng) + own
        });
        let (bending, tilt) = draw_bending(config);
        let mut errors = draw_joint_errors(config);
        draw_joint_functions(config, &mut errors);
        let mut cell = Self {
            arm,
            tool,
            spheres: draw_spheres(config, &plate),
            plate,
            plates,
            compliance,
            coulomb,
            viscous,
            gear,
            rotor,
            torque_bias,
            cable: Cable::draw(config),
            errors,
            deflections,
            memory: draw_memory(config),
            warming: Warming::draw(&robot, config),
            side: config.encoder.side,
            bending,
            tilt,
            geometry_scale,
            robot,
        };
        if config.geometry.enabled && config.geometry.overall_mean_m > 0.0 {
            scale_to_overall_mean(&mut cell, nominal, config.geometry.overall_mean_m, reference)?;
        }
        Ok(cell)
    }

    /// The slow state of the joints at the start of a run.
    pub(super) fn slow(&self, seed: u64, which: Stream) -> SlowState<N> {
        SlowState::new(seed, &self.memory, which)
    }

    /// Deflection of joint `i` under a transmitted torque, in rad: what the encoder sees of the gear's lead over
    /// the link (a torque that lifts the link winds the joint up, and the link lags). Zero for an encoder on the link.
    #[inline]
    pub fn deflection(&self, i: usize, torque: f64) -> f64 {
        match self.side {
            EncoderSide::Motor => self.deflections[i].at(torque),
            EncoderSide::Link => 0.0,
        }
    }

    /// Lost motion less scatter of joint `i` as the encoder sees them, in rad.
    #[inline]
    pub(super) fn slow_lead(&self, i: usize, slow: &SlowState<N>) -> f64 {
        match self.side {
            EncoderSide::Motor => slow.lead(i),
            EncoderSide::Link => -slow.traces[i].scatter,
        }
    }

    /// Encoder angles for motor-side angles (link plus deflection).
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
            let (value, slope) = self.errors[i].at(motor[i] - lead[i], motor[self.errors[i].other]);
            lead[i] += (value - lead[i]) / (1.0 + slope);
        }
    }

    /// Motor-side angles that belong to encoder angles.
    pub fn motor_angles(&self, encoder: &[f64; N]) -> [f64; N] {
        let mut motor = *encoder;
        // The other joint's angle is the motor's; one repetition settles it.
        for _ in 0..3 {
            let before = motor;
            motor = core::array::from_fn(|i| {
                let (value, _) = self.errors[i].at(encoder[i], before[self.errors[i].other]);
                encoder[i] + value
            });
        }
        motor
    }

    /// Link angles of an arm at rest in free space whose encoders read `encoder`, without
    /// path-dependent effects.
    pub fn link_angles_at_rest(&self, encoder: &[f64; N]) -> [f64; N] {
        self.link_angles(&self.arm, encoder, None)
    }

    /// Like [`Self::link_angles_at_rest`], with the present geometry `arm` and the path-dependent
    /// state of the joints.
    pub(super) fn link_angles(&self, arm: &Arm<f64, N>, encoder: &[f64; N], slow: Option<&SlowState<N>>) -> [f64; N] {
        let mut motor = self.motor_angles(encoder);
        if let Some(slow) = slow {
            for i in 0..N {
                motor[i] -= self.slow_lead(i, slow);
            }
        }
        let mut link = motor;
        for _ in 0..4 {
            let gravity = arm.bodies(&arm.frames(&link)).gravity();
            link = core::array::from_fn(|i| motor[i] - self.deflection(i, gravity[i]));
        }
        link
    }

    /// Whether links or base bend.
    pub(super) fn bends(&self) -> bool {
        self.tilt != [0.0; 2] || self.bending.iter().any(|b| *b != [0.0; 2])
    }

    /// Displacement of the point `p` (m, F0) by bending of links and base under the weight that
    /// they carry, in m.
    ///
    pub(super) fn bending(&self, frames: &[Pose<f64>; N], p: &Vector3<f64>) -> Vector3<f64> {
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
            let origin = frames[i].position;
            let local = frames[i].rotation.tr_mul(&weight(mass, &moment, &origin));
            let [x, y] = self.bending[i];
            let turn = frames[i].rotation * Vector3::new(x * local.x, y * local.y, 0.0);
            shift += turn.cross(&(p - origin));
        }
        let base = weight(mass, &moment, &Vector3::zeros());
        let tilt = Vector3::new(self.tilt[0] * base.x, self.tilt[1] * base.y, 0.0);
        shift + tilt.cross(p)
    }

    /// True TCP in F0 at true link angles, bending included, at the start of the run.
    pub fn tcp(&self, link: &[f64; N]) -> Pose<f64> {
        self.tcp_of(&self.arm, link)
    }

    /// The same with the geometry `arm` of the moment.
    pub(super) fn tcp_of(&self, arm: &Arm<f64, N>, link: &[f64; N]) -> Pose<f64> {
        let frames = arm.frames(link);
        let mut tcp = arm.tcp_frame(&frames);
        if self.bends() {
            tcp.position += self.bending(&frames, &tcp.position);
        }
        tcp
    }
}

/// `nominal` plus `factor` times the deviations of `drawn` in the table of joints 2..n.
fn scaled_deviations(nominal: &Robot, drawn: &Robot, factor: f64) -> Robot {
    let mut robot = drawn.clone();
    for (joint, other) in robot.joints.iter_mut().zip(&nominal.joints).skip(1) {
        let (m, n) = (&mut joint.mdh, &other.mdh);
        m.alpha = n.alpha + factor * (m.alpha - n.alpha);
        m.a = n.a + factor * (m.a - n.a);
        m.theta = n.theta + factor * (m.theta - n.theta);
        m.d = n.d + factor * (m.d - n.d);
    }
    robot
}

/// Rescales the geometry of a cell until the mean error of the nominal robot with the true tool is
/// `mean_m` on `reference` (encoder angles, rad; if empty, the 500 configurations of
/// [`mean_difference`]).
fn scale_to_overall_mean<const N: usize>(
    cell: &mut TrueCell<N>,
    nominal: &Robot,
    mean_m: f64,
    reference: &[[f64; N]],
) -> Result<(), PlantError> {
    let own;
    let configurations = if reference.is_empty() {
        own = anywhere::<N>(nominal).collect::<Vec<_>>();
        &own
    } else {
        reference
    };
    let drawn = cell.robot.clone();
    let ideal = Arm::<f64, N>::new(nominal, &cell.tool)?;
    // The mean error grows with the factor: bisection to about a nanometre.
    let (mut low, mut high) = (0.0, 8.0);
    for step in 0..31 {
        let factor = f64::midpoint(low, high);
        cell.robot = scaled_deviations(nominal, &drawn, factor);
        cell.arm = Arm::new(&cell.robot, &cell.tool)?;
        cell.geometry_scale = factor;
        if step == 30 {
            break;
        }
        let sum: f64 = configurations
            .iter()
            .map(|q| {
                let real = cell.tcp(&cell.link_angles_at_rest(q)).position;
                (real - ideal.tcp_frame(&ideal.frames(q)).position).norm()
            })
            .sum();
        if sum / configurations.len() as f64 <= mean_m {
            low = factor;
        } else {
            high = factor;
        }
    }
    Ok(())
}
