//! The two links: what is said on them, and how it is framed.
//!
//! ```text
//!   host ──[host link: Downlink / Uplink]── controller ──[drive link: DriveCommand / DriveState]── arm or plant
//! ```
//!
//! Messages are postcard; a frame adds the message's schema key, a sequence
//! number, the sender's time and a CRC-32C, and is COBS-encoded with a zero
//! byte behind it ([`frame`]). The types are the protocol: change one and its
//! key changes, so that two versions refuse each other instead of misreading.

pub mod drive;
pub mod frame;
pub mod host;
pub mod lockstep;

/// Version of the meaning of the messages; raised when a field keeps its shape
/// but changes what it says.
pub const PROTOCOL_VERSION: u16 = 1;

/// Key of the layout of all messages together: differs when one of theirs does.
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
        // Turned, so that two messages that swap their keys do not cancel.
        all = all.rotate_left(7) ^ u64::from_le_bytes(keys[k]);
        k += 1;
    }
    all
};
