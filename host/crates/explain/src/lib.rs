//! Why a table of poses does not fit a robot: a search over the mistakes that people make.
//!
//! A *hypothesis* is a correction of the table ([`Adjustments`]), of the tool, or another robot. Each is tried by a fit of
//! its own: base, tool and joint offsets, then also the joints' origins, all with priors, so that a fit cannot bend a wrong
//! hypothesis into a right one. Its *score* is the median distance of the TCP from its targets.
//!
//! ```text
//!   all hypotheses ─ few rows, offsets ─▶ the best ─ more rows, origins ─▶ scores ─▶ named, or none
//! ```
//!
//! A hypothesis is named if its score is less than [`CLEAR`] of that of the table as it is, and below [`GOOD_M`]. All
//! within [`TIE`] of the best are named with it: the data do not tell them apart. Where no single one is named, pairs are
//! tried.
//!
//! The same fit takes the motion of sliding joints, and of a trunk that several chains share, out of measured points
//! ([`Slides`]).

mod fit;
mod hypotheses;
mod rows;
mod search;
mod slides;
mod words;

pub use slides::{ChainRows, Slides, SlidesError, hinges, observations};

use nalgebra::Vector3;
use spherecal_model::input::Adjustments;
use spherecal_model::robots::{JointPath, RobotModel};
use spherecal_model::{Observation, Sphere};

/// Largest score of a named hypothesis in shares of the table's own. With this, [`GOOD_M`] and [`TIE`] 273 of 277 single
/// mistakes of four arms are named, and nothing is said of 200 sound tables (`tests.rs`).
pub const CLEAR: f64 = 0.3;
/// Largest score of a named hypothesis, in m: what an arm without any calibration may leave.
pub const GOOD_M: f64 = 8e-3;
/// Scores within this factor of the best are as good.
pub const TIE: f64 = 2.0;
/// Median distance (m) below which measured points are the nominal model's own: controllers write them to 1 to 10 µm, and the
/// best real arm is 0.1 mm off.
pub const READOUT_M: f64 = 5e-6;
/// A joint that moves by less than this (rad, 2 degrees) says nothing about its neighbours: it moves a TCP at 0.5 m by 17 mm, and
/// the errors of an arm as much.
pub const STILL_RAD: f64 = 0.035;

/// A table and the robot that it should be of.
#[derive(Clone, Debug)]
pub struct Subject<'a> {
    /// The robot's joints, root to flange.
    pub path: JointPath,
    /// Name of the robot.
    pub robot: String,
    /// TCP in the flange frame, in m.
    pub tool: Vector3<f64>,
    /// The rows: joint columns of the path, and targets.
    pub observations: &'a [Observation],
    /// Certified spheres of the plate.
    pub spheres: &'a [Sphere],
}

impl<'a> Subject<'a> {
    /// The subject of a robot and rows with the angles of its table.
    pub fn new(model: &RobotModel, observations: &'a [Observation], spheres: &'a [Sphere]) -> Self {
        Self {
            path: model.table_path(),
            robot: model.robot.name.as_str().to_owned(),
            tool: model.tool.tcp(),
            observations,
            spheres,
        }
    }
}

/// A hypothesis that fits.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// What would be wrong, in words.
    pub words: String,
    /// The options of `identify` that correct it.
    pub options: String,
    /// The correction of the table.
    pub adjust: Adjustments,
    /// Another TCP in the flange frame, in m.
    pub tool: Option<[f64; 3]>,
    /// Another built-in robot.
    pub robot: Option<&'static str>,
    /// Median distance of the TCP from its targets, in m.
    pub score_m: f64,
}

/// What was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Explanation {
    /// Median distance of the TCP from its targets with the table as it is, after a fit of the geometry, in m.
    pub own_m: f64,
    /// Whether the measured points are those of the nominal model itself.
    pub readout: bool,
    /// Hypotheses that fit equally well, best first; empty where none wins clearly.
    pub found: Vec<Finding>,
    /// Number of hypotheses that were tried.
    pub tried: usize,
    /// Joints (from 0) that hardly move, with their range in rad.
    pub still: Vec<(usize, f64)>,
}

/// Searches for what is wrong with a table. Tables with fewer than ten usable rows are not searched: too many
/// hypotheses fit them.
pub fn explain(subject: &Subject<'_>) -> Explanation {
    search::search(subject)
}

/// What can be told of a table without a search: whether its points are the nominal model's own, and which joints hardly
/// move.
pub fn look(subject: &Subject<'_>) -> Explanation {
    search::look(subject)
}

#[cfg(test)]
mod tests;
