//! Validation: distances of predicted points from measured ones (Table 5 of the paper), for several
//! models on the same measurements.
//!
//! Data in: measured points in the tracker frame, and for each model the points that it predicts in
//! its base frame F0. Data out: [`ValidationTable`], which prints as a table and serialises. F0 is
//! brought into the tracker frame in three ways, because the base is not a property of the arm's
//! model:
//!
//! - [`Alignment::Arcs`] (V1): the base measured by arcs, the paper's protocol;
//! - [`Alignment::BestFit`] (V2): the rigid motion that fits these very points
//!   best, so that only the arm's shape counts;
//! - [`Alignment::Own`] (V3): the base that the model itself identified.

mod table;

pub use table::{Alignment, ErrorStatistics, ModelErrors, Prediction, ValidateError, ValidationTable, validate};
