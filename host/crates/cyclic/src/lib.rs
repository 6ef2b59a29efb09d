//! What robot interfaces with a fixed cycle share. A robot sends a state each period; the client answers it.
//!
//! `spherecal-fci` (Franka) and `spherecal-fri` (KUKA) are built on it:
//! - [`wire_enum!`]: enumerations with the maker's numbers and names;
//! - [`Inbox`]: the client's wait for the newest datagram, without allocation;
//! - [`Side`] and [`PeriodClock`]: a simulated robot side on a thread of its own, paced by the wall clock;
//! - `testing` (feature of the same name): a network that loses, delays and repeats datagrams.

#![forbid(unsafe_code)]

mod clock;
mod inbox;
mod side;
#[cfg(feature = "testing")]
pub mod testing;
mod wire_enum;

pub use clock::PeriodClock;
pub use inbox::{Inbox, SocketError, Wait, io_error};
pub use side::{Published, Side};
