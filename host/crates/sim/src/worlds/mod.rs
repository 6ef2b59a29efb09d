//! The worlds: kinds of robots whose errors are known, for studies of estimators.
//!
//! A [`World`] is a kind of error (W0 to W5) and the preset of the plant that has
//! it. A robot of a world is a [`TrueCell`](crate::plant::TrueCell) drawn from
//! that preset, the same that the dynamic plant stands on. What it records
//! without dynamics comes from a [`StillArm`](crate::plant::StillArm), so that a
//! study of hundreds of robots takes minutes.

mod world;

pub use world::{UnknownWorld, World};
