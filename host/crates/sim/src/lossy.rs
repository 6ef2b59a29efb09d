//! A host link that deliberately loses, repeats, delays and damages frames.
//!
//! ```text
//!   campaign ─ HostEndpoint ──▶ LossyDevice { channel down, channel up } ──▶ any Device
//! ```
//!
//! Each direction is a separate channel with its own random draws. So the fate of a frame depends
//! only on the seed and on the frames before it. The channel works on bytes, between the endpoint
//! and any device: a cell in this process, QEMU, or the far end of a socket.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use std::sync::{Arc, Mutex, PoisonError};

use spherecal_link::{Device, Injected, LinkError, Lossy};

/// Largest additional delay of a frame that is held back, in µs.
const LATE_MOST_US: u64 = 20_000;
/// Largest delay of a duplicate, in µs.
const AGAIN_MOST_US: u64 = 50_000;
/// Bytes kept without an end of frame: more than any frame has.
const FRAGMENT_MOST: usize = 1 << 14;

/// Counts of the changed frames so far; copies share them.
#[derive(Clone, Debug, Default)]
pub struct InjectedCounter(Arc<Mutex<Injected>>);

impl InjectedCounter {
    /// What was done so far.
    pub fn get(&self) -> Injected {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes what was done so far.
    pub(crate) fn set(&self, injected: Injected) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = injected;
    }
}

fn draws(config: Lossy, stream: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    rng.set_stream(stream);
    rng
}

#[derive(Clone, Debug)]
struct LossyDirection {
    config: Lossy,
    rng: ChaCha8Rng,
    fragment: Vec<u8>,
    late: Vec<(u64, Vec<u8>)>,
    injected: Injected,
}

impl LossyDirection {
    fn new(config: Lossy, stream: u64) -> Self {
        Self {
            config,
            rng: draws(config, stream),
            fragment: Vec::new(),
            late: Vec::new(),
            injected: Injected::default(),
        }
    }

    fn turn(&mut self, config: Lossy, stream: u64) {
        self.config = config;
        self.rng = draws(config, stream);
    }

    /// Takes `bytes` at `now_us`; appends to `out` what arrives at that time.
    fn pass(&mut self, now_us: u64, bytes: &[u8], out: &mut Vec<u8>) {
        // Delayed frames that are due come first.
        self.late.sort_by_key(|(due, _)| *due);
        let due = self.late.partition_point(|(due, _)| *due <= now_us);
        for (_, frame) in self.late.drain(..due) {
            out.extend_from_slice(&frame);
        }
        for &byte in bytes {
            self.fragment.push(byte);
            if byte == 0 || self.fragment.len() >= FRAGMENT_MOST {
                let frame = std::mem::take(&mut self.fragment);
                self.frame(now_us, frame, out);
            }
        }
    }

    fn frame(&mut self, now_us: u64, mut frame: Vec<u8>, out: &mut Vec<u8>) {
        self.injected.frames += 1;
        // The same number of draws for every frame, so that the fate of one does not shift the
        // next.
        let [loss, flip, again, late] = self.rng.random::<[f64; 4]>();
        let bit = self.rng.random_range(0..frame.len() * 8);
        let late_us = self.rng.random_range(1..=LATE_MOST_US);
        let again_us = self.rng.random_range(0..=AGAIN_MOST_US);
        if loss < self.config.loss {
            self.injected.lost += 1;
            return;
        }
        if flip < self.config.bit_flip {
            self.injected.flipped += 1;
            if let Some(byte) = frame.get_mut(bit / 8) {
                *byte ^= 1 << (bit % 8);
            }
        }
        if again < self.config.duplication {
            self.injected.duplicated += 1;
            self.late.push((now_us.saturating_add(again_us), frame.clone()));
        }
        if late < self.config.reorder {
            self.injected.reordered += 1;
            self.late.push((now_us.saturating_add(late_us), frame));
        } else {
            out.extend_from_slice(&frame);
        }
    }
}

/// Both directions of a bad host link.
#[derive(Clone, Debug)]
pub struct LossyLink {
    down: LossyDirection,
    up: LossyDirection,
}

impl LossyLink {
    /// A link that is as bad as `config` says.
    pub fn new(config: Lossy) -> Self {
        Self {
            down: LossyDirection::new(config, 1),
            up: LossyDirection::new(config, 2),
        }
    }

    /// Changes the quality to `config` from now on. Delayed frames still arrive.
    pub fn turn(&mut self, config: Lossy) {
        self.down.turn(config, 1);
        self.up.turn(config, 2);
    }

    /// Takes the host's bytes; appends to `out` what reaches the controller at `now_us`.
    pub fn down(&mut self, now_us: u64, bytes: &[u8], out: &mut Vec<u8>) {
        self.down.pass(now_us, bytes, out);
    }

    /// Takes the controller's bytes; appends to `out` what reaches the host at `now_us`.
    pub fn up(&mut self, now_us: u64, bytes: &[u8], out: &mut Vec<u8>) {
        self.up.pass(now_us, bytes, out);
    }

    /// What was done to frames so far.
    pub fn injected(&self) -> Injected {
        self.down.injected.plus(self.up.injected)
    }
}

/// A device behind a bad host link.
pub struct LossyDevice<D: Device> {
    inner: D,
    link: LossyLink,
    bytes_down: Vec<u8>,
    bytes_up: Vec<u8>,
    counter: InjectedCounter,
}

impl<D: Device> LossyDevice<D> {
    /// Puts a bad link before `inner`.
    pub fn new(inner: D, config: Lossy) -> Self {
        Self {
            inner,
            link: LossyLink::new(config),
            bytes_down: Vec::new(),
            bytes_up: Vec::new(),
            counter: InjectedCounter::default(),
        }
    }

    /// What was done to frames; the handle stays good.
    pub fn injected(&self) -> InjectedCounter {
        self.counter.clone()
    }
}

impl<D: Device> Device for LossyDevice<D> {
    fn waits(&self) -> bool {
        self.inner.waits()
    }

    fn simulated(&self) -> Option<bool> {
        self.inner.simulated()
    }

    fn now_us(&self) -> u64 {
        self.inner.now_us()
    }

    fn ticks(&self) -> u64 {
        self.inner.ticks()
    }

    fn step(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        self.bytes_down.clear();
        self.bytes_up.clear();
        self.link.down(self.inner.now_us(), down, &mut self.bytes_down);
        self.inner.step(&self.bytes_down, &mut self.bytes_up)?;
        self.link.up(self.inner.now_us(), &self.bytes_up, up);
        self.counter.set(self.link.injected());
        Ok(())
    }

    fn move_plate(&mut self, place: u32) -> bool {
        self.inner.move_plate(place)
    }

    fn monitor(&self) -> Option<spherecal_link::native::Monitor> {
        self.inner.monitor()
    }

    fn keep_alive(&mut self, keep_alives: &spherecal_link::KeepAlives) {
        self.inner.keep_alive(keep_alives);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A device that says what it hears.
    #[derive(Default)]
    struct Echo(u64);

    impl Device for Echo {
        fn now_us(&self) -> u64 {
            self.0 * 1000
        }

        fn ticks(&self) -> u64 {
            self.0
        }

        fn step(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
            self.0 += 1;
            up.extend_from_slice(down);
            Ok(())
        }
    }

    fn echoed(config: Lossy, frames: u32) -> (Vec<Vec<u8>>, Injected) {
        let mut device = LossyDevice::new(Echo::default(), config);
        let mut heard = Vec::new();
        for k in 0..frames + 200 {
            let frame = [(k % 251) as u8 + 1, (k / 251) as u8 + 1, 9, 9, 9, 0];
            let down: &[u8] = if k < frames { &frame } else { &[] };
            device.step(down, &mut heard).expect("an echo does not fail");
        }
        let split = heard.split_inclusive(|b| *b == 0).map(<[u8]>::to_vec).collect();
        (split, device.injected().get())
    }

    #[test]
    fn a_good_link_changes_nothing() {
        let (heard, injected) = echoed(Lossy::default(), 400);
        assert_eq!(heard.len(), 400);
        assert!(heard.windows(2).all(|w| w[0] != w[1]));
        assert_eq!((injected.frames, injected.lost, injected.flipped), (800, 0, 0));
    }

    // Fails if a share of the frames is treated in another way than requested, if a fate depends on
    // anything but the seed, or if the counts are wrong.
    #[test]
    fn what_is_asked_for_happens_and_is_counted() {
        let config = Lossy {
            loss: 0.2,
            duplication: 0.1,
            reorder: 0.1,
            bit_flip: 0.05,
            seed: 3,
        };
        let (heard, injected) = echoed(config, 5000);
        let share = |count: u64| count as f64 / injected.frames as f64;
        assert!((share(injected.lost) - 0.2).abs() < 0.02, "{injected:?}");
        assert!((share(injected.duplicated) - 0.08).abs() < 0.02, "{injected:?}");
        assert!((share(injected.reordered) - 0.08).abs() < 0.02, "{injected:?}");
        assert!((share(injected.flipped) - 0.04).abs() < 0.02, "{injected:?}");
        let out_of_order = heard
            .windows(2)
            .filter(|w| w[0].len() == 6 && w[1].len() == 6)
            .filter(|w| (w[0][1], w[0][0]) > (w[1][1], w[1][0]))
            .count();
        assert!(out_of_order > 100, "{out_of_order}");
        assert_eq!(echoed(config, 5000).0, heard);
        let other = Lossy { seed: 4, ..config };
        assert_ne!(echoed(other, 5000).0, heard);
    }
}
