//! Synthetic static experiments: robots whose errors are known, on which
//! estimators are compared.
//!
//! Vocabulary. A *world* is a kind of error ([`World`]); a *truth* is one robot
//! drawn from it ([`Truth`]): geometry, tool, and what no geometric model has.
//! A *trial* is what that robot would have recorded ([`Trial`]): contacts on the
//! paper's grid of 1,843 reachable poses, laser points, arcs, and validation
//! points, as plain data for [`identify`](spherecal_identify), with the truth kept
//! apart for the judge.
//!
//! Nothing here knows plant or controller: no dynamics, the arm is where its
//! errors put it. So one trial takes milliseconds and a study of hundreds is
//! possible ([`compare`]).
//!
//! ```text
//! World ─ draw ─▶ Truth ─ record ─▶ Trial ─ estimators ─▶ ValidationTable ─ medians ─▶ Comparison
//! ```

mod compare;
mod estimators;
mod plans;
mod record;

pub use compare::{Cell, CompareOptions, Comparison, Errors, compare};
pub use estimators::{bound_options, judge};
pub use plans::{Chosen, PlanOptions, PlanRow, PlanTable, compare_plans};
pub use record::{GRID_SPHERES, PlannedPose, Trial, WorldError, paper_poses, record, record_poses};
pub use spherecal_identify::Estimator;
pub use spherecal_sim::worlds::{Recipe, Truth, UnknownWorld, World};
