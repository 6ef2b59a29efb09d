//! What stands where a robot cell does not: the simulated plant, and faults on purpose.
//!
//! ```text
//!   plant ── SimulatedArm (a Drive) ──────┐
//!     │  └── hand-guided arm (a Drive) ───┤
//!     │                                   ├─▶ what spherecal-link sees of a cell
//!     └───── SimulatedTracker             │
//!   inject ─ FaultyCell (a Device) ───────┤
//!          └ HostFaultJournal (a Journal) ┤
//!   lossy ── LossyDevice (a Device) ──────┘
//!   worlds ─ robots with known errors, without dynamics, for studies
//! ```
//!
//! Faults are injected by decorators: nothing below or beside this crate knows
//! of them. Of the plant nothing passes to a controller but what real hardware
//! shows.

mod hand_guided;
pub mod inject;
mod lossy;
pub mod plant;
mod simulated;
mod tracker;
pub mod worlds;

pub use hand_guided::{OperatorCall, hand_guided_arm};
pub use lossy::{Injected, InjectedCounter, Lossy, LossyDevice, LossyError, LossyLink};
pub use simulated::{Disturb, SimulatedArm, SimulatedArmError, simulated_arm};
pub use tracker::SimulatedTracker;
