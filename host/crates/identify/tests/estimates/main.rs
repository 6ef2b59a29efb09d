//! Estimators on arms that the tests draw: causes, several targets.

mod causes;
mod targets;
mod zeros;
