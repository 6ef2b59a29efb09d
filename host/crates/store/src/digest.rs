//! Digests of stored rows. SQLite's own check finds damaged pages, but not a flipped bit inside a
//! number.

use sha2::{Digest as _, Sha256};
use spherecal_shared::protocol::host::Recording;

use spherecal_model::{LaserShot, Sphere};

/// The first 63 bits of a SHA-256, so that a column of whole numbers can hold them.
pub(super) struct Digest(Sha256);

impl Digest {
    pub(super) fn new() -> Self {
        Self(Sha256::new())
    }

    pub(super) fn text(mut self, text: &str) -> Self {
        self.0.update(text.len().to_le_bytes());
        self.0.update(text.as_bytes());
        self
    }

    pub(super) fn whole(mut self, value: u64) -> Self {
        self.0.update(value.to_le_bytes());
        self
    }

    pub(super) fn numbers<'a>(mut self, values: impl IntoIterator<Item = &'a f64>) -> Self {
        for value in values {
            // SQLite keeps no sign of a zero.
            self.0.update((value + 0.0).to_bits().to_le_bytes());
        }
        self
    }

    pub(super) fn end(self) -> i64 {
        let hash = self.0.finalize();
        let first = hash.iter().take(8).fold(0u64, |sum, byte| sum << 8 | u64::from(*byte));
        (first >> 1) as i64
    }
}

/// Digest of a recording. Every bit of every number counts, except the sign of zero.
pub(super) fn of_recording(r: &Recording) -> i64 {
    let mut digest = Digest::new();
    for whole in [
        u64::from(r.sphere),
        u64::from(r.pose),
        r.start_us,
        r.end_us,
        u64::from(r.count),
        u64::from(r.gaps),
        r.q.len() as u64,
    ] {
        digest = digest.whole(whole);
    }
    for s in r.q.iter().chain(&r.tau) {
        digest = digest.numbers([&s.mean, &s.std, &s.min, &s.max]);
    }
    digest.numbers([&r.tcp_spread_m]).numbers(&r.force_n).end()
}

/// Digest of the laser shots, in order.
pub(super) fn of_laser(shots: &[LaserShot]) -> i64 {
    let mut digest = Digest::new();
    for shot in shots {
        digest = digest.text(&shot.purpose).numbers(&shot.q).numbers(&shot.point_m);
    }
    digest.end()
}

/// Digest of the inputs of a run. `texts` are link, robot, tool, configuration and plan as they are
/// stored.
pub(super) fn of_run(seed: u64, texts: [&str; 5], spheres: &[Sphere]) -> i64 {
    let mut digest = Digest::new().whole(seed);
    for text in texts {
        digest = digest.text(text);
    }
    for sphere in spheres {
        digest = digest
            .whole(sphere.id.into())
            .numbers(&sphere.position_m)
            .numbers([&sphere.sigma_m]);
    }
    digest.end()
}

/// Name of a recording's digest.
pub(super) fn recording_subject(sphere: u32, pose: u32) -> String {
    format!("recording {sphere} {pose}")
}
