//! The planner: chooses where the arm touches, and in which poses it is recorded.
//!
//! First step of the data's path: robot, tool and cell in, [`Plan`] out. The campaign sends it pose
//! by pose.
//!
//! ```text
//!  Cell (plate, spheres, rules) ─▶ grid (Section 4.2 of the paper) ────────┐
//!   Chain (FK, IK, Jacobian)    ─▶ path (continuous, within limits)        ├▶ order, travel ─▶ Plan
//!   structured model ─▶ candidates ─▶ optimal (error left in the workspace) ┘
//! ```
//!
//! [`design`] is the default: the poses with the smallest predicted TCP error. [`paper_plan`] is
//! the paper's grid, [`spread_plan`] a thinned one.
//!
//! If the plate is out of reach, [`suggest`] finds a better placement.
//!
//! This crate does not know the plant: plans use the nominal robot and the nominal positions of the
//! spheres. [`teach`] adds the operator's error. [`Scene`] plans the moves between what the plan lists:
//! clear of spheres, plate and arm, also after a fault.

mod advice;
mod bounds;
mod build;
mod candidates;
mod cell;
mod contact_mass;
mod design;
mod design_problem;
mod design_request;
mod error;
mod grid;
pub mod laser;
mod laser_spread;
mod optimal;
mod order;
mod path;
mod place;
mod retreat;
mod scene;
mod selection;
mod start;
#[cfg(test)]
mod test_support;
mod times;
mod travel;
mod types;
mod way;

pub use advice::{Advised, PoseAdvice};
pub use bounds::Bounds;
pub use build::{PlanRequest, paper_plan, plan, spread_plan};
pub use candidates::Range;
pub use cell::{Cell, Obstacles, PlatePose};
pub use contact_mass::Contact;
pub use design::{design, design_for, predicted_accuracy};
pub use design_request::{CONTACTS, DesignRequest, PATIENCE};
pub use error::PlanError;
pub use grid::{Grid, GridPose};
pub use path::{CollisionObject, Obstacle, Rules};
pub use place::suggest;
pub use scene::Scene;
pub use start::home;
pub use times::{robot_time, second_visits, teach};
pub use types::{Accuracy, Plan, PlannedPose, Rejection, Visit, Waypoint};
