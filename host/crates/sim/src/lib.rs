//! Simulates a robot cell, and injects faults.
//!
//! ```text
//!   plant ── SimulatedArm (a Drive) ──────┐
//!     │  ├── hand-guided arm (a Drive) ───┤
//!     │  ├── RobotArm: behind the robot sides of spherecal-fci and spherecal-fri
//!     │  └── UrArm: behind the robot side of spherecal-ur
//!     │                                   ├─▶ what spherecal-link sees of a cell
//!     └───── SimulatedTracker             │
//!   inject ─ FaultyCell (a Device) ───────┤
//!          └ HostFaultJournal (a Journal) ┤
//!   lossy ── LossyDevice (a Device) ──────┘
//!   worlds ─ robots with known errors, without dynamics, for studies
//! ```
//!
//! Decorators inject the faults: no crate below or beside this one knows of them. The plant passes
//! to a controller only what real hardware shows.

mod guided;
mod hand_guided;
pub mod inject;
mod lossy;
pub mod plant;
mod robot_side;
mod simulated;
mod ur_arm;
pub mod worlds;

pub use guided::GuidedArm;
pub use hand_guided::{OperatorCall, hand_guided_arm};
pub use lossy::{InjectedCounter, LossyDevice, LossyLink};
pub use robot_side::RobotArm;
pub use simulated::{Disturb, SimulatedArm, SimulatedArmError, SimulatedTracker, simulated_arm};
pub use ur_arm::{UrArm, with_ur_motors};
