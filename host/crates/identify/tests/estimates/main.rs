//! Estimators on arms that the tests draw: causes, several targets.

mod diagnosis;
mod targets;
