//! The simulated plant: what stands behind the drive link when no arm does.
//!
//! An arm whose geometry, tool, masses, gears and sensors are *not* those of
//! the nominal model, a trihedral nest with a magnet at its tool, three
//! precision spheres on a plate that is not quite where it was said to be, and
//! a laser tracker. [`Plant::step`] takes the torques of one control tick and
//! gives back what real hardware shows, [`Sensed`], and nothing else.
//! [`Plant::truth`] is for tests and figures only: it must never reach the
//! controller, the campaign or the identification.
//!
//! ```text
//!  PlantConfig ─▶ TrueCell (drawn from the seed) ─▶ Plant
//!                                                            │ step(tau)
//!        torque ─▶ joint friction ─▶ dynamics ◀─ contact: nest, magnet, plate
//!                                       │
//!                       encoders, velocities, torque sensors ─▶ Sensed
//!                       laser tracker (static) ──────────────▶ Shot
//! ```
//!
//! Sign of torque, here and on the drive link: `tau` is what the actuator
//! exerts on the link, so an arm at rest measures `gravity(q) − Jᵀ F`, with `F`
//! the force that the environment exerts on the tool.
//!
//! What is real physics here and what is a stand-in is said in each module:
//! [`contact`] (penalty pads, regularised friction), [`integrate`] (explicit
//! Runge-Kutta in free space, linearly implicit in contact), [`sensors`],
//! [`world`] (error sources), [`tracker`].

mod check;
pub mod config;
pub mod contact;
mod coupling;
mod delay;
mod disturb;
mod draw;
mod dry_friction;
pub mod error;
mod hand;
pub mod integrate;
mod joint;
mod motion;
mod preset;
mod preset_worlds;
pub mod sensors;
mod simulation;
mod slow_config;
mod study;
mod thermal;
pub mod tracker;
mod truth;
pub mod world;

pub use config::PlantConfig;
pub use disturb::{Disturbance, Obstacle, TorqueSensorFault};
pub use error::PlantError;
pub use hand::Hand;
pub use preset::PRESETS;
pub use sensors::Sensed;
pub use simulation::Plant;
pub use study::{Rest, SeatOn, StillArm};
pub use tracker::Shot;
pub use truth::Truth;
pub use world::{MAX_SPHERES, TrueCell};
