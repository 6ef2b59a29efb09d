//! Experiments on the whole system and on its estimators.
//!
//! | module | question |
//! |---|---|
//! | [`worlds`] | which estimator, and which plan, is best on robots whose errors are known? |
//! | [`reproduce`] | what does the paper's study give on one robot's recordings? |
//! | [`faults`] | how does a run end after each fault? |
//! | [`soak`] | what grows or drifts over hours of robot time? |
//! | [`stability`] | how still does a seated arm hold? |
//!
//! [`shards`] divides the first three over many machines.
//!
//! The highest of the host's crates below the command line.

pub mod faults;
pub mod reproduce;
pub mod shards;
pub mod soak;
pub mod stability;
pub mod worlds;
