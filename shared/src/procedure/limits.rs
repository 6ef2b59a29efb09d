//! The limits of speed, force, torque, space and time.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Limits whose violation is a fault.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Margin to the joints' position limits, in rad.
    pub position_margin_rad: f64,
    /// Share of the joints' speed limits that may be used, from 0 to 1.
    pub velocity_share: f64,
    /// Largest contact force at the TCP by the steady estimate, in N, for 10 ms or longer. The estimate is a low-pass of
    /// `law.observer_rad_s`: of an impact of 10 ms it shows a third to a half.
    pub force_n: f64,
    /// Largest distance between TCP and setpoint in the approach, in m. It
    /// includes the lag that builds the contact force.
    pub path_m: f64,
    /// Largest joint error in joint motions, in rad.
    pub path_rad: f64,
    /// Longest time without a frame from the host while one is needed, in s.
    pub host_silence_s: f64,
    /// Number of missing or unusable drive states in a row that are bridged by the
    /// last torque.
    pub missed_ticks: u32,
    /// Number of identical drive states in a row after which the drive counts as
    /// frozen, if the commanded torque has changed meanwhile or the states show a
    /// joint speed. 0 turns the check off.
    pub frozen_ticks: u32,
    /// Change of a joint angle between two states that is accepted in addition to
    /// 1.5 times the joint's speed limit, in rad: noise and resolution.
    pub jump_rad: f64,
    /// Largest difference between commanded and measured torque for longer than
    /// 20 ms, as a share of the joint's torque limit. Gear friction causes some.
    pub torque_error_share: f64,
    /// Speed of the TCP that stops the arm, in m/s.
    pub speed_m_s: f64,
    /// Speed of the TCP above which a free motion slows down, in m/s.
    pub soft_speed_m_s: f64,
    /// Force at the TCP by the steady estimate above which a free motion slows down, in N.
    pub soft_force_n: f64,
    /// Orientation error while turning that stops the arm, in rad.
    pub turn_rad: f64,
    /// Smallest coordinates of the TCP, F0, in m.
    pub workspace_min_m: [f64; 3],
    /// Largest coordinates of the TCP, F0, in m.
    pub workspace_max_m: [f64; 3],
    /// Normal of the plate: a unit vector in F0 that points away from the plate.
    pub plate_normal: [f64; 3],
    /// Smallest coordinate of the TCP along the plate's normal, in m.
    pub plate_offset_m: f64,
}

/// Stands for "no limit" in the workspace, in m: farther than any arm reaches.
pub(super) const UNBOUNDED_M: f64 = 10.0;

impl Default for Limits {
    fn default() -> Self {
        Self {
            position_margin_rad: 0.01,
            velocity_share: 0.9,
            force_n: 100.0,
            path_m: 0.150,
            path_rad: 0.1,
            host_silence_s: 2.0,
            missed_ticks: 3,
            frozen_ticks: 20,
            jump_rad: 0.002,
            torque_error_share: 0.15,
            speed_m_s: 1.3,
            soft_speed_m_s: 0.75,
            soft_force_n: 40.0,
            turn_rad: 0.3,
            workspace_min_m: [-UNBOUNDED_M; 3],
            workspace_max_m: [UNBOUNDED_M; 3],
            plate_normal: [0.0, 0.0, 1.0],
            plate_offset_m: -UNBOUNDED_M,
        }
    }
}
