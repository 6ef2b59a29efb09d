//! The calibration procedure, Algorithm 2 of the paper, as one configuration.
//!
//! Defaults are the paper's numbers where it gives them; for what it leaves
//! out each default says where it comes from. The host reads it from a file,
//! checks it ([`Procedure::check`]) and sends it over the host link; the
//! controller checks it again before it obeys.

mod check;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

pub use check::ProcedureError;

/// Largest translational stiffness that the law accepts, in N/m (KUKA's range).
pub const MAX_STIFFNESS_N_M: f64 = 5000.0;
/// Largest rotational stiffness that the law accepts, in N m/rad (KUKA's range).
pub const MAX_STIFFNESS_NM_RAD: f64 = 300.0;

/// The whole procedure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
#[serde(default, deny_unknown_fields)]
pub struct Procedure {
    /// What holds in every phase.
    pub law: Law,
    /// Motions in free space, in joint coordinates.
    pub motion: Motion,
    /// From the approach frame to contact.
    pub approach: Approach,
    /// After contact: the magnet seats the nest.
    pub couple: Couple,
    /// Turning about the sphere to the next pose.
    pub turn: Turn,
    /// Recording at a pose.
    pub record: Record,
    /// How a seated nest is told from one that has left.
    pub seating: Seating,
    /// Leaving the sphere.
    pub decouple: Decouple,
    /// Limits whose violation is a fault.
    pub limits: Limits,
    /// What is streamed to the host besides events.
    pub telemetry: Telemetry,
}

/// The control law.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[serde(default, deny_unknown_fields)]
pub struct Law {
    /// Lehr's damping ratio of all Cartesian modes (the paper: 0.7).
    pub damping_ratio: f64,
    /// Rotational stiffness in every Cartesian phase, in N m/rad. At 200 the
    /// worst orientation error while turning was 0.04 degrees in simulation,
    /// at 20 it was 0.4, and at 0 the nest falls over.
    pub rotation_nm_rad: f64,
    /// Stiffness of the null space about the elbow's circle, in N m/rad.
    pub elbow_nm_rad: f64,
    /// Damping ratio of the null space.
    pub elbow_damping_ratio: f64,
    /// Time over which the stiffness changes between phases, in s.
    pub stiffness_ramp_s: f64,
    /// Largest change of a commanded torque, in N m/s. libfranka's 1,000 would
    /// let the hold of a heavier arm (176 N m at 20 rad/s) run into a limit
    /// cycle after a blocked motion is set free; 4,000 does not.
    pub torque_rate_nm_s: f64,
    /// Pole of the momentum observer, in 1/s.
    pub observer_rad_s: f64,
    /// Gain of the torque loop: gear friction and rotor inertia are felt
    /// smaller by `1 + gain`. 0 for a drive whose own torque loop does it. With
    /// 4, 1 to 2 N m of dry friction left more nests beside the sphere.
    pub torque_loop_gain: f64,
    /// Corner of the torque loop's low-pass, in rad/s. Below what a light joint
    /// with a heavy rotor swings at (60 rad/s) the loop's lag drives it: at 30
    /// joint 7 ran into its speed limit.
    pub torque_loop_rad_s: f64,
    /// Largest correction of the torque loop, in N m.
    pub torque_loop_nm: f64,
}

impl Default for Law {
    fn default() -> Self {
        Self {
            damping_ratio: 0.7,
            rotation_nm_rad: 200.0,
            elbow_nm_rad: 50.0,
            elbow_damping_ratio: 0.7,
            stiffness_ramp_s: 0.10,
            torque_rate_nm_s: 4000.0,
            observer_rad_s: 60.0,
            torque_loop_gain: 6.0,
            torque_loop_rad_s: 60.0,
            torque_loop_nm: 20.0,
        }
    }
}

/// Free-space motion between home and the approach frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[serde(default, deny_unknown_fields)]
pub struct Motion {
    /// Largest joint speed, in rad/s.
    pub speed_rad_s: f64,
    /// Largest joint acceleration, in rad/s².
    pub acceleration_rad_s2: f64,
    /// Natural frequency of the joint spring-damper, in rad/s; stiffness and
    /// damping follow from the inertia that each joint moves.
    pub natural_rad_s: f64,
    /// Joint error under which a motion is finished, in rad.
    pub tolerance_rad: f64,
    /// How long past its planned end a motion may take to settle, in s.
    pub settle_s: f64,
}

impl Default for Motion {
    fn default() -> Self {
        Self {
            speed_rad_s: 0.8,
            acceleration_rad_s2: 1.6,
            natural_rad_s: 20.0,
            tolerance_rad: 0.02,
            settle_s: 3.0,
        }
    }
}

/// The approach: 50/50/100 N/m at 25 mm/s until 7.5 N.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[serde(default, deny_unknown_fields)]
pub struct Approach {
    /// Translational stiffness across (two axes) and along the approach, in N/m.
    pub stiffness_n_m: [f64; 3],
    /// Speed of the setpoint, in m/s.
    pub speed_m_s: f64,
    /// Acceleration of the setpoint, in m/s²: a step of 25 mm/s drifts sideways.
    pub acceleration_m_s2: f64,
    /// Force against the approach at which contact is declared, in N.
    pub trigger_n: f64,
    /// How long the force must last, in s: an instantaneous threshold fires on
    /// the impact transient, before the nest is seated.
    pub dwell_s: f64,
    /// Time at rest before the descent over which the wrench is tared, in s.
    pub tare_s: f64,
    /// Largest tare force taken as plausible, in N: an undeclared tool of
    /// 1.5 kg reads as 15 N.
    pub tare_limit_n: f64,
    /// Speed of the TCP under which contact may be declared, in m/s: an arm
    /// that rests against a sphere stands still.
    pub contact_speed_m_s: f64,
    /// Travel of the arm without contact after which the sphere is missed, in m.
    pub travel_m: f64,
    /// How fast the force across the approach grows that keeps the arm on its
    /// line against joint friction, in N/(m s), until something is felt; 0 for
    /// none. The spring of 50 N/m alone may be held 30 mm beside.
    pub line_n_m_s: f64,
}

impl Default for Approach {
    fn default() -> Self {
        Self {
            stiffness_n_m: [50.0, 50.0, 100.0],
            speed_m_s: 0.025,
            acceleration_m_s2: 0.1,
            trigger_n: 7.5,
            dwell_s: 0.020,
            tare_s: 0.5,
            tare_limit_n: 12.0,
            contact_speed_m_s: 0.010,
            travel_m: 0.080,
            line_n_m_s: 100.0,
        }
    }
}

/// After contact: hold softly while the magnet seats the nest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[serde(default, deny_unknown_fields)]
pub struct Couple {
    /// Translational stiffness, in N/m.
    pub stiffness_n_m: f64,
    /// Time of the hold, in s.
    pub hold_s: f64,
    /// Searches that a nest is given which is found loose by the test pull.
    pub searches: u32,
    /// Push of a search along the approach, in N: the planes of the nest turn
    /// it into a force towards the sphere's centre.
    pub search_n: f64,
    /// Force that circles across the approach meanwhile, at its largest, in N:
    /// it breaks friction loose.
    pub search_across_n: f64,
    /// Time of a search, in s.
    pub search_s: f64,
}

impl Default for Couple {
    fn default() -> Self {
        Self {
            stiffness_n_m: 5.0,
            hold_s: 5.0,
            searches: 2,
            search_n: 12.0,
            search_across_n: 5.0,
            search_s: 3.0,
        }
    }
}

/// Turning to the next pose about the sphere.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[serde(default, deny_unknown_fields)]
pub struct Turn {
    /// Translational stiffness, in N/m.
    pub stiffness_n_m: f64,
    /// Largest speed of orientation and elbow, in rad/s.
    pub speed_rad_s: f64,
    /// Largest acceleration of both, in rad/s².
    pub acceleration_rad_s2: f64,
    /// Orientation error under which the pose is reached, in rad.
    pub tolerance_rad: f64,
    /// Elbow error under which the pose is reached, in rad: the recording holds
    /// where the elbow is, so it need not be exact.
    pub elbow_tolerance_rad: f64,
    /// Speed of every joint under which the arm counts as still, in rad/s.
    pub still_rad_s: f64,
    /// How long past its planned end a turn may take to settle, in s.
    pub settle_s: f64,
}

impl Default for Turn {
    fn default() -> Self {
        Self {
            stiffness_n_m: 20.0,
            speed_rad_s: 0.5,
            acceleration_rad_s2: 1.5,
            tolerance_rad: 0.02,
            elbow_tolerance_rad: 0.10,
            still_rad_s: 0.002,
            settle_s: 4.0,
        }
    }
}

/// Recording at a pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[serde(default, deny_unknown_fields)]
pub struct Record {
    /// Translational stiffness, in N/m.
    pub stiffness_n_m: f64,
    /// Samples averaged, one a tick: 1,000 are the paper's 1 s at 1,000 Hz.
    pub samples: u32,
}

impl Default for Record {
    fn default() -> Self {
        Self {
            stiffness_n_m: 5.0,
            samples: 1000,
        }
    }
}

/// The seating watch: while coupled the TCP is tied to the sphere, so its
/// computed position moves only by the errors of the kinematic model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[serde(default, deny_unknown_fields)]
pub struct Seating {
    /// Largest distance of the computed TCP from where it seated, in m. Model
    /// errors reach 2.4 mm (Table 5); a nest that has left is centimetres away
    /// or moves fast.
    pub window_m: f64,
    /// Largest computed TCP speed, in m/s: a nest that leaves jumps.
    pub speed_m_s: f64,
    /// How long a violation must last, in s.
    pub dwell_s: f64,
    /// Test pull after coupling, in N (well under the magnet's 26.5).
    pub test_n: f64,
    /// Time of the test pull, in s.
    pub test_s: f64,
    /// Largest computed TCP displacement under the test pull, in m.
    pub test_m: f64,
    /// Pull that ends each recording, in N: above the joints' friction, which
    /// may hold a loose nest, and well under the magnet's 26.5. What was
    /// recorded counts when the nest has borne it.
    pub check_n: f64,
    /// Time of that pull, in s; 0 for none.
    pub check_s: f64,
    /// Largest computed TCP displacement under that pull, in m: an arm of
    /// 10 N/mm gives way by as much with its nest seated.
    pub check_m: f64,
}

impl Default for Seating {
    fn default() -> Self {
        Self {
            window_m: 0.005,
            speed_m_s: 0.015,
            dwell_s: 0.010,
            test_n: 5.0,
            test_s: 0.6,
            test_m: 0.0015,
            check_n: 10.0,
            check_s: 0.15,
            check_m: 0.001,
        }
    }
}

/// Leaving the sphere against the magnet's 26.5 N.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[serde(default, deny_unknown_fields)]
pub struct Decouple {
    /// Translational stiffness, in N/m: 200 never lets go; at 2,000 the nest
    /// leaves after 12.7 mm of setpoint.
    pub stiffness_n_m: f64,
    /// Speed of the setpoint, in m/s.
    pub speed_m_s: f64,
    /// How far back the setpoint goes along the approach, in m.
    pub retreat_m: f64,
    /// How far the TCP must have followed for the nest to count as free, in m.
    pub free_m: f64,
    /// Time allowed beyond the setpoint's own, in s.
    pub settle_s: f64,
}

impl Default for Decouple {
    fn default() -> Self {
        Self {
            stiffness_n_m: 2000.0,
            speed_m_s: 0.025,
            retreat_m: 0.050,
            free_m: 0.030,
            settle_s: 3.0,
        }
    }
}

/// Limits whose violation is a fault.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Margin to the joints' position limits, in rad.
    pub position_margin_rad: f64,
    /// Share of the joints' speed limits that may be used, 0 to 1.
    pub velocity_share: f64,
    /// Estimated contact force at the TCP, in N, for 10 ms or longer (the
    /// observer sees 20 to 90 N when the magnet snaps the nest shut).
    pub force_n: f64,
    /// Distance between TCP and setpoint in Cartesian phases, in m (the
    /// approach adds its own lag).
    pub path_m: f64,
    /// Joint error in joint motions, in rad.
    pub path_rad: f64,
    /// Age of the last host frame while a host is needed, in s.
    pub host_silence_s: f64,
    /// Missed or repeated drive states in a row that are bridged.
    pub missed_ticks: u32,
    /// States in a row that are the same to the last bit, from a drive that had
    /// noise or says that it moves, after which it counts as frozen; 0 never.
    pub frozen_ticks: u32,
    /// How far an angle may change between two states beyond what one and a
    /// half times the joint's speed limit allows, in rad: noise and resolution.
    pub jump_rad: f64,
    /// Difference between commanded and measured torque that is borne for
    /// longer than 20 ms, as a share of the joint's torque limit: gear friction.
    pub torque_error_share: f64,
    /// Speed of the TCP, in m/s, that stops the arm.
    pub speed_m_s: f64,
    /// Speed of the TCP, in m/s, above which a free motion slows down.
    pub soft_speed_m_s: f64,
    /// Estimated force at the TCP, in N, above which a free motion slows down.
    pub soft_force_n: f64,
    /// Orientation error while turning, in rad, that stops the arm.
    pub turn_rad: f64,
    /// Least coordinates of the TCP, F0, in m.
    pub workspace_min_m: [f64; 3],
    /// Largest coordinates of the TCP, F0, in m.
    pub workspace_max_m: [f64; 3],
    /// Normal of the plate, away from it, a unit vector in F0.
    pub plate_normal: [f64; 3],
    /// Least coordinate of the TCP along that normal, in m.
    pub plate_offset_m: f64,
}

/// No bound, in m: farther than any arm reaches.
pub const UNBOUNDED_M: f64 = 10.0;

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

/// What is streamed to the host: one sample every so many ticks, 0 for none.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[serde(default, deny_unknown_fields)]
pub struct Telemetry {
    /// While approaching, coupling and decoupling.
    pub contact_ticks: u32,
    /// In every other phase.
    pub other_ticks: u32,
}

impl Default for Telemetry {
    fn default() -> Self {
        Self {
            contact_ticks: 1,
            other_ticks: 20,
        }
    }
}
