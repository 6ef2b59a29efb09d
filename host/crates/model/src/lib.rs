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
mod file;
pub mod halton;
pub mod input;
mod new_file;
mod printable;
pub mod robots;
pub mod statistics;
mod toml_words;
mod workspace;

pub use cell::{CalibrationPlate, CellError, MAX_SPHERES, NominalCell, Placement, Sphere};
pub use chain::{Chain, ChainError, TcpPose};
pub use data::{ContactTrace, DataError, Experiment, LaserShot, Observation, Set, Target, TrackerSession, paper_plate};
pub use encoding::EncodingError;
pub use file::{FileError, open_regular, read_text};
pub use new_file::{NewFile, write_file};
pub use printable::{excerpt, name_of, printable, printable_lines};
pub use spherecal_shared::robot::Pose;
pub use statistics::fit_pose;
pub use toml_words::{TomlError, read_toml};
pub use workspace::{WorkBox, workspace};
