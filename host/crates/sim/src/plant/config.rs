//! The plant's configuration: every error source with its physical parameter,
//! its unit, a switch, and where the default comes from.
//!
//! Only errors are here. The known data of the real cell are in [`NominalCell`].
//! `#[serde(default)]` is used throughout, so that a TOML file needs only what differs from the
//! `typical` preset. "The paper" is Nadeau, Bonev and Joubair 2019; "iiwa7.json" is
//! `tests/data/iiwa7.json`, which contains its sources.

use super::nest_kind::NestKind;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use spherecal_model::NominalCell;

use super::error::PlantError;
pub use super::slow_config::{
    DisturbanceConfig, DriveConfig, EncoderSide, LostMotionConfig, ReadingConfig, ThermalConfig,
};

/// All errors of a simulated plant, with their seed. The default is [`PlantConfig::typical`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PlantConfig {
    /// Seed of all random draws. Each error source has its own stream, so switching one source off
    /// does not change the others.
    pub seed: u64,
    /// Contact and magnet. `false` removes nest, rim, plate and magnet.
    pub contact: bool,
    /// Sub-step while in contact or with dry joint friction, in s. 1 ms must be a whole multiple of
    /// it.
    pub substep_s: f64,
    /// Sub-step in free space (explicit Runge-Kutta 4), in s.
    pub free_step_s: f64,
    /// The nominal cell of the simulated arm. It comes from `[cell]` of the configuration, not from
    /// `[plant]`; the default is the paper's plate.
    #[serde(skip)]
    pub cell: NominalCell,
    /// Errors of the plate and its spheres.
    pub plate: PlateConfig,
    /// The nest at the TCP.
    pub nest: NestConfig,
    /// Geometry errors of the arm.
    pub geometry: GeometryConfig,
    /// Tool errors.
    pub tool: ToolConfig,
    /// Compliance of joints, links and base.
    pub compliance: ComplianceConfig,
    /// Encoder and gear errors.
    pub encoder: EncoderConfig,
    /// Lost motion of the gears.
    pub lost_motion: LostMotionConfig,
    /// Drift of links and plate while the cell warms up.
    pub thermal: ThermalConfig,
    /// Angles that are read before the arm rests.
    pub reading: ReadingConfig,
    /// Noise, quantisation and filters of the joint sensors.
    pub sensors: SensorConfig,
    /// Joint friction.
    pub friction: FrictionConfig,
    /// Mass errors and rotor inertia.
    pub inertia: InertiaConfig,
    /// Joint elasticity as a state.
    pub elasticity: ElasticityConfig,
    /// Torques of cables, and errors of the torque sensors that do not average out.
    pub disturbance: DisturbanceConfig,
    /// Delays of the drive and lag of its actuators.
    pub drive: DriveConfig,
    /// Laser tracker.
    pub tracker: TrackerConfig,
}

/// Errors of the plate: its deviation from the certificate and from the nominal placement, which
/// are both in `[cell]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PlateConfig {
    /// Whether the spheres deviate from their certificate, by `cell.plate.certificate_sigma_m`.
    pub certificate_error: bool,
    /// Whether the plate deviates from its nominal placement.
    pub placement_error: bool,
    /// Standard deviation of each placement, each axis, in m. Default 2 mm: a plate that is put down by hand
    /// according to a drawing.
    pub placement_sigma_m: f64,
    /// Standard deviation of each placement's rotation, each axis, in rad. Default 5 mrad, for the same reason.
    pub placement_sigma_rad: f64,
}

/// Trihedral nest with a magnet (Section 2.2: a cube corner of three planes).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NestConfig {
    /// Normal stiffness of a pad, in N/m. Default 1e6 (`docs/design/plant.md`: 1e7 needs a 0.1 ms step).
    pub stiffness_n_m: f64,
    /// Normal damping of a pad, in N s/m. Default 1e3 (`docs/design/plant.md`).
    pub damping_n_s_m: f64,
    /// Friction coefficient, steel on steel with oil. Default 0.15 (`docs/design/plant.md`).
    pub friction: f64,
    /// Speed below which friction is viscous, in m/s, so the nest creeps under load. Default 1 mm/s
    /// (`docs/design/plant.md`).
    pub friction_speed_m_s: f64,
    /// Whether there is a magnet.
    pub magnet: bool,
    /// Pull of the magnet on a seated sphere, in N. Default 26.5: 2.7 kg (Section 2.2).
    pub magnet_n: f64,
    /// Gap at which the pull is a quarter, in m: `F = F0 / (1 + gap/scale)²`. Default 1 mm
    /// (`docs/design/plant.md`).
    pub magnet_scale_m: f64,
    /// Gap beyond which there is no pull, in m. Default 50 mm, where 0.01 N is left.
    pub magnet_range_m: f64,
    /// Height of the rim above the seated sphere's centre along the tool's +z, in m. Default
    /// 2.5 mm: assumed, because no drawing is published.
    pub rim_height_m: f64,
    /// Outer radius of the nest's body, in m. Default 42 mm: from the photographs (Figure 2).
    pub body_radius_m: f64,
    /// Whether the sphere seats differently each time.
    pub seating_error: bool,
    /// What the nest is made of: `steel` (default) or `socket`.
    pub kind: NestKind,
    /// Standard deviation of the seat of each sound coupling, each axis, in m.
    /// Default 1.5 µm (`docs/design/plant.md`: 1-3 µm).
    pub seating_sigma_m: f64,
    /// Standard deviation of the seat over the orientations of one coupling (form of sphere and
    /// pads), each axis, in m. Default 1.5 µm, assumed: a ball of grade 25 is round within 0.6 µm
    /// (ISO 3290), and three lapped pads are not better.
    pub form_sigma_m: f64,
}

/// Geometry errors: the 24 MDH parameters of joints 2..n. The first row is the
/// base frame's own and stays nominal (Section 3.1 of the paper).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GeometryConfig {
    /// Switch.
    pub enabled: bool,
    /// Standard deviation of `a` and `d`, in m. Default 0.20 mm (`docs/design/identification.md`, worlds).
    pub length_sigma_m: f64,
    /// Standard deviation of `alpha`, in rad. Default 0.5 mrad (the same).
    pub alpha_sigma_rad: f64,
    /// Standard deviation of `theta`, in rad. Default 0.8 mrad (the same).
    pub theta_sigma_rad: f64,
    /// Mean nominal error to which the drawn errors are scaled, in m, over 500 configurations in
    /// joint space with one tool; 0: not scaled. Default 1.27 mm: with tool, gears and compliance
    /// the median validation error is then the paper's 1.40 mm
    /// (`tests/tests/arm/plant_presets.rs`).
    pub nominal_mean_m: f64,
    /// Mean nominal error of all static effects together, in m. The drawn geometry is rescaled to
    /// reach it; 0 (default): not rescaled. Replaces [`Self::nominal_mean_m`] (W0 to W4: 1.403 mm).
    pub overall_mean_m: f64,
    /// Share of the robots whose joints were never mastered well, 0 to 1. Each of their joints is
    /// off by up to [`Self::offset_rad`]. Default 0.
    pub offset_share: f64,
    /// Largest joint offset of such a robot, in rad (uniform, either sign). Default 0.
    pub offset_rad: f64,
}

/// Tool errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ToolConfig {
    /// Switch.
    pub enabled: bool,
    /// Standard deviation of each TCP coordinate, in m. Default 1 mm (`docs/design/identification.md`, worlds).
    pub tcp_sigma_m: f64,
}

/// Compliance: quasi-static deflection of the joints (between encoder and link), the links and the
/// base.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ComplianceConfig {
    /// Switch.
    pub enabled: bool,
    /// Joint compliance between encoder and link, in rad/(N m): the link lags the encoder by `c
    /// tau`. This one, `joints_rad_per_nm`, elasticity and rotors are those of joints with a torque limit of up to 176 N m;
    /// the gear of a stronger joint is in proportion stiffer, more damped and heavier. Default 3e-6: world W0. (A real iiwa 7 showed 6e-5 with the encoder on the motor side;
    /// `docs/design/identification.md`.)
    pub joint_rad_per_nm: f64,
    /// Spread between joints: each is drawn from `joint · U(1−s, 1+s)`. Default 0.3 (W0).
    pub spread: f64,
    /// Minimum and maximum compliance of each joint, base to flange, in rad/(N m) (uniform). Joints
    /// beyond the list use `joint_rad_per_nm`. Default: empty.
    pub joints_rad_per_nm: Vec<[f64; 2]>,
    /// Quadratic term of every joint, in rad/(N m)²: the joint deflects by `c tau + c2 tau |tau|`. Default 0 (W4: 2e-8).
    pub quadratic_rad_per_nm2: f64,
    /// The same as a share of the linear term at the joint's torque limit: negative for a joint
    /// that stiffens under load, as strain wave gears do. Default 0.
    pub quadratic_share: f64,
    /// Torque hysteresis, in rad: the load presses the teeth to one flank or the other, `h tanh(tau
    /// / 0.5 N m)`. Default 0 (W4: 3e-5).
    pub hysteresis_rad: f64,
    /// Mean bending of each link about its x and y under the moment that it carries, in rad/(N m).
    /// Default 0.
    pub link_rad_per_nm: f64,
    /// Standard deviation of the bending about that mean, in rad/(N m). Default 0 (W3: 1.5e-6).
    pub link_sigma_rad_per_nm: f64,
    /// Mean tilt of the base about x and y under the moment that it carries, in rad/(N m). Default
    /// 0.
    pub base_rad_per_nm: f64,
    /// Standard deviation of the tilt about that mean, in rad/(N m). Default 0 (W3: 1e-6).
    pub base_sigma_rad_per_nm: f64,
    /// Time constant with which a joint's deflection follows its torque, in s, because the motor
    /// cannot jump. Default 4 ms: a first resonance near 40 Hz, typical of an arm of this size.
    pub settling_s: f64,
}

/// Errors between the encoder's angle `e` and the gear's output angle: `gear = e + h(e) + scatter`, with `h` the sum of
/// harmonics, gear, smooth and cross-joint errors. The link lags the gear by deflection and lost motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EncoderConfig {
    /// Where the encoder sits. On the motor (default) it does not see the joint deflect; on the link it does.
    pub side: EncoderSide,
    /// Switch of the harmonics.
    pub harmonics: bool,
    /// Amplitude (standard deviation of cosine and sine together) of orders 1,
    /// 2, ... per turn, in rad. Default 2e-4, 1e-4 (W0).
    pub harmonic_rad: Vec<f64>,
    /// Switch of the gear's error.
    pub gear: bool,
    /// Gear error, rms, in rad: three tones per joint between the orders below, so that poses a few
    /// degrees apart have unrelated values. Default 5e-5 (W0's white joint error).
    pub gear_rad: f64,
    /// Lowest and highest order of the gear's tones, per turn. Default 60 to 160, assumed: about
    /// one and two times the ratio of a strain wave gear.
    pub gear_orders: [u32; 2],
    /// Smooth error without a particular form, rms, in rad (W4: 1.2e-4): random Fourier features
    /// with a Gaussian kernel.
    pub smooth_rad: f64,
    /// Its length scale, in rad (W4: 0.35).
    pub smooth_length_rad: f64,
    /// Error of a joint that depends on its own angle and another joint's, rms, in rad (W4: 5e-5).
    pub cross_rad: f64,
    /// Its length scale, in rad (W4: 1).
    pub cross_length_rad: f64,
    /// Error that does not repeat: the joint stops at another angle each time, rms, in rad. Default
    /// 0 (W0: 5e-5; ISO 9283 repeatabilities of 0.02-0.05 mm are of this size).
    pub scatter_rad: f64,
    /// Travel of the joint after which that error is drawn again, in rad. Default 2e-3, assumed.
    pub scatter_travel_rad: f64,
}

/// Joint sensors as the drive link shows them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SensorConfig {
    /// Enables noise and quantisation (bias and filters have their own fields).
    pub noise: bool,
    /// White noise of an angle sample, in rad. Default 1e-5: averages to 3e-7 over 1 s (`docs/design/control.md`).
    pub angle_white_rad: f64,
    /// Correlated noise of the angle, standard deviation, in rad. Default 4e-6: averages to about 1.3e-6.
    pub angle_correlated_rad: f64,
    /// Correlation time of that noise, in s. Default 50 ms (`docs/design/control.md`).
    pub angle_correlation_s: f64,
    /// Step of the angle, in rad; 0: none. Default 2π/2^22: a 22 bit encoder, assumed.
    pub angle_step_rad: f64,
    /// White noise of a velocity sample, in rad/s. Default 3e-4: a drive that differentiates its
    /// motor encoder before the gear.
    pub velocity_white_rad_s: f64,
    /// Step of the velocity, in rad/s; 0: none. Default 1e-5: far below the noise, assumed.
    pub velocity_step_rad_s: f64,
    /// Time constant of the drive's velocity filter, in s; 0: none. Default 0.8 ms (200 Hz),
    /// assumed: slower filters reduced the damping of the control loop.
    pub velocity_filter_s: f64,
    /// White noise of a torque sample, in N m. Default 0.03: 1e-4 of the range of joint 1.
    pub torque_white_nm: f64,
    /// Step of the torque, in N m; 0: none. Default 0.005: 16 bits over that range.
    pub torque_step_nm: f64,
    /// Standard deviation of the torque sensors' bias as a share of the joint's
    /// torque limit. Default 0.0005; 0.005 is the "0.5 % of range" of `docs/design/control.md`.
    pub torque_bias_share: f64,
}

/// Joint friction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FrictionConfig {
    /// Switch.
    pub enabled: bool,
    /// Minimum and maximum dry friction of each joint, in N m (uniform). Default 0.03 to 0.10: the
    /// part of the gear's friction that remains behind a drive's torque loop, assumed; `harsh` has
    /// 1 to 2, a gear without such a loop.
    pub coulomb_nm: [f64; 2],
    /// Minimum and maximum viscous friction of each joint, in N m s/rad (uniform). Default 0.05 to
    /// 0.2, for the same reason.
    pub viscous_nm_s: [f64; 2],
    /// Share of the friction that acts beyond the torque sensor, on the link (bearings), 0 to 1.
    /// The rest acts in the gear, and the sensor sees its effect. Default 0: the friction of
    /// bearings is small.
    pub beyond_sensor: f64,
}

/// Masses and rotors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct InertiaConfig {
    /// Switch of the mass errors.
    pub mass_error: bool,
    /// Standard deviation of each link's mass as a share of it. Default 0.003: a model identified
    /// by the maker; `harsh` has 0.01.
    pub link_mass_sigma: f64,
    /// Minimum and maximum error of the tool's mass as a share of it, with either sign. Default up
    /// to 0.005: a tool that was weighed; `harsh` has 0.03 to 0.05.
    pub tool_mass_error: [f64; 2],
    /// Switch of the rotors.
    pub rotors: bool,
    /// Rotor inertia of joints 1.., reflected to the link, in kg m². Default:
    /// Drake's estimates for the iiwa 7 (iiwa7.json); joints beyond the list have none.
    pub rotor_kg_m2: [f64; 8],
    /// Share of it that the drive's torque loop leaves visible, 0 to 1. Default 0.25: the reduction
    /// by torque feedback with a gain of 3.
    pub rotor_share: f64,
    /// Standard deviation of each rotor's inertia as a share of it. Default 0.1, an assumption: the
    /// drive declares the numbers above, as from a data sheet, and the arm has others.
    pub rotor_sigma: f64,
}

impl InertiaConfig {
    /// Inertia of motor `joint`, from 0, by the data sheet, that lies between commanded and measured
    /// torque, in kg m².
    pub(super) fn visible(&self, joint: usize) -> f64 {
        let inertia = self.rotor_kg_m2.get(joint).filter(|_| self.rotors);
        inertia.map_or(0.0, |inertia| inertia * self.rotor_share)
    }
}

/// Joint elasticity as a state: motor and link side, a spring between them, the
/// encoder on the motor. Replaces the quasi-static joint compliance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ElasticityConfig {
    /// Switch.
    pub enabled: bool,
    /// Stiffness of every joint, in N m/rad. Default 16,000 (6e-5 rad/(N m), the real iiwa 7 of
    /// `docs/design/identification.md`). 0: the inverse of each joint's own compliance.
    pub stiffness_nm_rad: f64,
    /// Damping of the spring, in N m s/rad. Default 20: 8 % of critical with 1 kg m² behind it.
    pub damping_nm_s: f64,
    /// Smallest motor inertia, in kg m²; used if `inertia.rotor_kg_m2` times its share is less.
    /// Default 0.05, that of a small joint, so that the sub-step resolves the motor side.
    pub least_motor_kg_m2: f64,
}

/// Laser tracker.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TrackerConfig {
    /// Switch of the noise.
    pub noise: bool,
    /// Standard deviation of each coordinate, in m. Default 49 µm at 95 % (the paper, Section 4.3).
    pub sigma_m: f64,
    /// Noise of the encoder means that go with a shot, in rad. Default 2e-6 (worlds).
    pub encoder_rad: f64,
    /// Offset by which the reflector is remounted sideways between tool arcs and calibration, in m.
    /// Default 0: the laser's rows are as good as the tracker. W1: 0.58 mm, with which the error of
    /// the laser-calibrated geometry is that of the paper.
    pub remount_m: f64,
    /// Offset by which the tracker is set up again between base arcs and calibration, in m. W1:
    /// 0.15 mm.
    pub restation_m: f64,
    /// Start of the tracker's session, in s after the start of the run. It matters if the cell
    /// drifts. Default 0.
    pub after_s: f64,
    /// Time from one shot to the next, in s. Default 5, assumed: move, settle, average for a second.
    pub shot_s: f64,
    /// Position of the tracker's frame in F0, in m. Default about 2.5 m away and rotated, so that
    /// no two frames agree by accident.
    pub position_m: [f64; 3],
    /// Roll, pitch, yaw of the tracker's frame in F0, in rad. Default: see the position.
    pub rpy_rad: [f64; 3],
}

impl PlantConfig {
    /// Reads TOML text. Fields that it leaves out are those of `typical`.
    ///
    /// # Errors
    /// The text is not TOML, has unknown fields, or is refused by [`Self::check`].
    pub fn from_toml(text: &str) -> Result<Self, PlantError> {
        let config: Self = toml::from_str(text).map_err(|e| PlantError::Toml { reason: e.to_string() })?;
        config.check()?;
        Ok(config)
    }

    /// TOML text with every field.
    ///
    /// # Errors
    /// Only if the serialiser fails.
    pub fn to_toml(&self) -> Result<String, PlantError> {
        toml::to_string(self).map_err(|e| PlantError::Toml { reason: e.to_string() })
    }
}
