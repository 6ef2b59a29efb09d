//! One injected fault, and its usual duration.

use serde::{Deserialize, Serialize};

use spherecal_link::Lossy;

/// One thing that goes wrong.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum InjectedFault {
    /// The drive continues to count ticks, but angles, velocities and torques stay the same.
    StateFrozen,
    /// The drive sends the same state again, with the same tick.
    StateRepeated,
    /// Every state comes so many ticks late.
    StateLate {
        /// Delay, in ticks.
        ticks: u32,
    },
    /// States do not arrive. The drive continues with the last torque, then brakes.
    StateDropped,
    /// Bits of the state's frame are flipped on the wire.
    StateBits {
        /// Bits flipped in each frame.
        bits: u32,
    },
    /// An angle is not a number.
    StateNan {
        /// Joint, from 1.
        joint: usize,
    },
    /// An angle reads too large.
    PositionJump {
        /// Joint, from 1.
        joint: usize,
        /// By how much, in rad.
        rad: f64,
    },
    /// An encoder reads what it last read.
    EncoderStuck {
        /// Joint, from 1.
        joint: usize,
    },
    /// A torque sensor reads too high.
    TorqueBias {
        /// Joint, from 1.
        joint: usize,
        /// By how much, in N m.
        nm: f64,
    },
    /// A torque sensor reads zero.
    TorqueDead {
        /// Joint, from 1.
        joint: usize,
    },
    /// The drive reports that it is not ready, and closes its brakes.
    DriveStatus {
        /// What it says.
        status: NotReadyStatus,
    },
    /// A motor gives no more than this.
    TorqueSaturation {
        /// Joint, from 1.
        joint: usize,
        /// Most torque, in N m.
        nm: f64,
    },
    /// An undeclared mass at the TCP.
    Payload {
        /// Mass, in kg.
        kg: f64,
    },
    /// A wall blocks the TCP, across its motion (below it if it stands still).
    Obstacle {
        /// Distance from the TCP, in m.
        ahead_m: f64,
        /// Stiffness, in N/m: a soft body 1e4, steel 1e6.
        stiffness_n_m: f64,
    },
    /// The magnet does not pull.
    MagnetLost,
    /// The sphere next to the TCP is not there.
    SphereMissing,
    /// The sphere nearest to the TCP is displaced permanently.
    SphereMoved {
        /// By how much, F0, in m.
        by_m: [f64; 3],
        /// Over which time, in s.
        over_s: f64,
    },
    /// A person pushes at the TCP.
    HumanPush {
        /// Force, F0, in N.
        force_n: [f64; 3],
    },
    /// The controller restarts without its state.
    ControllerReset,
    /// Nothing passes on the host link, either way.
    HostSilent,
    /// The host link loses, repeats, delays and damages frames.
    HostLink(Lossy),
    /// The host's program is killed, as by `kill -9`, and another one starts.
    HostKilled {
        /// Duration without a host, in s of device time.
        away_s: f64,
    },
    /// The host's disk has no free space.
    DiskFull,
    /// Another program locks the database.
    DatabaseLocked {
        /// For how long, in s of the clock on the wall.
        wall_s: f64,
    },
}

/// What a drive that is not ready says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NotReadyStatus {
    /// Brakes closed or drives off.
    Disabled,
    /// Emergency stop.
    EmergencyStop,
    /// The drive has failed.
    Failed,
}

impl InjectedFault {
    /// Its name, as in a file.
    pub fn name(&self) -> &'static str {
        match self {
            Self::StateFrozen => "state_frozen",
            Self::StateRepeated => "state_repeated",
            Self::StateLate { .. } => "state_late",
            Self::StateDropped => "state_dropped",
            Self::StateBits { .. } => "state_bits",
            Self::StateNan { .. } => "state_nan",
            Self::PositionJump { .. } => "position_jump",
            Self::EncoderStuck { .. } => "encoder_stuck",
            Self::TorqueBias { .. } => "torque_bias",
            Self::TorqueDead { .. } => "torque_dead",
            Self::DriveStatus { .. } => "drive_status",
            Self::TorqueSaturation { .. } => "torque_saturation",
            Self::Payload { .. } => "payload",
            Self::Obstacle { .. } => "obstacle",
            Self::MagnetLost => "magnet_lost",
            Self::SphereMissing => "sphere_missing",
            Self::SphereMoved { .. } => "sphere_moved",
            Self::HumanPush { .. } => "human_push",
            Self::ControllerReset => "controller_reset",
            Self::HostSilent => "host_silent",
            Self::HostLink(_) => "host_link",
            Self::HostKilled { .. } => "host_killed",
            Self::DiskFull => "disk_full",
            Self::DatabaseLocked { .. } => "database_locked",
        }
    }

    /// Its duration, in s, if the file does not state one.
    pub fn usual_s(&self) -> f64 {
        match self {
            Self::ControllerReset | Self::HostKilled { .. } | Self::DatabaseLocked { .. } => 0.0,
            Self::StateNan { .. } | Self::PositionJump { .. } | Self::StateBits { .. } => 0.020,
            Self::StateFrozen
            | Self::StateRepeated
            | Self::StateLate { .. }
            | Self::StateDropped
            | Self::TorqueSaturation { .. }
            | Self::TorqueBias { .. }
            | Self::TorqueDead { .. }
            | Self::EncoderStuck { .. } => 0.5,
            Self::HumanPush { .. } => 0.5,
            Self::Obstacle { .. } | Self::MagnetLost | Self::DriveStatus { .. } => 2.0,
            Self::HostSilent => 3.0,
            Self::SphereMissing | Self::HostLink(_) => 20.0,
            Self::Payload { .. } | Self::SphereMoved { .. } | Self::DiskFull => f64::INFINITY,
        }
    }

    /// Whether only the simulated arm can suffer it.
    pub fn wants_plant(&self) -> bool {
        matches!(
            self,
            Self::EncoderStuck { .. }
                | Self::TorqueBias { .. }
                | Self::TorqueDead { .. }
                | Self::Payload { .. }
                | Self::Obstacle { .. }
                | Self::MagnetLost
                | Self::SphereMissing
                | Self::SphereMoved { .. }
                | Self::HumanPush { .. }
        )
    }

    /// Whether it affects the host's own computer: its program or its disk.
    pub fn of_host(&self) -> bool {
        matches!(
            self,
            Self::HostKilled { .. } | Self::DiskFull | Self::DatabaseLocked { .. }
        )
    }

    /// The affected joint, from 1; `None` for none.
    pub(super) fn joint(&self) -> Option<usize> {
        match *self {
            Self::StateNan { joint }
            | Self::PositionJump { joint, .. }
            | Self::EncoderStuck { joint }
            | Self::TorqueBias { joint, .. }
            | Self::TorqueDead { joint }
            | Self::TorqueSaturation { joint, .. } => Some(joint),
            _ => None,
        }
    }

    /// Fields with their ranges: name, value, minimum, maximum.
    pub(super) fn ranges(&self) -> Vec<(&'static str, f64, f64, f64)> {
        match *self {
            Self::StateLate { ticks } => vec![("ticks", f64::from(ticks), 1.0, 1000.0)],
            Self::StateBits { bits } => vec![("bits", f64::from(bits), 1.0, 1000.0)],
            Self::PositionJump { rad, .. } => vec![("rad", rad, -10.0, 10.0)],
            Self::TorqueBias { nm, .. } => vec![("nm", nm, -500.0, 500.0)],
            Self::TorqueSaturation { nm, .. } => vec![("nm", nm, 0.0, 500.0)],
            Self::Payload { kg } => vec![("kg", kg, 0.0, 20.0)],
            Self::Obstacle { ahead_m, stiffness_n_m } => vec![
                ("ahead_m", ahead_m, 0.0, 1.0),
                ("stiffness_n_m", stiffness_n_m, 1.0, 1e6),
            ],
            Self::SphereMoved { by_m, over_s } => vec![
                ("by_m[0]", by_m[0], -1.0, 1.0),
                ("by_m[1]", by_m[1], -1.0, 1.0),
                ("by_m[2]", by_m[2], -1.0, 1.0),
                ("over_s", over_s, 0.001, 60.0),
            ],
            Self::HumanPush { force_n } => vec![
                ("force_n[0]", force_n[0], -500.0, 500.0),
                ("force_n[1]", force_n[1], -500.0, 500.0),
                ("force_n[2]", force_n[2], -500.0, 500.0),
            ],
            Self::HostLink(link) => vec![
                ("loss", link.loss, 0.0, 0.9),
                ("duplication", link.duplication, 0.0, 0.9),
                ("reorder", link.reorder, 0.0, 0.9),
                ("bit_flip", link.bit_flip, 0.0, 0.9),
            ],
            Self::HostKilled { away_s } => vec![("away_s", away_s, 0.0, 3600.0)],
            Self::DatabaseLocked { wall_s } => vec![("wall_s", wall_s, 0.0, 3600.0)],
            _ => Vec::new(),
        }
    }
}
