//! How still a seated arm holds: the means over seconds of a long recording.
//!
//! The paper averages 1 s and says that 30 s would give the same result (its stability analysis).
//! This module measures that. A *hold* is one long recording with the samples of the control loop
//! beside it, cut into *windows* of a second. The *noise* of a window's mean is estimated within
//! the windows, from quarters of a second (longer than the correlation time of the encoders'
//! errors), in windows that are alike. So neither drift from window to window nor a window in
//! which the nest moved enters the noise, and both are judged against it. The TCP is judged, not the
//! joints: joints may drift together while the TCP stays, because the elbow of a redundant arm gives
//! way slowly. That does not harm a recording, because the means of the joints belong together. The
//! TCP comes from a model of the robot, nominal or estimated, never from the plant.

mod measure;
mod report;

use nalgebra::Vector3;
use serde::Serialize;
use spherecal_shared::protocol::host::{Event, Phase};
use spherecal_shared::timing::SampleClock;

use spherecal_campaign::{CampaignObserver, Progress};
use spherecal_link::Arrival;
use spherecal_model::chain::Chain;

pub use measure::{Jump, hold};
pub use report::holds_report;

/// Parts of a window from which the noise of its mean is estimated.
const PARTS: usize = 4;
/// A window whose variance is this many times the median one says nothing of the noise: the nest moved in it. By noise
/// alone (chi-squared, 3 degrees) one in 20,000 is.
const RESTLESS: f64 = 10.0;
/// A difference of the TCP that harms no calibration, in µm: a twentieth of the accuracy that one reaches. A warming arm
/// drifts by 0.3 µm/s, which long holds tell from noise.
pub const HARMLESS_UM: f64 = 10.0;
/// How many sigma a mean may be off. With about forty joints and places at once, three are exceeded
/// by chance.
const SIGMAS: f64 = 4.0;

/// One hold, as its samples arrived.
#[derive(Clone, Debug, Default)]
pub struct Hold {
    /// Id of the sphere.
    pub sphere: u32,
    /// Id of the pose.
    pub pose: u32,
    /// Samples that the controller averaged.
    pub count: u32,
    /// Tick of the last of them.
    pub end_tick: u64,
    /// Mean joint angles by the controller, in rad.
    pub mean: Vec<f64>,
    /// Tick and joint angles (rad) of every sample that arrived.
    pub samples: Vec<(u64, Vec<f64>)>,
    /// Control period of the drive, in s; 0 if the controller did not tell it.
    pub period_s: f64,
}

/// Keeps the samples of recordings and passes everything on to another observer.
pub struct SampleKeeper<'a> {
    inner: &'a mut dyn CampaignObserver,
    joints: usize,
    clock: SampleClock,
    open: Option<Hold>,
    /// Tick and device time (µs) at which the open hold's phase ended.
    left: (u64, u64),
    /// Device time of the last averaged sample, in µs.
    last_us: u64,
    holds: Vec<Hold>,
}

impl<'a> SampleKeeper<'a> {
    /// Wraps an observer, for an arm with `joints` joints.
    pub fn new(inner: &'a mut dyn CampaignObserver, joints: usize) -> Self {
        Self {
            inner,
            joints,
            clock: SampleClock::new(),
            open: None,
            left: (0, 0),
            last_us: 0,
            holds: Vec::new(),
        }
    }

    /// The holds that ended in a recording, in order.
    pub fn finish(mut self) -> Vec<Hold> {
        self.close();
        self.holds
    }

    /// Keeps the open hold. After the last averaged sample the controller pulls at the nest, in the same phase: what
    /// comes then is no part of the hold.
    fn close(&mut self) {
        let Some(mut hold) = self.open.take().filter(|hold| hold.count > 0) else {
            return;
        };
        let (tick, time_us) = self.left;
        let pulled_s = time_us.saturating_sub(self.last_us) as f64 * 1e-6;
        let pulled = if hold.period_s > 0.0 {
            pulled_s / hold.period_s
        } else {
            0.0
        };
        hold.end_tick = tick.saturating_sub(pulled.round() as u64);
        self.holds.push(hold);
    }
}

impl CampaignObserver for SampleKeeper<'_> {
    fn event(&mut self, now_us: u64, arrival: &Arrival) {
        self.clock.observe(&arrival.body);
        match &arrival.body {
            Event::Phase(change) if change.phase == Phase::Recording => {
                self.close();
                self.open = Some(Hold::default());
            }
            Event::Phase(change) if change.from == Phase::Recording => {
                self.left = (change.tick, change.time_us);
            }
            Event::Recording(recording) => {
                self.last_us = recording.end_us;
                if let Some(open) = &mut self.open {
                    open.sphere = recording.sphere;
                    open.pose = recording.pose;
                    open.count = recording.count;
                    open.period_s = self.clock.period_s().unwrap_or_default();
                    open.mean = recording.q.iter().map(|q| q.mean).collect();
                }
            }
            Event::Telemetry(samples) => {
                if let Some(open) = &mut self.open {
                    for sample in samples.iter().filter(|s| s.phase == Phase::Recording) {
                        let q = sample.q.iter().take(self.joints).map(|q| f64::from(*q)).collect();
                        open.samples.push((sample.tick, q));
                    }
                }
            }
            _ => {}
        }
        self.inner.event(now_us, arrival);
    }

    fn progress(&mut self, progress: &Progress) {
        self.inner.progress(progress);
    }

    fn note(&mut self, text: &str) {
        self.inner.note(text);
    }
}

/// How still one quantity was; all in its unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Stillness {
    /// Standard deviation of a window's mean due to noise alone.
    pub noise: f64,
    /// First window's mean less the mean of the hold (of a point: distance).
    pub first: f64,
    /// Largest distance of a window's mean from the mean of the hold.
    pub largest: f64,
    /// Drift per second, by a straight line through the windows (of a point: its length).
    pub drift_per_s: f64,
}

impl Held {
    /// Whether a recording of one window would have given the same TCP as the whole hold, as far as a calibration can
    /// tell: its first window did, within the noise or [`HARMLESS_UM`], and the nest did not move.
    pub fn is_still(&self) -> bool {
        self.first_agrees() && self.jump.is_none()
    }

    /// Whether the first window gave the TCP of the whole hold, within the noise or [`HARMLESS_UM`].
    fn first_agrees(&self) -> bool {
        self.within_noise || self.tcp_um.first <= HARMLESS_UM
    }
}

impl Stillness {
    /// Whether the first window gave the same as the whole hold, within the noise.
    pub fn within(&self) -> bool {
        self.first.abs() <= SIGMAS * self.noise
    }
}

/// How still the arm was in one hold.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Held {
    /// Id of the sphere.
    pub sphere: u32,
    /// Id of the pose.
    pub pose: u32,
    /// Windows that were whole.
    pub windows: usize,
    /// Samples that the controller averaged, and samples that arrived.
    pub samples: (u32, usize),
    /// Joints base to flange, in µrad.
    pub joints_urad: Vec<Stillness>,
    /// TCP, in µm; its noise is that of the distance, rms.
    pub tcp_um: Stillness,
    /// Whether the first window's TCP equals that of the hold, within the noise.
    pub within_noise: bool,
    /// The largest step of the TCP from window to window, if noise does not explain it.
    pub jump: Option<Jump>,
    /// Whether every joint's mean is, too.
    pub joints_within_noise: bool,
    /// Middle of each window since the start, in s.
    #[serde(skip)]
    pub time_s: Vec<f64>,
    /// Window means less the hold's, joint by joint, in µrad.
    #[serde(skip)]
    pub joint_curves_urad: Vec<Vec<f64>>,
    /// TCP less the hold's mean along F0's axes, in µm.
    #[serde(skip)]
    pub tcp_curves_um: [Vec<f64>; 3],
}

/// What an analysis could not do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "the hold at pose {pose} (sphere {sphere}) has {windows} whole windows, but two are needed: hold longer, or find out why \
     telemetry is lost ({heard} of {count} samples arrived)"
)]
pub struct TooShort {
    /// Id of the sphere.
    pub sphere: u32,
    /// Id of the pose.
    pub pose: u32,
    /// Whole windows.
    pub windows: usize,
    /// Samples that arrived.
    pub heard: usize,
    /// Samples averaged by the controller.
    pub count: u32,
}

/// One window: sums over its parts.
#[derive(Clone)]
struct Window {
    sums: [Vec<f64>; PARTS],
    counts: [u32; PARTS],
}

/// Cuts a hold into windows of `window_s` (s) and measures how still
/// it was, with the robot `chain`.
///
/// # Errors
/// [`TooShort`] with fewer than two whole windows.
pub fn analyse(hold: &Hold, chain: &Chain, window_s: f64) -> Result<Held, TooShort> {
    let n = hold.mean.len();
    let ticks = ((window_s / hold.period_s).round() as u64).max(PARTS as u64);
    let start = (hold.end_tick + 1).saturating_sub(u64::from(hold.count));
    let most = (u64::from(hold.count) / ticks) as usize;
    let empty = Window {
        sums: core::array::from_fn(|_| vec![0.0; n]),
        counts: [0; PARTS],
    };
    let mut windows = vec![empty; most];
    for (tick, q) in &hold.samples {
        let Some(since) = tick.checked_sub(start) else { continue };
        let part = (since % ticks * PARTS as u64 / ticks) as usize;
        let Some(window) = windows.get_mut((since / ticks) as usize) else {
            continue;
        };
        window.counts[part] += 1;
        for (sum, q) in window.sums[part].iter_mut().zip(q) {
            *sum += q;
        }
    }
    // A window that lost more than a tenth of a part is left out.
    let least = (ticks as f64 / PARTS as f64 * 0.9) as u32;
    windows.retain(|w| w.counts.iter().all(|c| *c >= least.max(1)));
    if windows.len() < 2 {
        return Err(TooShort {
            sphere: hold.sphere,
            pose: hold.pose,
            windows: windows.len(),
            heard: hold.samples.len(),
            count: hold.count,
        });
    }
    let parts: Vec<[Vec<f64>; PARTS]> = windows
        .iter()
        .map(|w| core::array::from_fn(|p| w.sums[p].iter().map(|s| s / f64::from(w.counts[p])).collect()))
        .collect();
    let time_s: Vec<f64> = (0..parts.len()).map(|k| (k as f64 + 0.5) * window_s).collect();
    let joints: Vec<(Stillness, Vec<f64>)> = (0..n)
        .map(|j| {
            let of: Vec<[f64; PARTS]> = parts.iter().map(|w| core::array::from_fn(|p| w[p][j] * 1e6)).collect();
            axis(&of, &time_s)
        })
        .collect();
    let points: Vec<[Vector3<f64>; PARTS]> = parts
        .iter()
        .map(|w| core::array::from_fn(|p| chain.pose(&w[p]).position * 1e6))
        .collect();
    let axes: [(Stillness, Vec<f64>); 3] = core::array::from_fn(|k| {
        let of: Vec<[f64; PARTS]> = points.iter().map(|w| core::array::from_fn(|p| w[p][k])).collect();
        axis(&of, &time_s)
    });
    let length = |f: &dyn Fn(&Stillness) -> f64| axes.iter().map(|(s, _)| f(s).powi(2)).sum::<f64>().sqrt();
    let tcp_um = Stillness {
        noise: length(&|s| s.noise),
        first: length(&|s| s.first),
        largest: (0..time_s.len())
            .map(|k| axes.iter().map(|(_, curve)| curve[k].powi(2)).sum::<f64>().sqrt())
            .fold(0.0, f64::max),
        drift_per_s: length(&|s| s.drift_per_s),
    };
    let means: Vec<Vector3<f64>> = points
        .iter()
        .map(|w| w.iter().sum::<Vector3<f64>>() / PARTS as f64)
        .collect();
    Ok(Held {
        jump: measure::jump(&means, &time_s, tcp_um.noise),
        sphere: hold.sphere,
        pose: hold.pose,
        windows: time_s.len(),
        samples: (hold.count, hold.samples.len()),
        within_noise: tcp_um.within(),
        joints_within_noise: joints.iter().all(|(s, _)| s.within()),
        joints_urad: joints.iter().map(|(s, _)| *s).collect(),
        tcp_um,
        time_s,
        joint_curves_urad: joints.into_iter().map(|(_, curve)| curve).collect(),
        tcp_curves_um: axes.map(|(_, curve)| curve),
    })
}

/// One coordinate: its stillness, and the windows' means less the mean of all.
fn axis(windows: &[[f64; PARTS]], time_s: &[f64]) -> (Stillness, Vec<f64>) {
    let means: Vec<f64> = windows.iter().map(|w| w.iter().sum::<f64>() / PARTS as f64).collect();
    let mean = means.iter().sum::<f64>() / means.len() as f64;
    let mut inside: Vec<f64> = windows
        .iter()
        .zip(&means)
        .map(|(w, m)| w.iter().map(|x| (x - m).powi(2)).sum::<f64>() / (PARTS - 1) as f64)
        .collect();
    inside.sort_by(f64::total_cmp);
    let most = RESTLESS * inside[inside.len() / 2];
    inside.retain(|variance| *variance <= most);
    let inside = inside.iter().sum::<f64>() / inside.len().max(1) as f64;
    let curve: Vec<f64> = means.iter().map(|m| m - mean).collect();
    let middle = time_s.iter().sum::<f64>() / time_s.len() as f64;
    let spread: f64 = time_s.iter().map(|t| (t - middle).powi(2)).sum();
    let drift: f64 = time_s.iter().zip(&curve).map(|(t, c)| (t - middle) * c).sum();
    let stillness = Stillness {
        noise: (inside / PARTS as f64).sqrt(),
        first: curve.first().copied().unwrap_or_default(),
        largest: curve.iter().fold(0.0, |m, c| m.max(c.abs())),
        drift_per_s: drift / spread.max(1e-12),
    };
    (stillness, curve)
}

#[cfg(test)]
mod tests;
