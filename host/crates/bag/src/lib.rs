//! A ROS 2 bag as a table of poses: where the arm rested, and what was measured meanwhile.
//!
//! ```text
//!   bag ─ records ─┬─ measured points, contacts ─▶ targets ─┐
//!                  └─ joint states ─▶ rests ────────────────┴─▶ poses ─▶ CSV
//! ```
//!
//! | type | what it is |
//! |---|---|
//! | `sensor_msgs/msg/JointState` | joint angles in rad, by name; `effort` where the caller says that it is N m |
//! | `geometry_msgs/msg/PointStamped` | a measured point in m; in a frame `sphere_N` or `PLACE/sphere_N` a contact with sphere N |
//! | `geometry_msgs/msg/PoseStamped`, `TransformStamped`, `PoseArray` (of one pose), `nav_msgs/msg/Odometry` | the same: the position counts, the orientation is left out |
//! | `tf2_msgs/msg/TFMessage` | the same, of the transform between two frames that the caller names |
//! | `std_msgs/msg/Int8` to `Int64`, `UInt8` to `UInt64` | a contact with the sphere of this number |
//!
//! **The pose of a rest.** The arm rests while no joint leaves a band of [`Wanted::rest_rad`] for at least [`REST_S`],
//! and while two joint states follow each other within [`GAP_S`]. A rest with at least one target is one pose. Its joint
//! angles are the mean over the rest's joint states that are at most [`NEAR_S`] from a target; its point is the mean of
//! the rest's points. Targets outside rests are left out and counted.
//!
//! **Times** are those of the headers. Where the targets have no header, or a header's time is zero, all times are those
//! of the recorder.
//!
//! A bag is a file or folder in MCAP or SQLite (`.db3`). A file in MCAP that ends early gives its whole messages.
//!
//! The bag is read twice, as a stream: for the targets, then for the joint states. Memory is that of the targets
//! ([`TARGETS`](spherecal_budget::files::TARGETS)) and of one record ([`RECORD_BYTES`](spherecal_budget::files::RECORD_BYTES)).

mod cdr;
mod error;
mod files;
mod joints;
mod messages;
mod poses;
mod records;
mod rests;
mod sqlite;
mod targets;
mod topics;
mod words;

pub use error::{BadMessage, BagError};
pub use files::is_bag;
pub use poses::{Poses, read_bag};
pub use rests::{GAP_S, NEAR_S, REST_S};
pub use topics::Wanted;

#[cfg(test)]
mod test_bag;
#[cfg(test)]
mod tests;
