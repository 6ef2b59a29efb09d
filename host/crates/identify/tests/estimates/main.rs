//! Estimators on arms that the tests draw: diagnosis, several targets, maps of residuals.

mod diagnosis;
mod residual_map;
mod targets;
