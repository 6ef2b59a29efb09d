//! The cabinet's side: sends monitoring messages, rates the answers, and lets an arm follow the overlay.
//!
//! Three layers:
//! - [`ArmHardware`]: what moves. [`joint_arm`] makes a simple one for tests; a simulated plant can stand here instead.
//! - [`Cabinet`]: the rules, without socket and clock: session states, quality, safety, the application's motion.
//! - [`CabinetSide`]: UDP and the clock, as a process of its own: a thread, or in tests a part of a simulated network
//!   ([`CabinetConfig::machine`]).
//!
//! # The session
//! ```text
//! MONITORING_WAIT  -- quality at least GOOD ----------------------> MONITORING_READY
//! MONITORING_READY -- the application starts its motion ----------> COMMANDING_WAIT
//! COMMANDING_WAIT  -- mirrored for some cycles, torques present --> COMMANDING_ACTIVE
//! any of them      -- quality below GOOD -------------------------> MONITORING_WAIT
//! COMMANDING_*     -- safety stop, bad command, application ends -> MONITORING_READY
//! ```
//! Leaving COMMANDING_* ends the application's motion: drives off, brakes closed. It has to start the motion anew
//! ([`Controls::command`] off and on again).
//!
//! # What is our choice, because the maker does not state it
//! The quality's thresholds (share of the last 100 answers in time: EXCELLENT 0.9, GOOD 0.75, FAIR 0.5), the number of
//! mirrored cycles (50), that a missing overlay repeats the last one, and that an overlay beyond the joint's torque limit
//! or a position that is not mirrored ends the motion.
//!
//! # The clock
//! One message each period of its machine's time. The thread of an ordinary computer oversleeps now and then. The simulated
//! cabinet then slips: it does not make up for lost periods, and counts them. With [`Tolerance::tolerant`] it also waits
//! up to 100 ms for each answer while commanding, so that a loaded test machine does not cause the faults of a bad
//! network. A real cabinet does neither.

mod arm;
mod cabinet;
mod config;
mod server;

pub use arm::{ArmCommand, ArmHardware, ArmState, joint_arm};
pub use cabinet::Cabinet;
pub use config::{CabinetConfig, START, Tolerance};
pub use server::{CabinetSide, CabinetStatistics, Controls, start_cabinet};
