//! Synthetic static experiments: compares estimators on robots whose errors are known.
//!
//! Vocabulary. A *world* is a kind of error ([`World`]). A *truth* is one robot drawn from it
//! ([`TrueCell`](spherecal_sim::plant::TrueCell)): geometry, tool, and effects outside any geometric model. A *trial* is what that
//! robot would record ([`Trial`]): contacts on the paper's grid of 1,843 reachable poses, laser
//! points, arcs, and validation points. These are plain data for [`identify`](spherecal_identify);
//! the truth is kept apart for the judge.
//!
//! This module uses neither controller nor dynamics: the arm stands where its
//! errors put it. So one trial takes milliseconds, and a study of hundreds is possible
//! ([`compare`]).
//!
//! ```text
//! World ─ draw ─▶ TrueCell ─ record ─▶ Trial ─ estimators ─▶ ValidationTable ─ medians ─▶ Comparison
//! ```

mod compare;
mod estimators;
mod plans;
mod record;
mod seeds;

pub use compare::{AlignedErrors, CompareOptions, Comparison, RobotErrors, WorldScore, compare, merge_comparison};
pub use estimators::judge;
pub use plans::{Chosen, PlanOptions, PlanRow, PlanTable, PlannedRobot, compare_plans, merge_plans};
pub use record::{
    CONTACT_S, ContactPose, Trial, WorldError, paper_poses, planned_poses, record, record_plant, record_poses,
};
pub use spherecal_sim::worlds::{UnknownWorld, World};
