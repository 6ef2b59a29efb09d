//! Measures whether a peer gets on: by valid frames, and not by bytes.

use std::time::{Duration, Instant};

use spherecal_shared::protocol::frame::{self, Accumulator, Message};

use super::TcpError;
use spherecal_budget::link::{NO_FRAME, NO_FRAME_BYTES, PILED_UP};

/// Bytes and time since the last valid frame.
#[derive(Debug, Default)]
pub(super) struct FrameGap {
    since: Option<Instant>,
    bytes: usize,
    damaged: u32,
}

impl FrameGap {
    /// A valid frame came.
    pub(super) fn valid(&mut self) {
        *self = Self::default();
    }

    /// A damaged frame came.
    pub(super) fn damaged(&mut self) {
        self.damaged = self.damaged.saturating_add(1);
    }

    pub(super) fn came(&mut self, bytes: usize) {
        self.since.get_or_insert_with(Instant::now);
        self.bytes = self.bytes.saturating_add(bytes);
    }

    /// How long the peer may still take for a valid frame; `None` if it has sent nothing since the
    /// last one.
    pub(super) fn left(&self) -> Option<Duration> {
        self.since.map(|since| NO_FRAME.saturating_sub(since.elapsed()))
    }

    /// Fails if the peer has sent bytes for too long, or too many, without a valid frame.
    pub(super) fn check(&self, peer: &str) -> Result<(), TcpError> {
        if self.is_babble() {
            Err(self.babble(peer))
        } else {
            Ok(())
        }
    }

    /// Whether a peer has sent too much without a valid frame.
    pub(super) fn is_babble(&self) -> bool {
        self.bytes > NO_FRAME_BYTES || self.since.is_some_and(|since| since.elapsed() >= NO_FRAME)
    }

    /// The error of a peer that has sent too much without a valid frame.
    pub(super) fn babble(&self, peer: &str) -> TcpError {
        TcpError::Babble {
            peer: peer.to_owned(),
            bytes: self.bytes,
            seconds: self.since.map_or(0.0, |since| since.elapsed().as_secs_f64()),
            damaged: self.damaged,
        }
    }
}

/// Looks for valid frames in bytes that somebody else decodes.
pub(super) struct FrameWatch {
    /// Key of the message that the peer is to send; `None`: whoever decodes it closes the connection for another one.
    key: Option<[u8; 8]>,
    accumulator: Accumulator,
    pub(super) progress: FrameGap,
}

impl FrameWatch {
    /// Nothing has come yet from a peer that is to send messages of this type.
    pub(super) fn of<M: Message>() -> Self {
        Self::for_key(Some(M::KEY))
    }

    pub(super) fn for_key(key: Option<[u8; 8]>) -> Self {
        Self {
            key,
            accumulator: Accumulator::default(),
            progress: FrameGap::default(),
        }
    }

    /// Looks at bytes; whether a valid frame with the message came. One with another message is progress: a peer of another
    /// version is told so. Zero bytes alone (end marks) are no progress, and no noise: a host
    /// that waits sends one each period.
    pub(super) fn look(&mut self, bytes: &[u8]) -> bool {
        let Self {
            key,
            accumulator,
            progress,
        } = self;
        let mut valid = false;
        let told = bytes.iter().filter(|byte| **byte != 0).count();
        if told > 0 {
            progress.came(told);
        }
        for byte in bytes {
            accumulator.push(*byte, &mut |frame| match frame.and_then(frame::open) {
                Ok((header, _)) => {
                    valid |= key.is_none_or(|key| header.key == key);
                    progress.valid();
                }
                Err(_) => progress.damaged(),
            });
        }
        valid
    }
}

/// Counts the messages of a peer that sends one a period.
pub(super) struct Rate {
    start: Instant,
    period: Duration,
    came: u64,
}

impl Rate {
    /// Counts from now on.
    pub(super) fn new(period: Duration) -> Self {
        Self {
            start: Instant::now(),
            period,
            came: 0,
        }
    }

    /// One message came. Fails if there are far more than one a period.
    pub(super) fn count(&mut self, peer: &str, what: &'static str) -> Result<(), TcpError> {
        self.came = self.came.saturating_add(1);
        if self.came <= PILED_UP {
            return Ok(());
        }
        let periods = self.start.elapsed().as_micros() / self.period.as_micros().max(1);
        let most = u64::try_from(periods).unwrap_or(u64::MAX).saturating_mul(2);
        if self.came - PILED_UP <= most {
            return Ok(());
        }
        Err(TcpError::Flood {
            peer: peer.to_owned(),
            what,
            count: self.came,
            seconds: self.start.elapsed().as_secs_f64(),
        })
    }
}

#[cfg(test)]
mod tests {
    use spherecal_shared::protocol::drive::{DriveCommand, DriveState};

    use super::*;

    // Fails if noise is taken for progress, if end marks alone are taken for noise, if a frame does not end the count, or
    // if one with another message earns a place.
    #[test]
    fn only_valid_frames_are_progress() {
        let mut watch = FrameWatch::of::<DriveState>();
        watch.look(&[0; 64]);
        assert!(watch.progress.left().is_none(), "end marks are no noise");
        let noise = vec![7; NO_FRAME_BYTES / 2];
        watch.look(&noise);
        watch.look(&[0]);
        assert!(watch.progress.check("a").is_ok());
        watch.look(&noise);
        watch.look(&[0]);
        watch.look(&[9]);
        let said = watch.progress.check("the host at a").expect_err("too much").to_string();
        assert!(
            said.contains("the host at a") && said.contains("2 damaged") && said.contains("no valid frame"),
            "{said}"
        );
        let mut out = [0; frame::MAX_FRAME];
        let other = frame::encode(&DriveCommand::default(), 0, 0, &mut out).expect("it fits");
        watch.look(&[0]);
        assert!(!watch.look(&out[..other]));
        assert!(watch.progress.left().is_none());
        let length = frame::encode(&DriveState::default(), 0, 0, &mut out).expect("it fits");
        watch.look(&[0]);
        assert!(watch.look(&out[..length]));
        assert!(watch.progress.left().is_none() && watch.progress.check("a").is_ok());
    }

    // Fails if a peer may send without end, or if what piled up while this side stood is a flood.
    #[test]
    fn a_flood_is_told_from_a_pile() {
        let mut rate = Rate::new(Duration::from_secs(1000));
        for _ in 0..PILED_UP {
            rate.count("a", "drive states").expect("a pile");
        }
        let said = rate.count("tcp:a", "drive states").expect_err("a flood").to_string();
        assert!(said.contains("tcp:a") && said.contains("drive states"), "{said}");
    }
}
