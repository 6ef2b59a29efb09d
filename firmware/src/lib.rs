//! The real-time controller of spherecal: 1 kHz Cartesian impedance, phases,
//! contact, recording.
//!
//! `no_std`, allocation-free and free of `unsafe`; the same code runs on a
//! Cortex-M7 and in-process on a PC, to the same bits.
//!
//! ```text
//!   host bytes ─▶ HostLink ─▶ commands ─▶ Controller::tick ─▶ torque
//!   host bytes ◀─ HostLink ◀─ events  ◀──┘   ▲ joint state
//! ```
//!
//! [`Controller`] is the control path: a plain synchronous `tick`. [`HostLink`]
//! turns bytes into commands and events into bytes, with acknowledgement and
//! repetition. [`Node`] is both, for whoever runs them in one thread.
#![no_std]

#[cfg(test)]
extern crate std;

mod controller;
mod link;
mod node;

pub use controller::Controller;
pub use link::HostLink;
pub use node::Node;
