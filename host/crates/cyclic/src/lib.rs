//! What robot interfaces with a fixed cycle share. A robot sends a state each period; the client answers it.
//!
//! `spherecal-fci` (Franka), `spherecal-fri` (KUKA) and `spherecal-ur` (Universal Robots) are built on it:
//! - [`wire_enum!`]: enumerations with the maker's numbers and names;
//! - [`Inbox`]: the client's wait for the newest datagram, without allocation;
//! - [`Machine`]: time and network of one side; `testing::World` is a virtual one;
//! - [`Process`], [`Side`], [`PeriodClock`] and [`Wire`]: a simulated robot side as a process of its own, and its clients;
//! - `testing` (feature of the same name): a network on a virtual clock that loses, delays and repeats datagrams.

#![forbid(unsafe_code)]

mod clock;
mod inbox;
mod joint_arm;
mod machine;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
mod wire;
mod wire_enum;

pub use clock::PeriodClock;
pub use inbox::{Inbox, SocketError, Wait, io_error};
pub use joint_arm::{JointArm, JointDrive};
pub use machine::{Datagrams, Listener, Machine, Process, Published, Running, Side, Stream, this_machine};
pub use wire::Wire;
