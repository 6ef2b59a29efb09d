//! The messages of the two links and their framing.
//!
//! ```text
//!   host ──[host link: Downlink / Uplink]── controller ──[drive link: DriveCommand / DriveState]── arm or plant
//! ```
//!
//! Messages are encoded by postcard. A frame adds the schema key of the message, a
//! sequence number, the sender's time and a CRC-32C; it is COBS-encoded and ends
//! with a zero byte ([`frame`]). The types define the protocol: a change of a type
//! changes its key, so that two versions refuse each other instead of
//! misunderstanding each other.

pub mod drive;
pub mod frame;
pub mod host;
pub mod lockstep;

/// Version of the meaning of the messages. Raise it when a field keeps its type
/// but changes its meaning.
pub const PROTOCOL_VERSION: u16 = 2;

/// Key of the layout of all messages together: it changes when one layout does.
pub const SCHEMA: u64 = {
    use drive::{DriveCommand, DriveHello, DriveState};
    use frame::Message;
    use host::{Downlink, Uplink};
    let keys = [
        DriveHello::KEY,
        DriveState::KEY,
        DriveCommand::KEY,
        Downlink::KEY,
        Uplink::KEY,
    ];
    let (mut all, mut k) = (0u64, 0);
    while k < keys.len() {
        // Rotated, so that two messages that swap their keys do not cancel.
        all = all.rotate_left(7) ^ u64::from_le_bytes(keys[k]);
        k += 1;
    }
    all
};
