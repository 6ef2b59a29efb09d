//! Identification, planning and the worlds: against the bound, the literature,
//! stored worlds and data of other robots.

mod as_measured;
mod broken;
mod findings;
mod headers;
mod identifiability;
mod laser_validate;
mod mukca;
mod plan_worlds;
mod refusals;
mod reproduce;
mod simplex;
mod verdicts;
mod worlds;
mod worlds_compare;
mod worlds_generator;
mod wrong_priors;
