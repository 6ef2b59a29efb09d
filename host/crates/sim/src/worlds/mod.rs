//! Robots whose errors are known, drawn for static studies of estimators.
//!
//! Vocabulary. A *world* is a kind of error ([`World`], W0 to W4); a *truth* is
//! one robot drawn from it ([`Truth`]): geometry, tool, and what no geometric
//! model has.
//!
//! There are no dynamics here: the arm is where its errors put it, so that a
//! study of hundreds of robots takes minutes.

mod draw;
mod truth;

pub use draw::{Recipe, UnknownWorld, World, draw};
pub use truth::{Evaluator, JointErrors, Truth, Wave};
