//! Synthetic static experiments: robots whose errors are known, on which
//! estimators are compared.
//!
//! Vocabulary. A *world* is a kind of error ([`World`]), a robot drawn from it a
//! [`TrueCell`](spherecal_sim::plant::TrueCell), the same that the dynamic plant
//! stands on. A *trial* is what that robot would have recorded ([`Trial`]): contacts on the
//! paper's grid of 1,843 reachable poses, laser points, arcs, and validation
//! points, as plain data for [`identify`](spherecal_identify), with the truth kept
//! apart for the judge.
//!
//! Nothing here knows plant or controller: no dynamics, the arm is where its
//! errors put it. So one trial takes milliseconds and a study of hundreds is
//! possible ([`compare`]).
//!
//! ```text
//! World ─ draw ─▶ TrueCell ─ record ─▶ Trial ─ estimators ─▶ ValidationTable ─ medians ─▶ Comparison
//! ```

mod compare;
mod estimators;
mod plans;
mod record;

pub use compare::{Cell, CompareOptions, Comparison, Errors, compare};
pub use estimators::{Estimator, judge};
pub use plans::{Chosen, PlanOptions, PlanRow, PlanTable, compare_plans};
pub use record::{
    CONTACT_S, GRID_SPHERES, PlannedPose, Trial, WorldError, paper_poses, planned_poses, record, record_poses,
};
pub use spherecal_sim::worlds::{UnknownWorld, World};
