//! The force trace of a contact, cut from the telemetry around its trigger.
//!
//! The telemetry recorder keeps these traces for the report; the live view shows
//! the latest one.

use std::collections::VecDeque;

use spherecal_model::ContactTrace;
use spherecal_shared::protocol::host::{Contact, Phase, Sample};

/// Device time over which the samples of an approach are kept, in µs.
const APPROACH_US: u64 = 6_000_000;
/// Motion of the setpoint, in m, from which the direction of approach is read.
const LEAST_MOTION_M: f64 = 1e-4;

struct KeptSample {
    /// Device time, in µs.
    time_us: u64,
    /// Estimated force at the TCP, F0, in N.
    force_n: [f32; 3],
    /// Setpoint of the TCP, F0, in m.
    setpoint_m: [f32; 3],
    /// Whether the arm descended.
    descends: bool,
}

/// Cuts the force trace of each contact from the samples of its approach.
///
/// Give it every sample with its device time, and every contact. It returns a
/// trace when the approach is over, or when the time after the trigger has
/// passed. An approach without a contact gives no trace.
pub struct ContactTracer {
    before_us: u64,
    after_us: u64,
    recent: VecDeque<KeptSample>,
    open: Option<(u32, u64)>,
}

impl ContactTracer {
    /// Keeps `before_us` before the trigger and `after_us` after it, both in µs
    /// of device time.
    pub const fn new(before_us: u64, after_us: u64) -> Self {
        Self {
            before_us,
            after_us,
            recent: VecDeque::new(),
            open: None,
        }
    }

    /// Begins the trace of a contact.
    pub const fn contact(&mut self, contact: &Contact) {
        self.open = Some((contact.sphere, contact.time_us));
    }

    /// Takes one sample, with its device time in µs. Returns the trace that this
    /// sample completes.
    pub fn sample(&mut self, time_us: u64, sample: &Sample) -> Option<ContactTrace> {
        match sample.phase {
            Phase::Taring | Phase::Approaching | Phase::Coupling => {
                while self.recent.front().is_some_and(|k| k.time_us + APPROACH_US <= time_us) {
                    self.recent.pop_front();
                }
                self.recent.push_back(KeptSample {
                    time_us,
                    force_n: sample.force_n,
                    setpoint_m: sample.setpoint_m,
                    descends: sample.phase == Phase::Approaching,
                });
            }
            _ => return self.finish(),
        }
        let (_, trigger_us) = self.open?;
        (time_us > trigger_us + self.after_us).then(|| self.finish())?
    }

    /// Ends the approach. Returns its trace; `None` for an approach without a
    /// contact.
    pub fn finish(&mut self) -> Option<ContactTrace> {
        let open = self.open.take();
        let trace = open.map(|(sphere, trigger_us)| self.trace(sphere, trigger_us));
        self.recent.clear();
        trace
    }

    fn trace(&self, sphere: u32, trigger_us: u64) -> ContactTrace {
        let direction = self.direction(trigger_us);
        let samples = self
            .recent
            .iter()
            .filter(|k| k.time_us + self.before_us >= trigger_us)
            .map(|k| {
                let against = -(0..3).map(|i| f64::from(k.force_n[i]) * direction[i]).sum::<f64>();
                (k.time_us as f64 / 1e6, (against * 1e3).round() / 1e3)
            })
            .collect();
        ContactTrace {
            sphere,
            trigger_s: trigger_us as f64 / 1e6,
            samples,
        }
    }

    /// Direction in which the setpoint moved during the descent; straight down where it did not move. With the trigger
    /// the setpoint jumps to where the arm is, which lies beside the line by some millimetres.
    fn direction(&self, trigger_us: u64) -> [f64; 3] {
        const DOWN: [f64; 3] = [0.0, 0.0, -1.0];
        let mut before = self.recent.iter().filter(|k| k.descends && k.time_us <= trigger_us);
        let Some(first) = before.next() else { return DOWN };
        let last = before.next_back().unwrap_or(first);
        let motion: [f64; 3] = core::array::from_fn(|i| f64::from(last.setpoint_m[i]) - f64::from(first.setpoint_m[i]));
        let length = motion.iter().map(|x| x * x).sum::<f64>().sqrt();
        if length > LEAST_MOTION_M {
            motion.map(|x| x / length)
        } else {
            DOWN
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn contact(time_us: u64) -> Contact {
        Contact {
            sphere: 3,
            time_us,
            force_n: 7.5,
            peak_n: 7.5,
            tare_n: [0.0; 3],
            tcp_m: [0.0; 3],
            travel_m: 0.05,
            latency_ticks: 20,
            early_crossings: 0,
        }
    }

    /// A descent along x at 50 mm/s; the force against it grows 1 N a sample.
    fn approaching(k: u16) -> Sample {
        Sample {
            phase: Phase::Approaching,
            force_n: [-f32::from(k), 100.0, 0.0],
            setpoint_m: [1e-4 * f32::from(k), 0.0, 0.5],
            ..Sample::default()
        }
    }

    // Fails if the force is not the one against the approach, if a trace holds
    // more than was asked for, or if it is told twice.
    #[test]
    fn a_trace_holds_the_force_against_the_approach() {
        let mut tracer = ContactTracer::new(20_000, 10_000);
        let mut told = Vec::new();
        for k in 0..80u16 {
            let time_us = 1_000_000 + 2_000 * u64::from(k);
            let mut sample = approaching(k);
            // With the trigger the setpoint jumps to the arm, beside the line.
            if k >= 50 {
                (sample.phase, sample.setpoint_m) = (Phase::Coupling, [2e-3, 1e-3, 0.48]);
            }
            told.extend(tracer.sample(time_us, &sample));
            if k == 50 {
                tracer.contact(&contact(time_us));
            }
        }
        assert!(tracer.finish().is_none());
        let [trace] = told.as_slice() else { panic!("{told:?}") };
        assert_eq!(trace.sphere, 3);
        assert!((trace.trigger_s - 1.1).abs() < 1e-9, "{}", trace.trigger_s);
        let (first, last) = (trace.samples[0], trace.samples[trace.samples.len() - 1]);
        assert!(
            (first.0 - 1.08).abs() < 1e-9 && (last.0 - 1.112).abs() < 1e-9,
            "{first:?} {last:?}"
        );
        for (k, (_, force)) in (40..).zip(&trace.samples) {
            assert!((force - f64::from(k)).abs() < 1e-6, "{force} at sample {k}");
        }
    }

    // Fails if an approach that found nothing is told as a contact, or if its
    // samples get into the next trace.
    #[test]
    fn an_approach_without_contact_is_forgotten() {
        let mut tracer = ContactTracer::new(1_500_000, 1_500_000);
        for k in 0..10u16 {
            assert!(tracer.sample(u64::from(k) * 1000, &approaching(k)).is_none());
        }
        assert!(tracer.sample(10_000, &Sample::default()).is_none());
        tracer.sample(11_000, &approaching(1));
        tracer.contact(&contact(11_000));
        let trace = tracer.sample(12_000, &Sample::default()).expect("a trace");
        assert_eq!(trace.samples.len(), 1, "{trace:?}");
    }
}
