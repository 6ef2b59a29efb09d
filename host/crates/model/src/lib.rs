//! Plain types for what is calibrated and from what: the robot's model, its kinematics, and the
//! measured data.
//!
//! ```text
//!   robot file ─▶ robots ─▶ Robot ─▶ Chain (forward and inverse kinematics)
//!   CSV, plate file ─▶ input ─▶ Experiment (joint angles, and where the TCP was)
//! ```
//!
//! Lowest of the host's crates: it depends only on `spherecal-shared`.

mod cell;
pub mod chain;
mod data;
mod encoding;
mod error;
mod file;
mod fit;
pub mod halton;
pub mod input;
mod new_file;
mod printable;
pub mod robots;
mod shot;
pub mod statistics;
mod toml_words;
mod workspace;

pub use cell::{CalibrationPlate, CellError, MAX_SPHERES, NominalCell, Placement, Sphere};
pub use chain::{Chain, ChainError, TcpPose};
pub use data::{Experiment, Observation, Set, Target, paper_plate};
pub use encoding::EncodingError;
pub use error::DataError;
pub use file::{FileError, open_regular, read_text};
pub use fit::fit_pose;
pub use new_file::{NewFile, write_file};
pub use printable::{excerpt, name_of, printable, printable_lines};
pub use shot::{ContactTrace, LaserShot, TrackerSession};
pub use spherecal_shared::robot::Pose;
pub use toml_words::{TomlError, read_toml};
pub use workspace::{WorkBox, workspace};
