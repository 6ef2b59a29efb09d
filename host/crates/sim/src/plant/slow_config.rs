//! Configuration of the effects that depend on time and on the path of the arm: lost motion,
//! thermal drift, early readings, disturbing torques, and the delays of the drive.
//!
//! All of them are off by default, and off in the presets `ideal`, `typical`, `harsh` and `w0` to `w4`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which side of the joint's elasticity an encoder sits on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EncoderSide {
    /// On the motor: deflection and lost motion are between the reading and the link.
    #[default]
    Motor,
    /// On the link: the reading contains deflection and lost motion.
    Link,
}

/// Lost motion: the part of a motion that a gear loses when its direction changes.
///
/// The link lags the motor by up to `half_width_rad`, on the side of the last motion. After a reversal the other side
/// is approached exponentially over `travel_rad` (Dahl's model of pre-sliding friction, rate-independent).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LostMotionConfig {
    /// Switch.
    pub enabled: bool,
    /// Minimum and maximum half width of the hysteresis of each joint, in rad (uniform). Default 0.
    pub half_width_rad: [f64; 2],
    /// Travel after which the share 1 − 1/e of the change to the other side is done, in rad.
    /// Default 1e-3, assumed.
    pub travel_rad: f64,
}

impl Default for LostMotionConfig {
    fn default() -> Self {
        Self {
            enabled: false,
            half_width_rad: [0.0, 0.0],
            travel_rad: 1e-3,
        }
    }
}

/// Drift of links and plate while the cell warms up: `1 − exp(−t/T)`, zero at the start of the run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ThermalConfig {
    /// Switch.
    pub enabled: bool,
    /// Minimum and maximum growth of the whole stretched arm in the first hour after power-on, in m
    /// (uniform). Each length takes a share in proportion to itself times U(0.5, 1.5). Default 0.
    pub links_m: [f64; 2],
    /// Minimum and maximum shift of the plate in that hour, in m (uniform), in a random direction.
    /// Default 0.
    pub plate_m: [f64; 2],
    /// Time constant of the warm-up, in s. Default 3600, assumed.
    pub time_constant_s: f64,
    /// Time since power-on at the start of the run, in s. Default 1800, assumed.
    pub on_since_s: f64,
}

impl Default for ThermalConfig {
    fn default() -> Self {
        Self {
            enabled: false,
            links_m: [0.0, 0.0],
            plate_m: [0.0, 0.0],
            time_constant_s: 3600.0,
            on_since_s: 1800.0,
        }
    }
}

/// Readings before the arm rests, in static measurements: rows of the static worlds and shots of
/// the tracker. A run on the plant determines its own reading times.
///
/// At the time of reading a joint is still braking: it has `½ a t²` to go, along its last move. The
/// joint that moves farthest brakes with `deceleration_rad_s2`, the others in proportion to their
/// moves.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ReadingConfig {
    /// Share of the rows that are read early, 0 to 1. Default 0.
    pub early_share: f64,
    /// Time before rest at which they are read, in s. Default 5 ms.
    pub early_s: f64,
    /// Deceleration of the joint that moves farthest, in rad/s². Default 10, assumed: full braking of a small arm.
    pub deceleration_rad_s2: f64,
}

impl Default for ReadingConfig {
    fn default() -> Self {
        Self {
            early_share: 0.0,
            early_s: 5e-3,
            deceleration_rad_s2: 10.0,
        }
    }
}

/// Delays between controller and joints, and the lag of the actuators.
///
/// The controller sees the newest state that has arrived; the drive holds a command until the next one arrives
/// (the module `delay` says how a part of a tick counts).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DriveConfig {
    /// Delay of the state, in s, 0 to 0.02. Default 0.
    pub state_delay_s: f64,
    /// Delay of the command, in s, 0 to 0.02. Default 0.
    pub command_delay_s: f64,
    /// Jitter: each delay is longer by up to this much, in s, drawn again at every tick (uniform).
    /// No message overtakes an earlier one. Default 0.
    pub jitter_s: f64,
    /// Steps: in every second interval of `step_every_s` both delays are longer by this much, in s.
    /// Default 0.
    pub step_s: f64,
    /// Length of these intervals, in s; 0 (default): no steps.
    pub step_every_s: f64,
    /// Delay that the drive declares, in s. Default: the mean of the one that it has, without steps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub declared_s: Option<f64>,
    /// Time constant of the actuators, in s: torque follows its command as a first-order lag. Default 0.
    pub actuator_lag_s: f64,
}

/// Torques that no model of the arm has, and errors of the torque sensors that do not average out.
///
/// All are off by default and in every preset: makers do not publish them, and the controller does not compensate them yet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DisturbanceConfig {
    /// Half width of the play of the torque sensors, as a share of the joint's torque limit: the reading follows the
    /// torque only after the torque has moved by so much to either side. Default 0.
    pub torque_play_share: f64,
    /// Bias of each torque sensor, base to flange, in N m. It is added to the one that is drawn
    /// (`sensors.torque_bias_share`). Joints beyond the list have none. Default: empty.
    pub torque_bias_nm: Vec<f64>,
    /// Largest torque of the cables and hoses on each joint, base to flange, in N m. Joints beyond the list have none.
    /// Default: empty. 1.5 is a cable that pulls with 15 N at 0.1 m, assumed.
    pub cable_nm: Vec<f64>,
    /// Largest angle in which the cables of a joint lie without tension, in rad (uniform, either sign). They pull the joint
    /// towards it. Default 1, assumed.
    pub cable_laid_rad: f64,
    /// Angle from there over which the torque grows, in rad: `cable_nm tanh(angle / cable_bend_rad)`. Default 0.3,
    /// assumed.
    pub cable_bend_rad: f64,
}

impl Default for DisturbanceConfig {
    fn default() -> Self {
        Self {
            torque_play_share: 0.0,
            torque_bias_nm: Vec::new(),
            cable_nm: Vec::new(),
            cable_laid_rad: 1.0,
            cable_bend_rad: 0.3,
        }
    }
}
