//! The simulated plant: replaces a real arm behind the drive link.
//!
//! It has an arm whose geometry, tool, masses, gears and sensors are *not* those of the nominal
//! model, a trihedral nest with a magnet at its tool, three precision spheres on a plate that
//! deviates from its nominal pose, and a laser tracker. [`Plant::step`] takes the torques of one
//! control tick and returns only what real hardware shows, [`Sensed`]. [`Plant::truth`] is for
//! tests and figures only: it must never reach the controller, the campaign or the identification.
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
//! Sign of torque, here and on the drive link: `tau` is the torque of the actuator on the link. So
//! an arm at rest measures `gravity(q) − Jᵀ F`, where `F` is the force of the environment on the
//! tool.
//!
//! Each module says what is real physics and what is a simplification: [`contact`] (penalty pads,
//! regularised friction), [`integrate`] (explicit Runge-Kutta in free space, linearly implicit in
//! contact), [`sensors`], [`world`] (error sources), [`tracker`].
//!

mod cable;
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
mod nest_kind;
mod preset;
mod preset_worlds;
mod random;
pub mod sensors;
mod simulation;
mod slow_config;
mod study;
mod thermal;
pub mod tracker;
mod truth;
pub mod world;

pub use config::PlantConfig;
pub use contact::FlatObstacle;
pub use disturb::Disturbance;
pub use error::PlantError;
pub use hand::Hand;
pub use preset::PRESETS;
pub use sensors::{Sensed, TorqueSensorFault};
pub use simulation::Plant;
pub use study::{Rest, StillArm};
pub use tracker::Shot;
pub use truth::Truth;
pub use world::{MAX_SPHERES, TrueCell};
