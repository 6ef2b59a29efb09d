//! The phases of contact: approach, coupling, turning, recording, decoupling.

use super::MAX_STIFFNESS_N_M;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// The approach: stiffness 50/50/200 N/m, 25 mm/s, until the force is 7.5 N.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Approach {
    /// Translational stiffness across the approach (two axes) and along it, in N/m, once something stops the TCP.
    /// Before, it is at least 400 N/m across and 200 N/m along: the play of torque sensors would drive a softer arm off its
    /// line. The paper has 100 N/m along, with which the force of contact takes twice as long.
    pub stiffness_n_m: [f64; 3],
    /// Speed of the setpoint, in m/s.
    pub speed_m_s: f64,
    /// Acceleration of the setpoint, in m/s². A step to 25 mm/s makes the arm
    /// drift sideways.
    pub acceleration_m_s2: f64,
    /// Force against the approach at which contact is declared, in N.
    pub trigger_n: f64,
    /// Time for which the force must last, in s. Without it the impact triggers
    /// contact before the nest is seated.
    pub dwell_s: f64,
    /// Time at rest before the descent over which the wrench is averaged for the
    /// tare, in s.
    pub tare_s: f64,
    /// Largest tare force that is accepted, in N. A tool of 1.5 kg that was not
    /// declared reads as 15 N.
    pub tare_limit_n: f64,
    /// Speed of the TCP below which contact may be declared, in m/s: an arm that
    /// rests on a sphere stands still.
    pub contact_speed_m_s: f64,
    /// Distance that the arm may descend without contact, in m; then the sphere
    /// counts as missed.
    pub travel_m: f64,
    /// Integral gain, in N/(m s), of the force that keeps the arm on its line
    /// against joint friction until something stops it; 0 turns it off. It belongs to a spring of 50 N/m, which friction
    /// may hold 30 mm beside the line; with the 400 N/m of free motion it is eight times as large.
    pub line_n_m_s: f64,
}

impl Default for Approach {
    fn default() -> Self {
        Self {
            stiffness_n_m: [50.0, 50.0, 200.0],
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

/// Coupling: a soft hold after contact while the magnet seats the nest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Couple {
    /// Translational stiffness, in N/m.
    pub stiffness_n_m: f64,
    /// Duration of the hold, in s.
    pub hold_s: f64,
    /// Number of searches after the test pull has found the nest loose.
    pub searches: u32,
    /// Push along the approach during a search, in N. The planes of the nest turn
    /// it into a force towards the sphere's centre.
    pub search_n: f64,
    /// Largest value of the force that circles across the approach during a
    /// search, in N. It overcomes joint friction.
    pub search_across_n: f64,
    /// Duration of a search, in s.
    pub search_s: f64,
}

impl Default for Couple {
    fn default() -> Self {
        Self {
            stiffness_n_m: 5.0,
            hold_s: 0.5,
            searches: 2,
            search_n: 12.0,
            search_across_n: 5.0,
            search_s: 3.0,
        }
    }
}

/// Speed of a joint in rad/s up to which an arm that is there only creeps. Joints 5 and 7 of an FR3 still turned against
/// each other with 0.034 rad/s when the settling time was over.
const CREEP_RAD_S: f64 = 0.1;

/// Turning to the next pose about the sphere.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Turn {
    /// Translational stiffness, in N/m.
    pub stiffness_n_m: f64,
    /// Largest speed of orientation and elbow, in rad/s.
    pub speed_rad_s: f64,
    /// Largest acceleration of orientation and elbow, in rad/s².
    pub acceleration_rad_s2: f64,
    /// Orientation error below which the pose is reached, in rad. After half of `settle_s` up to three times
    /// as much is enough, where the drive's delay makes the spring so much softer, and an arm that is still off is
    /// turned further.
    pub tolerance_rad: f64,
    /// Elbow error below which the pose is reached, in rad. It need not be small:
    /// the recording uses the elbow angle as it is. After half of `settle_s` twice as much is enough.
    pub elbow_tolerance_rad: f64,
    /// Speed of every joint below which the arm counts as still, in rad/s. A turn ends at three times as much; the
    /// recording then waits for it.
    pub still_rad_s: f64,
    /// Time that a turn may take to settle after its planned end, in s. An arm that is there and only creeps has three
    /// times as long.
    pub settle_s: f64,
}

impl Turn {
    /// Time that a turn may take to settle if the arm is there and only creeps, in s. Viscous friction of 2 N m s/rad lets
    /// an elbow creep for 10 s.
    pub fn longest_settle_s(&self) -> f64 {
        3.0 * self.settle_s
    }

    /// Time that an arm which is there may take to come to rest while its fastest joint has this speed (rad/s), in s.
    pub fn most_s(&self, joint_speed: f64) -> f64 {
        if joint_speed <= CREEP_RAD_S {
            self.longest_settle_s()
        } else {
            self.settle_s
        }
    }
}

impl Default for Turn {
    fn default() -> Self {
        Self {
            stiffness_n_m: 20.0,
            speed_rad_s: 1.5,
            acceleration_rad_s2: 2.5,
            tolerance_rad: 0.02,
            elbow_tolerance_rad: 0.10,
            still_rad_s: 0.002,
            settle_s: 4.0,
        }
    }
}

/// Recording at a pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Record {
    /// Translational stiffness, in N/m.
    pub stiffness_n_m: f64,
    /// Samples averaged, one per tick. The paper's 1 s at 1,000 Hz ([`Procedure::paper`](super::Procedure::paper)) told
    /// nothing more in simulation than 0.2 s.
    pub samples: u32,
}

impl Default for Record {
    fn default() -> Self {
        Self {
            stiffness_n_m: 5.0,
            samples: 200,
        }
    }
}

/// The seating watch. While the nest is coupled, the TCP is tied to the sphere:
/// its computed position moves only by the errors of the kinematic model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Seating {
    /// Largest distance of the computed TCP from where it was when the nest
    /// seated, in m. Model errors reach 2.4 mm (Table 5 of the paper); a nest that
    /// has left is centimetres away or moves fast.
    pub window_m: f64,
    /// Largest speed of the computed TCP, in m/s: a nest that leaves jumps.
    pub speed_m_s: f64,
    /// Time for which one of the two must last, in s.
    pub dwell_s: f64,
    /// Test pull after coupling, in N: like `check_n` more than the joints' friction at the TCP, which bears 5 N of a nest beside
    /// its sphere, and well below the magnet's 26.5 N.
    pub test_n: f64,
    /// Duration of the test pull, in s.
    pub test_s: f64,
    /// Largest computed TCP displacement under the test pull, in m.
    pub test_m: f64,
    /// Pull at the end of each recording, in N. It must exceed the joints'
    /// friction, which can hold a loose nest, and stay well below the magnet's
    /// 26.5 N. A recording counts only if the nest stays seated under it.
    pub check_n: f64,
    /// Duration of that pull, in s; 0 turns it off.
    pub check_s: f64,
    /// Computed TCP displacement of a seated nest on an arm of 10 N/mm under that pull, in m. Three
    /// times as much is a fault, and so is more than three quarters of it that remain after the pull.
    pub check_m: f64,
}

impl Default for Seating {
    fn default() -> Self {
        Self {
            window_m: 0.005,
            speed_m_s: 0.015,
            dwell_s: 0.010,
            test_n: 10.0,
            test_s: 0.6,
            test_m: 0.0015,
            check_n: 10.0,
            check_s: 0.15,
            check_m: 0.001,
        }
    }
}

/// Leaving the sphere against the magnet.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Decouple {
    /// Pull of the nest's magnet on a seated sphere, in N (the paper: 2.7 kg). What the arm may pull with, and for how long,
    /// follows from it. A magnet that holds with more than is told here cannot be left: `pressing`.
    pub magnet_n: f64,
    /// Translational stiffness, in N/m. With 200 the nest never lets go; with
    /// 2,000 it leaves after 12.7 mm of setpoint. A magnet of more than 26.5 N is left with as much more, up to 5,000.
    pub stiffness_n_m: f64,
    /// Speed of the setpoint, in m/s.
    pub speed_m_s: f64,
    /// Distance that the setpoint moves back along the approach, in m.
    pub retreat_m: f64,
    /// Distance that the TCP must have moved back for the nest to count as free, in m.
    pub free_m: f64,
    /// Time allowed after the setpoint has arrived, in s.
    pub settle_s: f64,
}

/// Pull of the paper's magnet, for which the limits were measured, in N.
const USUAL_MAGNET_N: f64 = 26.5;
/// What the estimate of a force may err, beyond what the magnet holds, in N.
const ERROR_N: f64 = 7.5;
/// Time in s, and force in N, that a pull takes from there to what the paper's magnet holds: dry friction of 1 to 2 N m
/// halves its rate, and the tare may be wrong.
const PULL_S: f64 = 0.1;
const PULL_N: f64 = 15.0;

impl Decouple {
    /// Largest force that the arm pulls with for good where a magnet may hold it, in N.
    pub const GRANTED_N: f64 = 20.0;

    /// Force at the TCP that no magnet explains, in N.
    pub fn unexplained_n(&self) -> f64 {
        self.magnet_n + ERROR_N
    }

    /// Stiffness that leaves this magnet, in N/m: it lets go after as much of the setpoint as the paper's.
    pub fn pull_n_m(&self) -> f64 {
        let share = (self.magnet_n / USUAL_MAGNET_N).max(1.0);
        (self.stiffness_n_m * share).min(MAX_STIFFNESS_N_M.max(self.stiffness_n_m))
    }

    /// Time for which the magnet explains more than is [granted](Self::GRANTED_N), in s. The pull rises as fast as the
    /// setpoint stretches the spring; friction may halve the rate of what a stronger magnet needs besides.
    pub fn pull_s(&self) -> f64 {
        let more_n = (self.magnet_n - USUAL_MAGNET_N).max(0.0);
        PULL_S + (PULL_N + 2.0 * more_n) / (self.pull_n_m() * self.speed_m_s)
    }
}

impl Default for Decouple {
    fn default() -> Self {
        Self {
            magnet_n: USUAL_MAGNET_N,
            stiffness_n_m: 2000.0,
            speed_m_s: 0.050,
            retreat_m: 0.050,
            free_m: 0.030,
            settle_s: 3.0,
        }
    }
}
