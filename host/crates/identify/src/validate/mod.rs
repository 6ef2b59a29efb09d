//! Validation: how far predicted points lie from measured ones (Table 5 of the
//! paper), for several models on the same measurements.
//!
//! Data in: measured points in the tracker frame, and for each model the points
//! that it predicts in its base frame F0. Data out: [`ValidationTable`], which
//! prints as a table and serialises. Three ways to bring F0 into the tracker
//! frame, because the base is not the model's merit:
//!
//! - [`Alignment::Arcs`] (V1): the base measured by arcs, the paper's protocol;
//! - [`Alignment::BestFit`] (V2): the rigid motion that fits these very points
//!   best, so that only the arm's shape counts;
//! - [`Alignment::Own`] (V3): the base that the model itself identified.

mod table;

pub use table::{Alignment, ModelErrors, Prediction, Statistics, ValidateError, ValidationTable, validate};
