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
//! repetition. [`Node`] is both, for whoever runs them in one thread; a board
//! runs the link below the control path, with queues between them ([`app`]).
//!
//! Inside the tick: [`guard`] admits the drive state, [`law`] computes the arm
//! once and the torque from a setpoint, [`phases`] moves the setpoint through
//! Algorithm 2, with [`motion`], [`contact`] and [`recorder`] as their tools.
//! [`app`] is what a board runs around it.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod app;
mod contact;
mod controller;
pub mod law;
pub mod link;
mod motion;
mod node;
mod phases;
mod recorder;
mod safety;
#[cfg(test)]
mod testing;

pub use controller::Controller;
pub use link::HostLink;
pub use node::Node;
