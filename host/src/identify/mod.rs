//! Identification of a robot from plain data: joint angles, and where the TCP was.
//!
//! Knows no plant, no link and no database, so that it serves any robot's CSV.
//! Data in: [`Experiment`]. Result out: what `map` and its siblings return.

mod data;

pub use data::{Experiment, Observation, Set, Sphere, Target, paper_plate};
