//! Lock-step exchanges: both links on one pipe of bytes, once per tick.
//!
//! A simulator and a controller that share one pipe (QEMU's standard streams)
//! exchange data in turn. Each exchange carries the frames of the drive link and
//! the pending bytes of the host link, so that a tick takes one blocking read and
//! one write:
//!
//! ```text
//! down  drive u16 LE | host u16 LE |                           | drive frames | host bytes
//! up    drive u16 LE | host u16 LE | tick u32 LE | link u32 LE | drive frames | host bytes
//! ```
//!
//! `drive` and `host` are the lengths of the two parts in bytes. The frames are
//! those of [`frame`](super::frame), with their zero bytes. Down goes a
//! `DriveState`, in the first exchange after a `DriveHello`. Up goes a
//! `DriveCommand`, or nothing from a controller that refuses the drive. `tick` and
//! `link` are the cost of this tick in counts of the controller's stopwatch: that
//! of the control task, and that of decoding and encoding both links. An exchange
//! down with `drive` 0 ends the conversation.

/// Length of the header on the way down, in bytes.
pub const DOWN_HEADER: usize = 4;
/// Length of the header on the way up, in bytes.
pub const UP_HEADER: usize = 12;
/// Most bytes of the host link in one exchange.
pub const MAX_HOST: usize = 8 * super::frame::MAX_FRAME;
/// Most bytes of the drive link in one exchange.
pub const MAX_DRIVE: usize = 1024;
/// Most bytes of an exchange in one direction.
pub const MAX_EXCHANGE: usize = UP_HEADER + MAX_DRIVE + MAX_HOST;

/// Header on the way down.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Down {
    /// Length of the drive frames, in bytes.
    pub drive: u16,
    /// Length of the host bytes, in bytes.
    pub host: u16,
}

/// Header on the way up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Up {
    /// Length of the drive frames, in bytes.
    pub drive: u16,
    /// Length of the host bytes, in bytes.
    pub host: u16,
    /// Counts of the controller's stopwatch spent in the control task.
    pub tick: u32,
    /// Counts spent on decoding and encoding both links.
    pub link: u32,
}

impl Down {
    /// The header as bytes.
    pub fn to_bytes(self) -> [u8; DOWN_HEADER] {
        let ([a, b], [c, d]) = (self.drive.to_le_bytes(), self.host.to_le_bytes());
        [a, b, c, d]
    }

    /// The header from its bytes.
    pub fn from_bytes(bytes: [u8; DOWN_HEADER]) -> Self {
        let [a, b, c, d] = bytes;
        Self {
            drive: u16::from_le_bytes([a, b]),
            host: u16::from_le_bytes([c, d]),
        }
    }

    /// Bytes that follow the header; `None` if they are more than an exchange may have.
    pub fn body(self) -> Option<usize> {
        body(self.drive, self.host)
    }
}

impl Up {
    /// The header as bytes.
    pub fn to_bytes(self) -> [u8; UP_HEADER] {
        let mut out = [0; UP_HEADER];
        let (lengths, costs) = out.split_at_mut(4);
        lengths.copy_from_slice(
            &Down {
                drive: self.drive,
                host: self.host,
            }
            .to_bytes(),
        );
        let (tick, link) = costs.split_at_mut(4);
        tick.copy_from_slice(&self.tick.to_le_bytes());
        link.copy_from_slice(&self.link.to_le_bytes());
        out
    }

    /// The header from its bytes.
    pub fn from_bytes(bytes: [u8; UP_HEADER]) -> Self {
        let [a, b, c, d, t0, t1, t2, t3, l0, l1, l2, l3] = bytes;
        Self {
            drive: u16::from_le_bytes([a, b]),
            host: u16::from_le_bytes([c, d]),
            tick: u32::from_le_bytes([t0, t1, t2, t3]),
            link: u32::from_le_bytes([l0, l1, l2, l3]),
        }
    }

    /// Bytes that follow the header; `None` if they are more than an exchange may have.
    pub fn body(self) -> Option<usize> {
        body(self.drive, self.host)
    }
}

fn body(drive: u16, host: u16) -> Option<usize> {
    let (drive, host) = (usize::from(drive), usize::from(host));
    (drive <= MAX_DRIVE && host <= MAX_HOST).then_some(drive + host)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        // Fails if a field is swapped, cut or lost.
        #[test]
        fn headers_survive(drive: u16, host: u16, tick: u32, link: u32) {
            let down = Down { drive, host };
            prop_assert_eq!(Down::from_bytes(down.to_bytes()), down);
            let up = Up { drive, host, tick, link };
            prop_assert_eq!(Up::from_bytes(up.to_bytes()), up);
            prop_assert_eq!(up.body(), down.body());
        }
    }

    #[test]
    fn an_absurd_length_is_refused() {
        let host = u16::try_from(MAX_HOST).expect("fits");
        assert_eq!(Down { drive: 10, host }.body(), Some(10 + MAX_HOST));
        assert_eq!(
            Down {
                drive: 10,
                host: host + 1
            }
            .body(),
            None
        );
        assert_eq!(Down { drive: u16::MAX, host }.body(), None);
    }
}
