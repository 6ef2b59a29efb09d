//! The observer that writes telemetry to a file and keeps the force trace of
//! every contact.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use spherecal_shared::protocol::host::{Event, Sample};
use spherecal_shared::timing::SampleClock;

use super::contact::ContactTracer;
use super::files::{RunKey, free_name};
use super::scene::DrawnArm;
use super::thinning::{Entry, Thinning};
use super::utc::{Moment, UtcClock, now_ns};
use super::writer::{TelemetryError, TelemetryWriter};
use crate::{CampaignObserver, Moved, Progress};
use spherecal_link::Arrival;
use spherecal_model::ContactTrace;

/// Device time that is kept of a contact before its trigger and after it, in µs.
const KEPT_US: u64 = 1_500_000;

/// An observer around another one. It writes telemetry to a file and hands every
/// event on.
pub struct TelemetryRecorder<O: CampaignObserver> {
    inner: O,
    recording: Recording,
}

/// What is recorded. It does not depend on the inner observer, so that it is compiled once, here.
struct Recording {
    writer: Option<TelemetryWriter<BufWriter<File>>>,
    directory: PathBuf,
    /// The file; none before the run is known.
    path: Option<PathBuf>,
    arm: DrawnArm,
    about: BTreeMap<String, String>,
    /// Why the file was given up, until the inner observer is told.
    complaint: Option<String>,
    /// Device time of each sample.
    clock: SampleClock,
    utc: UtcClock,
    thinning: Thinning,
    tracer: ContactTracer,
    traces: Vec<ContactTrace>,
}

impl Recording {
    /// Makes the file of a run.
    fn open(&mut self, run: &RunKey) {
        let path = free_name(&self.directory, run.number);
        let mut about = self.about.clone();
        run.describe(&mut about);
        let utc_ns = self.utc.latest(now_ns()).utc_ns;
        let opened = std::fs::create_dir_all(&self.directory)
            .and_then(|()| File::create_new(&path))
            .map_err(|e| TelemetryError::File(e.into()))
            .and_then(|file| TelemetryWriter::new(BufWriter::new(file), self.arm.clone(), &about, utc_ns));
        self.path = Some(path);
        match opened {
            Ok(writer) => self.writer = Some(writer),
            Err(error) => self.give_up(&error),
        }
    }

    fn give_up(&mut self, error: &TelemetryError) {
        self.writer = None;
        let path = self.path.as_deref().unwrap_or(&self.directory);
        self.complaint = Some(format!("{}: {error}", path.display()));
    }

    /// Closes the file: its path, if it is whole.
    fn finish(&mut self) -> Option<PathBuf> {
        self.traces.extend(self.tracer.finish());
        while let Some((at, entry)) = self.thinning.rest() {
            self.write(at, &entry);
        }
        match self.writer.take()?.finish() {
            Ok(()) => self.path.clone(),
            Err(error) => {
                self.give_up(&error);
                None
            }
        }
    }

    /// Writes an entry. After an error the file is closed.
    fn write(&mut self, at: Moment, entry: &Entry) {
        let Some(writer) = self.writer.as_mut() else { return };
        let written = match entry {
            Entry::Sample(sample) => writer.write(at, sample),
            Entry::Event(event) => writer.event(at, event),
            Entry::Note(text) => writer.note(at, text),
        };
        if let Err(error) = written {
            self.give_up(&error);
        }
    }

    /// Hands an entry to the file.
    fn add(&mut self, at: Moment, entry: Entry) {
        self.thinning.push(at, entry);
        while let Some((at, entry)) = self.thinning.next() {
            self.write(at, &entry);
        }
    }

    fn event(&mut self, event: &Event) {
        self.clock.observe(event);
        match event {
            Event::Telemetry(samples) => {
                for sample in samples {
                    self.sample(sample);
                }
                return;
            }
            Event::Statistics(_) => return,
            Event::Contact(contact) => self.tracer.contact(contact),
            _ => {}
        }
        self.add(self.utc.latest(now_ns()), Entry::Event(Box::new(event.clone())));
    }

    fn sample(&mut self, sample: &Sample) {
        let Some(time_us) = self.clock.time_us(sample.tick) else {
            return;
        };
        let at = self.utc.at(time_us, now_ns());
        self.add(at, Entry::Sample(*sample));
        self.traces.extend(self.tracer.sample(time_us, sample));
    }

    fn note(&mut self, text: &str) {
        self.add(self.utc.latest(now_ns()), Entry::Note(text.to_owned()));
    }
}

impl<O: CampaignObserver> TelemetryRecorder<O> {
    /// Watches for `inner`. The file is made in `directory` when the campaign says which run it
    /// measures; `about` and the run are kept as its metadata. Away from contacts and faults it gets one sample in
    /// `every_ticks` control periods, as the controller sends them in free motions.
    pub fn new(inner: O, directory: &Path, arm: DrawnArm, about: &BTreeMap<String, String>, every_ticks: u32) -> Self {
        Self {
            inner,
            recording: Recording {
                writer: None,
                directory: directory.to_owned(),
                path: None,
                arm,
                about: about.clone(),
                complaint: None,
                clock: SampleClock::new(),
                utc: UtcClock::new(now_ns()),
                thinning: Thinning::new(every_ticks),
                tracer: ContactTracer::new(KEPT_US, KEPT_US),
                traces: Vec::new(),
            },
        }
    }

    /// Closes the file. The inner observer, the file if it is whole, and the
    /// force traces of the contacts.
    pub fn finish(mut self) -> (O, Option<PathBuf>, Vec<ContactTrace>) {
        let path = self.recording.finish();
        self.complain();
        (self.inner, path, self.recording.traces)
    }

    /// Tells the inner observer that the file was given up.
    fn complain(&mut self) {
        if let Some(words) = self.recording.complaint.take() {
            self.inner.note(&words);
        }
    }
}

impl<O: CampaignObserver> CampaignObserver for TelemetryRecorder<O> {
    fn run(&mut self, run: &RunKey) {
        self.recording.open(run);
        self.complain();
        self.inner.run(run);
    }

    fn event(&mut self, now_us: u64, arrival: &Arrival) {
        self.recording.event(&arrival.body);
        self.complain();
        self.inner.event(now_us, arrival);
    }

    fn progress(&mut self, progress: &Progress) {
        self.inner.progress(progress);
    }

    fn note(&mut self, text: &str) {
        self.recording.note(text);
        self.complain();
        self.inner.note(text);
    }

    fn plate(&mut self, place: u32) -> Moved {
        self.inner.plate(place)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{TelemetryReader, files_of_run};
    use super::*;
    use crate::Silent;
    use spherecal_shared::protocol::host::{Banner, Contact, Phase, PhaseChange, SessionId};

    fn arrival(body: Event) -> Arrival {
        Arrival {
            session: SessionId::default(),
            event: 0,
            sent_us: 0,
            body,
        }
    }

    /// Telemetry times (ns) and the contact's trace of a session with a drive of
    /// the given control period.
    fn session(period_us: u32) -> (Vec<u64>, ContactTrace) {
        let folder = tempfile::tempdir().expect("a folder");
        let model = spherecal_model::robots::built_in("iiwa7").expect("built in");
        let arm = DrawnArm::new(&model, &model.tool_in_table());
        let mut recorder = TelemetryRecorder::new(Silent, folder.path(), arm, &BTreeMap::new(), 20);
        let run = RunKey {
            number: 4,
            created_utc: "2026-11-23T10:00:00Z".to_owned(),
        };
        recorder.run(&run);
        let sample = |tick| Sample {
            tick,
            phase: Phase::Approaching,
            ..Sample::default()
        };
        let batch = |ticks: core::ops::Range<u64>| Event::Telemetry(ticks.map(sample).collect());
        let period = u64::from(period_us);
        let events = [
            batch(97..100),
            Event::Banner(Banner {
                protocol: 1,
                schema: 0,
                version: heapless::String::new(),
                build: heapless::String::new(),
                joints: 7,
                period_us,
                first_event: 1,
            }),
            Event::Phase(PhaseChange {
                phase: Phase::Approaching,
                from: Phase::Taring,
                time_us: 5_000_000,
                tick: 100,
            }),
            batch(100..103),
            Event::Contact(Contact {
                sphere: 2,
                time_us: 5_000_000 + 2 * period,
                force_n: 7.5,
                peak_n: 7.5,
                tare_n: [0.0; 3],
                tcp_m: [0.0; 3],
                travel_m: 0.05,
                latency_ticks: 20,
                early_crossings: 0,
            }),
            batch(103..105),
        ];
        for event in events {
            recorder.event(0, &arrival(event));
        }
        let (_, path, mut traces) = recorder.finish();
        assert_eq!(files_of_run(folder.path(), &run), [path.clone().expect("a whole file")]);
        let bytes = std::fs::read(path.expect("a whole file")).expect("readable");
        let periods = TelemetryReader::new(&bytes).expect("MCAP");
        let times = periods.map(|p| p.expect("a sample").device_ns).collect();
        (times, traces.pop().expect("a trace"))
    }

    // Fails if the times of telemetry or of a contact's trace assume a control
    // period of 1 ms, or if samples get a time before the period is known.
    #[test]
    fn times_follow_the_period_of_the_drive() {
        for period_us in [1000, 2000] {
            let (times, trace) = session(period_us);
            let expected: Vec<u64> = (0..5)
                .map(|k| 5_000_000_000 + k * u64::from(period_us) * 1000)
                .collect();
            assert_eq!(times, expected, "{period_us} µs");
            let period_s = f64::from(period_us) * 1e-6;
            assert!((trace.trigger_s - (5.0 + 2.0 * period_s)).abs() < 1e-9, "{trace:?}");
            for (k, (time_s, _)) in (0..).zip(&trace.samples) {
                assert!((time_s - (5.0 + f64::from(k) * period_s)).abs() < 1e-9, "{trace:?}");
            }
        }
    }
}
