//! The real-time controller of spherecal: Cartesian impedance at 1 kHz, the
//! phases of Algorithm 2, contact and recording.
//!
//! The crate is `no_std`, allocates nothing and has no `unsafe` code. The same
//! code runs on a microcontroller and inside a PC process, with the same bits.
//!
//! ```text
//!   host bytes ─▶ HostLink ─▶ commands ─▶ Controller::tick ─▶ torque
//!   host bytes ◀─ HostLink ◀─ events  ◀──┘   ▲ joint state
//! ```
//!
//! [`Controller`] is the control path: a plain synchronous `tick`. [`HostLink`]
//! turns bytes into commands and events into bytes; it acknowledges and repeats.
//! [`Node`] holds both and runs them in one thread. A board runs the link at
//! lower priority than the control path, with queues between them ([`app`]).
//!
//! Inside the tick the safety monitor checks the drive state. [`law`] computes the
//! arm's kinematics and dynamics once, and the torque from a setpoint. The phases
//! move the setpoint through Algorithm 2.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod app;
mod contact;
mod controller;
pub mod link;
mod motion;
mod node;
mod phases;
mod recorder;
mod report;
mod safety;
#[cfg(test)]
mod testing;

pub use controller::{Controller, Stopwatch};
pub use link::HostLink;
pub use node::Node;
pub use report::Report;
pub use spherecal_law as law;
