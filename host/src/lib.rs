//! spherecal: a robot calibrates itself by touching precision spheres.
//!
//! The host side of the house. Data flows one way:
//!
//! ```text
//! plan ─▶ campaign ─▶ link ─▶ controller (firmware) ─▶ plant, or a real arm
//! report ◀─ validate ◀─ identify ◀─ store ◀─ campaign
//! ```
//!
//! [`plant`] is the simulated arm; it knows neither link nor campaign, and
//! nothing but encoders, torques and drive status leaves it towards them.
//! [`identify`] works on plain data and serves any robot's CSV.

pub mod campaign;
pub mod cli;
pub mod export;
pub mod faults;
mod halton;
pub mod history;
pub mod hold;
pub mod identify;
pub mod inject;
pub mod input;
pub mod job;
pub mod laser;
pub mod link;
pub mod live;
pub mod plan;
pub mod plant;
pub mod report;
pub mod reproduce;
pub mod robots;
pub mod rpc;
pub mod store;
pub mod study;
pub mod telemetry;
pub mod validate;
pub mod web;
pub mod worlds;
