//! The campaign observer that sends a run to viewers.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use spherecal_shared::protocol::host::{Contact, Event, Sample};
use spherecal_shared::robot::{Robot, Tool};
use spherecal_shared::timing::SampleClock;
use tokio::sync::mpsc::{self, error::TrySendError};

use super::{End, Frame, LiveContact, LiveScene, RealTime, Scatter, ViewerMessage};
use spherecal_campaign::telemetry::{ContactTrace, ContactTracer};
use spherecal_campaign::{CampaignObserver, ForceSense, Progress};
use spherecal_link::Arrival;

/// Time between two frames.
const PERIOD: Duration = Duration::from_millis(50);
/// Device time covered by one point of the force curve, in µs. The point shows the largest force in
/// it.
const POINT_US: u64 = 10_000;
/// Most points per frame. Beyond this number the oldest are dropped.
const POINTS: usize = 1000;
/// Time shown before and after the trigger of a contact, in µs.
const BEFORE_US: u64 = 1_000_000;
const AFTER_US: u64 = 500_000;
/// Device time that one point of a contact's trace stands for, in µs.
const TRACE_POINT_US: u64 = 4_000;
/// Messages other than frames that wait for a place in the channel.
const URGENT: usize = 16;

/// Estimated remaining time, in s, from the poses done in this session; `None` until there are
/// some.
pub fn eta_s(p: &Progress, wall_s: f64) -> Option<f64> {
    let done = p.done.saturating_sub(p.done_before);
    (done >= 3).then(|| wall_s / done as f64 * p.poses.saturating_sub(p.done) as f64)
}

/// Observes a campaign and sends messages into a channel.
pub struct LiveWatch {
    out: mpsc::Sender<ViewerMessage>,
    /// Messages other than frames are kept when the channel is full, and go first when there is
    /// space.
    urgent: VecDeque<ViewerMessage>,
    joints: usize,
    scatter: Scatter,
    sense: ForceSense,
    progress: Progress,
    sample: Option<Sample>,
    /// Device time of each sample.
    clock: SampleClock,
    points: VecDeque<(u64, f32)>,
    tracer: ContactTracer,
    contact: Option<Contact>,
    simulated: bool,
    begun: Instant,
    told: Option<Instant>,
}

impl LiveWatch {
    /// Sends a run into `out`, the scene first.
    pub fn new(out: mpsc::Sender<ViewerMessage>, robot: &Robot, tool: &Tool, scene: LiveScene) -> Self {
        let mut watch = Self {
            out,
            urgent: VecDeque::new(),
            joints: robot.dof(),
            scatter: Scatter::new(robot, tool),
            sense: ForceSense::new(robot, tool),
            progress: Progress::default(),
            sample: None,
            clock: SampleClock::new(),
            points: VecDeque::new(),
            tracer: ContactTracer::new(BEFORE_US, AFTER_US),
            contact: None,
            simulated: false,
            begun: Instant::now(),
            told: None,
        };
        watch.tell(ViewerMessage::Scene(scene));
        watch
    }

    /// Tells how the run ended.
    pub fn end(&mut self, end: End) {
        self.frame();
        self.tell(ViewerMessage::End(end));
    }

    /// Tells what may not be lost.
    fn tell(&mut self, message: ViewerMessage) {
        if self.urgent.len() >= URGENT {
            // Keep the first message, the scene: no other message can be shown without it.
            self.urgent.remove(1);
        }
        self.urgent.push_back(message);
        self.flush();
    }

    /// Sends the kept messages; returns whether all of them have been sent.
    fn flush(&mut self) -> bool {
        while let Some(message) = self.urgent.pop_front() {
            if let Err(TrySendError::Full(message)) = self.out.try_send(message) {
                self.urgent.push_front(message);
                return false;
            }
        }
        true
    }

    fn sample(&mut self, sample: &Sample) {
        let Some(time_us) = self.clock.time_us(sample.tick) else {
            return;
        };
        // A hundredth of a newton is more than a picture shows.
        let force = (sample.force_n.iter().map(|f| f * f).sum::<f32>().sqrt() * 100.0).round() / 100.0;
        match self.points.back_mut() {
            _ if self.sense.is_vague(sample) => {}
            Some(last) if last.0 / POINT_US == time_us / POINT_US => last.1 = last.1.max(force),
            _ => {
                if self.points.len() >= POINTS {
                    self.points.pop_front();
                }
                self.points.push_back((time_us, force));
            }
        }
        if let Some(trace) = self.tracer.sample(time_us, sample) {
            self.trace(trace);
        }
        self.sample = Some(*sample);
    }

    fn trace(&mut self, mut trace: ContactTrace) {
        let Some(contact) = self.contact.take() else { return };
        let point = |time_s: f64| (time_s * 1e6).round() as u64 / TRACE_POINT_US;
        trace.samples.dedup_by(|next, kept| {
            let same = point(next.0) == point(kept.0);
            if same {
                kept.1 = kept.1.max(next.1);
            }
            same
        });
        for (_, force_n) in &mut trace.samples {
            *force_n = (*force_n * 100.0).round() / 100.0;
        }
        self.tell(ViewerMessage::Contact(LiveContact {
            force_n: contact.force_n,
            travel_mm: contact.travel_m * 1e3,
            trace,
        }));
    }

    fn frame(&mut self) {
        if !self.flush() {
            return;
        }
        let wall_s = self.begun.elapsed().as_secs_f64();
        let p = &self.progress;
        let n = self.joints;
        let signal = |of: fn(&Sample) -> &[f32]| {
            let sample = self.sample.as_ref().map(of);
            sample.map_or_else(Vec::new, |values| values.iter().take(n).copied().collect())
        };
        let frame = Frame {
            stage: p.stage,
            phase: p.phase,
            sphere: p.sphere,
            done: p.done,
            poses: p.poses,
            contacts: self.scatter.contacts(),
            faults: p.faults,
            simulated: self.simulated,
            device_s: p.device_s,
            wall_s,
            eta_s: eta_s(p, wall_s),
            residual_mm: self.scatter.residual_mm(),
            q: signal(|s| &s.q),
            tau: signal(|s| &s.tau),
            tcp_m: self.sample.map(|s| s.tcp_m).unwrap_or_default(),
            force_n: self.sample.map(|s| s.force_n).unwrap_or_default(),
            force_is_vague: self.sample.is_some_and(|sample| self.sense.is_vague(&sample)),
            forces: self.points.iter().map(|&(t, f)| (t as f64 * 1e-6, f)).collect(),
            real_time: p.drive.as_ref().map(RealTime::from),
        };
        self.points.clear();
        // A frame that finds no space is lost. The next one contains everything except its part of
        // the curve.
        let _ = self.out.try_send(ViewerMessage::Frame(frame));
    }
}

impl CampaignObserver for LiveWatch {
    fn event(&mut self, _now_us: u64, arrival: &Arrival) {
        self.clock.observe(&arrival.body);
        match &arrival.body {
            Event::Telemetry(samples) => samples.iter().for_each(|sample| self.sample(sample)),
            Event::Contact(contact) => {
                self.scatter.contact();
                self.tracer.contact(contact);
                self.contact = Some(*contact);
            }
            Event::Recording(recording) => self.scatter.record(recording),
            Event::Statistics(statistics) => self.simulated = statistics.simulated,
            _ => {}
        }
    }

    fn progress(&mut self, progress: &Progress) {
        self.progress = *progress;
        let now = Instant::now();
        if self.told.is_none_or(|last| now - last >= PERIOD) {
            self.told = Some(now);
            self.frame();
        }
    }

    fn note(&mut self, text: &str) {
        self.tell(ViewerMessage::Note { text: text.to_owned() });
    }
}
