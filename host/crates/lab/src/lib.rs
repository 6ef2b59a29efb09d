//! Experiments on the whole system and on its estimators.
//!
//! | module | question |
//! |---|---|
//! | [`worlds`] | which estimator, and which plan, is best on robots whose errors are known? |
//! | [`reproduce`] | what does the paper's study give on one robot's recordings? |
//! | [`faults`] | how does a run end after each fault? |
//! | [`soak`] | what grows or drifts over hours of robot time? |
//!
//! [`paper`] is the paper's own estimator, on [`simplex`]. [`shards`] divides the first three over many machines.
//!
//! The program `spherecal-lab` ([`cli`]) runs them; docs/lab.md describes it.

pub mod cli;
mod estimators;
pub mod faults;
mod known_laws;
pub mod paper;
pub mod reproduce;
pub mod shards;
pub mod simplex;
pub mod soak;
pub mod worlds;

pub use estimators::Estimator;
