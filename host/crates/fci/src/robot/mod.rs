//! The robot side: speaks the protocol as a Panda (versions 4 and 5) or an FR3 (versions 6 to 10).
//!
//! Three layers:
//! - [`ArmHardware`]: what moves. One step a millisecond: a command in, a measurement out. [`joint_arm`] makes a simple one for
//!   tests; a simulated plant can stand here instead.
//! - [`RobotSupervisor`]: the robot's rules, without sockets and clock: modes, reflexes, limits, success rate.
//! - [`RobotSide`]: TCP, UDP and the 1 kHz clock, as a process of its own: a thread, or in tests a part of a simulated
//!   network ([`RobotConfig::machine`]).
//!
//! # Which rules are kept
//! | rule | error (the robot's own name) |
//! |---|---|
//! | torque changes by more than 1,000 N m/s | `controller_torque_discontinuity` |
//! | commanded torque beyond the joint's limit | `tau_j_range_violation` |
//! | joint beyond its position limit | `joint_position_limits_violation` |
//! | joint faster than its limit; FR3: the limit falls near the stops | `joint_velocity_violation` |
//! | external joint torque beyond its upper threshold | `joint_reflex` |
//! | external force beyond its upper threshold | `cartesian_reflex` |
//! | 20 commands missing in a row, or too low a success rate | `communication_constraints_violation` |
//! | a motion generator's command jumps, is too fast or leads beyond a limit | `joint_motion_generator_...`, `cartesian_motion_generator_...` |
//!
//! Not simulated: Cartesian limits, power limit, self-collision, elbow rules, deviation from the path, stiffness settings of the
//! robot's own controllers (both follow the joints), its filters, the thresholds for an accelerating arm, and gravity through
//! the load (the [`ArmHardware`] decides that).
//!
//! # What is our choice, because the maker does not state it
//! The success rate that ends a motion (0.8), the default collision thresholds, the torque beyond the limit as
//! `tau_j_range_violation`, the duration of an error recovery, that a late command counts as missing, and that a missing
//! torque command repeats the last one.
//!
//! # The clock
//! One state each millisecond of its machine's time. The thread of an ordinary computer oversleeps now and then. The
//! simulated robot then slips: it does not make up for lost periods, and counts them ([`RobotStatistics::slipped`]).
//! [`Tolerance::tolerant`] also waits up to 100 ms for the answer to each state of a motion, so that a loaded test
//! machine does not cause the reflexes of a bad network. A real robot does neither.

mod arm;
mod config;
mod generator;
mod kinematics;
mod limits;
mod model;
mod server;
mod session;
mod supervisor;

pub use arm::{ArmCommand, ArmHardware, ArmState, joint_arm};
pub use config::{READY, RobotConfig, Tolerance};
pub use limits::ArmLimits;
pub use model::ModelError;
pub use server::{Controls, RobotSide, RobotStatistics, start_robot};
pub use supervisor::{Finished, RobotSupervisor};

/// The nominal model of the FR3 in URDF, as the maker publishes it: kinematics, inertias, joint limits, and how the
/// velocity limits fall near the stops. The answer to `GetRobotModel`. A Panda has no such request.
pub const FR3_URDF: &str = include_str!("../../data/fr3.urdf");
