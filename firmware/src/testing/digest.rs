//! A short hash of what the controller does, for golden tests.

use spherecal_shared::protocol::drive::DriveCommand;
use spherecal_shared::protocol::frame::MAX_FRAME;
use spherecal_shared::protocol::host::{Event, Sample};

/// FNV-1a over bytes: it finds an accident, and it needs no crate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Digest(u64);

impl Default for Digest {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Digest {
    /// The hash so far.
    pub(crate) fn value(self) -> u64 {
        self.0
    }

    fn bytes(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }

    /// Adds the bits of numbers.
    pub(crate) fn numbers<'a>(&mut self, values: impl IntoIterator<Item = &'a f64>) {
        for value in values {
            // One zero is as good as the other.
            self.bytes(&(value + 0.0).to_bits().to_le_bytes());
        }
    }

    /// Adds a count.
    pub(crate) fn count(&mut self, value: u64) {
        self.bytes(&value.to_le_bytes());
    }

    /// Adds a command to the drive.
    pub(crate) fn command(&mut self, command: &DriveCommand) {
        self.count(u64::from(command.session));
        self.count(command.tick);
        self.count(u64::from(command.enable));
        self.numbers(&command.tau);
        self.numbers(&command.follow);
    }

    /// Adds an event for the host, as its bytes on the wire.
    pub(crate) fn event(&mut self, event: &Event) {
        let mut buffer = [0; MAX_FRAME];
        self.bytes(postcard::to_slice(event, &mut buffer).expect("a frame holds it"));
    }

    /// Adds a telemetry sample, as its bytes on the wire.
    pub(crate) fn sample(&mut self, sample: &Sample) {
        let mut buffer = [0; MAX_FRAME];
        self.bytes(postcard::to_slice(sample, &mut buffer).expect("a frame holds it"));
    }
}
