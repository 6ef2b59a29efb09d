//! The observer that writes telemetry down and keeps the force of every contact.

use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use spherecal_shared::protocol::host::{Event, Phase, Sample};
use spherecal_shared::timing::SampleClock;

use super::writer::{TelemetryError, TelemetrySample, TelemetryWriter};
use crate::{Moved, Observer, Progress};
use spherecal_link::Arrival;

/// How much of a contact is kept before and after its trigger, in µs.
const KEPT_US: u64 = 1_500_000;
/// Samples of an approach kept at most.
const KEPT_SAMPLES: usize = 6000;

/// The force against the approach around one contact.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Trace {
    /// Id of the sphere.
    pub sphere: u32,
    /// Device time of the trigger, in s.
    pub trigger_s: f64,
    /// Device time, in s, and force against the approach, in N.
    pub samples: Vec<(f64, f64)>,
}

/// One sample of an approach: time (µs), force (N) and setpoint (m) in F0.
type Kept = (u64, [f32; 3], [f32; 3]);

/// An observer around another: telemetry goes to a file on its way.
pub struct TelemetryRecorder<O: Observer> {
    inner: O,
    joints: usize,
    writer: Option<TelemetryWriter<BufWriter<File>>>,
    path: PathBuf,
    problem: Option<String>,
    /// Device time of each sample.
    clock: SampleClock,
    recent: VecDeque<Kept>,
    open: Option<(u32, u64)>,
    traces: Vec<Trace>,
}

impl<O: Observer> TelemetryRecorder<O> {
    /// Watches for `inner`, and writes `telemetry.mcap` (or, where there is one
    /// from an earlier session, `telemetry-2.mcap` and so on) into `directory`.
    pub fn new(inner: O, directory: &Path, joints: usize, about: &BTreeMap<String, String>) -> Self {
        let path = free_name(directory);
        let mut recorder = Self {
            inner,
            joints,
            writer: None,
            path,
            problem: None,
            clock: SampleClock::new(1000),
            recent: VecDeque::new(),
            open: None,
            traces: Vec::new(),
        };
        let names: Vec<String> = (1..=joints).map(|k| format!("joint_{k}")).collect();
        let opened = std::fs::create_dir_all(directory)
            .and_then(|()| File::create(&recorder.path))
            .map_err(|e| TelemetryError::File(e.into()))
            .and_then(|file| TelemetryWriter::new(BufWriter::new(file), &names, about));
        match opened {
            Ok(writer) => recorder.writer = Some(writer),
            Err(error) => recorder.give_up(&error),
        }
        recorder
    }

    fn give_up(&mut self, error: &TelemetryError) {
        self.writer = None;
        self.inner.note(&format!("{}: {error}", self.path.display()));
        self.problem = Some(error.to_string());
    }

    /// Closes the file. The inner observer, the file if it is whole, and the
    /// force traces of the contacts.
    pub fn finish(mut self) -> (O, Option<PathBuf>, Vec<Trace>) {
        self.close_trace();
        let written = match self.writer.take().map(TelemetryWriter::finish) {
            Some(Ok(())) => Some(self.path.clone()),
            Some(Err(error)) => {
                self.give_up(&error);
                None
            }
            None => None,
        };
        (self.inner, written, self.traces)
    }

    fn sample(&mut self, sample: &Sample) {
        let time_us = self.clock.time_us(sample.tick);
        let n = self.joints.min(sample.q.len());
        let phase = format!("{:?}", sample.phase).to_lowercase();
        let result = self.writer.as_mut().map(|writer| {
            writer.write(&TelemetrySample {
                time_ns: time_us * 1000,
                q: &sample.q[..n],
                dq: &sample.dq[..n],
                tau: &sample.tau[..n],
                command: &sample.command[..n],
                force_n: sample.force_n,
                torque_nm: sample.torque_nm,
                tcp_m: sample.tcp_m,
                setpoint_m: sample.setpoint_m,
                phase: &phase,
                phase_number: sample.phase as u8,
                flags: sample.flags,
            })
        });
        if let Some(Err(error)) = result {
            self.give_up(&error);
        }
        match sample.phase {
            Phase::Taring | Phase::Approaching | Phase::Coupling => {
                if self.recent.len() >= KEPT_SAMPLES {
                    self.recent.pop_front();
                }
                self.recent.push_back((time_us, sample.force_n, sample.setpoint_m));
            }
            _ => self.close_trace(),
        }
        if self.open.is_some_and(|(_, trigger)| time_us > trigger + KEPT_US) {
            self.close_trace();
        }
    }

    /// Ends the trace at hand; forgets an approach without contact.
    fn close_trace(&mut self) {
        let Some((sphere, trigger_us)) = self.open.take() else {
            self.recent.clear();
            return;
        };
        // The way that the setpoint went until the trigger is the approach.
        let before: Vec<&Kept> = self.recent.iter().filter(|k| k.0 <= trigger_us).collect();
        let direction = match (before.first(), before.last()) {
            (Some(first), Some(last)) => {
                let way: [f64; 3] = core::array::from_fn(|k| f64::from(last.2[k]) - f64::from(first.2[k]));
                let length = way.iter().map(|w| w * w).sum::<f64>().sqrt();
                if length > 1e-4 {
                    way.map(|w| w / length)
                } else {
                    [0.0, 0.0, -1.0]
                }
            }
            _ => [0.0, 0.0, -1.0],
        };
        let samples = self
            .recent
            .iter()
            .filter(|k| k.0 + KEPT_US >= trigger_us)
            .map(|(time_us, force, _)| {
                let against = -(0..3).map(|k| f64::from(force[k]) * direction[k]).sum::<f64>();
                (*time_us as f64 * 1e-6, against)
            })
            .collect();
        self.traces.push(Trace {
            sphere,
            trigger_s: trigger_us as f64 * 1e-6,
            samples,
        });
        self.recent.clear();
    }
}

impl<O: Observer> Observer for TelemetryRecorder<O> {
    fn event(&mut self, now_us: u64, arrival: &Arrival) {
        self.clock.observe(&arrival.body);
        match &arrival.body {
            Event::Contact(contact) => self.open = Some((contact.sphere, contact.time_us)),
            Event::Telemetry(samples) => {
                for sample in samples {
                    self.sample(sample);
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

    fn plate(&mut self, place: u32) -> Moved {
        self.inner.plate(place)
    }
}

/// The first of `telemetry.mcap`, `telemetry-2.mcap`, ... that does not exist.
fn free_name(directory: &Path) -> PathBuf {
    let first = directory.join("telemetry.mcap");
    if !first.exists() {
        return first;
    }
    (2..10_000)
        .map(|k| directory.join(format!("telemetry-{k}.mcap")))
        .find(|p| !p.exists())
        .unwrap_or(first)
}
