//! One connection to one cell. It steps time, stores and acknowledges events, and offers commands
//! and waits as plain calls.
//!
//! What the campaign does depends on the events that it receives, and their times are the
//! controller's own. Every command starts a fixed lead after the event that caused it. Events that
//! arrive are handled one at a time. So a link that loses and repeats frames, or a slow host,
//! changes no tick of the arm, as long as a frame gets through within the lead. A command that
//! arrives later starts on arrival and is counted as late.

mod handshake;
mod order;

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};

use spherecal_shared::protocol::frame::LinkCounters;
use spherecal_shared::protocol::host::{
    Banner, Contact, Coupled, Event, FaultReport, Phase, Refusal, Sample, Statistics,
};

use super::force::{ForceSense, magnitude};
use super::observe::{CampaignObserver, CampaignStage, Moved, Progress, TelemetrySummary};
use super::{CampaignError, plausible};
use spherecal_link::native::{DriveRecord, Monitor};
use spherecal_link::{Arrival, Device, HostEndpoint, Journal, Timing};
use spherecal_plan::Plan;

pub(super) use order::Waited;

/// Longest interval between two progress reports to an observer, in µs of device time.
const PROGRESS_US: u64 = 100_000;
/// The first command after a handshake starts when the controller's clock shows a multiple of this,
/// in µs. So the time that a lost handshake costs has no effect.
const ROUND_US: u64 = 500_000;
/// One connection to one cell.
pub struct Session<'a> {
    cell: &'a mut dyn Device,
    endpoint: HostEndpoint,
    journal: &'a mut dyn Journal,
    observer: &'a mut dyn CampaignObserver,
    interrupt: &'a AtomicBool,
    /// What a robot behind its own interface reports.
    monitor: Option<Monitor>,
    down: Vec<u8>,
    up: Vec<u8>,
    arrived: Vec<Arrival>,
    /// Events that have arrived and were not handled yet.
    inbox: VecDeque<Arrival>,
    joints: usize,
    /// How well the arm feels forces; `None` before it is known which arm it is.
    pub(super) sense: Option<ForceSense>,
    /// Delay from a command's cause to its start, in µs.
    lead_us: u64,
    /// Whether a handshake was sent and not yet answered.
    in_handshake: bool,
    /// Time of the event handled last, on the controller's clock, in µs.
    heard_us: u64,
    last_progress_us: u64,
    /// Cell time of the last exchange, in µs. The program may have been held up since.
    exchanged_us: u64,
    /// Cell time of the last exchange in which a frame of the controller arrived, in µs.
    alive_us: u64,
    pub(super) progress: Progress,
    pub(super) banner: Option<Banner>,
    pub(super) phase: Phase,
    /// Time of the last change of phase, on the controller's clock, in µs.
    changed_us: u64,
    /// Planned start of the last command, on the same clock, in µs.
    start_us: u64,
    pub(super) reply: Option<(u32, Result<(), Refusal>)>,
    pub(super) pending_fault: Option<FaultReport>,
    pub(super) faults: Vec<FaultReport>,
    pub(super) contacts: Vec<Contact>,
    pub(super) coupled: Option<Coupled>,
    pub(super) recorded: Option<(u32, u32)>,
    pub(super) passed: Option<u32>,
    /// The samples of the control loop that came last, oldest first.
    pub(super) samples: Vec<Sample>,
    pub(super) statistics: Statistics,
    pub(super) telemetry: TelemetrySummary,
}

impl<'a> Session<'a> {
    /// A session that has sent nothing yet. Its commands start `lead_us` after their cause. It
    /// stops when `interrupt` is set.
    pub fn new(
        cell: &'a mut dyn Device,
        journal: &'a mut dyn Journal,
        observer: &'a mut dyn CampaignObserver,
        interrupt: &'a AtomicBool,
        lead_us: u64,
    ) -> Self {
        let monitor = cell.monitor();
        let endpoint = HostEndpoint::new(Timing::default());
        cell.keep_alive(endpoint.keep_alives());
        Self {
            monitor,
            cell,
            endpoint,
            journal,
            observer,
            interrupt,
            down: Vec::new(),
            up: Vec::new(),
            arrived: Vec::new(),
            inbox: VecDeque::new(),
            joints: 0,
            sense: None,
            lead_us,
            in_handshake: false,
            heard_us: 0,
            last_progress_us: 0,
            exchanged_us: 0,
            alive_us: 0,
            progress: Progress::default(),
            banner: None,
            phase: Phase::Idle,
            changed_us: 0,
            start_us: 0,
            reply: None,
            pending_fault: None,
            faults: Vec::new(),
            contacts: Vec::new(),
            coupled: None,
            recorded: None,
            passed: None,
            samples: Vec::new(),
            statistics: Statistics::default(),
            telemetry: TelemetrySummary::default(),
        }
    }

    /// Device time, in µs.
    pub fn now_us(&self) -> u64 {
        self.cell.now_us()
    }

    /// Control periods carried out by the cell.
    pub fn ticks(&self) -> u64 {
        self.cell.ticks()
    }

    /// Counters of the host's end of the link.
    pub fn counters(&self) -> LinkCounters {
        self.endpoint.counters()
    }

    /// Where the campaign notes what it does.
    pub(super) fn journal(&mut self) -> &mut dyn Journal {
        self.journal
    }

    pub(super) fn note(&mut self, text: &str) {
        self.observer.note(text);
    }

    pub(super) fn stage(&mut self, stage: CampaignStage, sphere: u32, plan: &Plan) {
        self.progress.stage = stage;
        self.progress.sphere = sphere;
        self.progress.poses = plan.recorded();
        self.report_progress();
    }

    pub(super) fn report_progress(&mut self) {
        let now_us = self.cell.now_us();
        self.last_progress_us = now_us;
        self.progress.phase = self.phase;
        self.progress.faults = self.faults.len();
        self.progress.device_s = now_us as f64 * 1e-6;
        self.observer.progress(&self.progress);
    }

    /// Whether the recordings so far are enough, as the observer says.
    pub(super) fn enough(&mut self) -> Option<bool> {
        self.observer.enough(self.cell.waits())
    }

    /// The newest sample of the control loop.
    pub(super) fn sample(&self) -> Option<Sample> {
        self.samples.last().copied()
    }

    /// The control period, in s; 0 before the handshake.
    pub(super) fn period_s(&self) -> f64 {
        self.banner
            .as_ref()
            .map_or(0.0, |banner| f64::from(banner.period_us) * 1e-6)
    }

    /// Handles the next event that has arrived; if none has, one control period passes first.
    pub(super) fn step(&mut self) -> Result<(), CampaignError> {
        if self.inbox.is_empty() {
            self.exchange()?;
        }
        if let Some(arrival) = self.inbox.pop_front() {
            self.hear(&arrival);
            self.observer.event(self.cell.now_us(), &arrival);
        }
        Ok(())
    }

    /// One control period.
    fn exchange(&mut self) -> Result<(), CampaignError> {
        self.down.clear();
        self.up.clear();
        let now_us = self.cell.now_us();
        self.endpoint
            .transmit(now_us, &mut self.down)
            .map_err(spherecal_link::LinkError::from)?;
        let stepped = self.cell.step(&self.down, &mut self.up);
        if stepped.is_err() || now_us.saturating_sub(self.last_progress_us) >= PROGRESS_US {
            self.note_drive();
        }
        stepped?;
        self.exchanged_us = self.cell.now_us();
        let (journal, joints) = (&mut *self.journal, self.joints);
        let frames = self.endpoint.counters().frames;
        self.endpoint.receive(&self.up, &mut self.arrived, |batch| {
            for arrival in batch {
                plausible(&arrival.body, joints)?;
            }
            journal.append(batch).map_err(CampaignError::from)
        })?;
        self.inbox.extend(self.arrived.drain(..));
        if self.endpoint.counters().frames != frames {
            self.alive_us = now_us;
        }
        if self.endpoint.lost_session() {
            return Err(CampaignError::Restarted);
        }
        if now_us.saturating_sub(self.last_progress_us) >= PROGRESS_US {
            self.report_progress();
        }
        Ok(())
    }

    /// Passes on what the robot's own interface reported and measured.
    fn note_drive(&mut self) {
        while let Some(event) = self.monitor.as_ref().and_then(Monitor::next_event) {
            self.observer.note(&event.to_string());
        }
        self.progress.drive = self.drive_record();
    }

    /// What the drive measured of itself so far, if it is a robot's own interface.
    pub(super) fn drive_record(&self) -> Option<DriveRecord> {
        // A controller in another process tells it with its counters.
        let timing = Some(&self.statistics.timing).filter(|timing| timing.cycles > 0);
        let told = || timing.map(DriveRecord::from);
        self.monitor.as_ref().map(Monitor::record).or_else(told)
    }

    fn hear(&mut self, arrival: &Arrival) {
        if let Some(time_us) = time_of(&arrival.body) {
            self.heard_us = self.heard_us.max(time_us);
        }
        match &arrival.body {
            Event::Banner(banner) => {
                self.banner = Some(banner.clone());
                // The next command starts at a round time. A late repeat of the banner does not
                // affect the commands after it.
                if std::mem::take(&mut self.in_handshake) {
                    let earliest = arrival.sent_us.saturating_add(self.lead_us).saturating_add(1);
                    self.heard_us = earliest.next_multiple_of(ROUND_US).saturating_sub(self.lead_us);
                }
            }
            Event::Held { .. } => {}
            Event::Reply { sequence, result } => self.reply = Some((*sequence, *result)),
            Event::Phase(change) => {
                self.phase = change.phase;
                self.changed_us = change.time_us;
                self.report_progress();
            }
            Event::Contact(contact) => self.contacts.push(*contact),
            Event::Coupled(coupled) => self.coupled = Some(*coupled),
            Event::Recording(recording) => self.recorded = Some((recording.sphere, recording.pose)),
            Event::Fault(report) => {
                self.pending_fault = Some(*report);
                self.faults.push(*report);
            }
            Event::Telemetry(samples) => {
                let sense = self.sense.as_ref();
                let is_vague = |sample: &Sample| sense.is_some_and(|sense| sense.is_vague(sample));
                for sample in samples {
                    self.telemetry.add(sample, is_vague);
                }
                if let Some(sample) = samples.last() {
                    self.progress.force_n = magnitude(sample);
                    self.progress.force_is_vague = is_vague(sample);
                    self.samples.clear();
                    self.samples.extend_from_slice(samples);
                }
            }
            Event::Statistics(statistics) => self.statistics = *statistics,
            Event::Passed { pose } => self.passed = Some(*pose),
        }
    }

    /// Whether the user wants to stop.
    pub(super) fn check_interrupt(&self) -> Result<(), CampaignError> {
        if self.interrupt.load(Ordering::Relaxed) {
            Err(CampaignError::Interrupted)
        } else {
            Ok(())
        }
    }

    /// Has the plate moved to a placement, by the simulation or by an operator. Waits for the
    /// operator without a time limit.
    pub(super) fn plate(&mut self, place: u32) -> Result<(), CampaignError> {
        if self.cell.move_plate(place) {
            return Ok(());
        }
        loop {
            match self.observer.plate(place) {
                Moved::Yes => return Ok(()),
                Moved::NotYet => {}
                Moved::Nobody => return Err(CampaignError::Plate { place }),
            }
            self.check_interrupt()?;
            self.step()?;
        }
    }

    /// Lets acknowledgements reach the controller.
    pub(super) fn drain(&mut self, ticks: u32) -> Result<(), CampaignError> {
        let end = self.ticks().saturating_add(u64::from(ticks));
        while self.ticks() < end {
            self.step()?;
        }
        Ok(())
    }
}

/// When an event happened, by the controller's clock, in µs.
fn time_of(event: &Event) -> Option<u64> {
    match event {
        Event::Phase(change) => Some(change.time_us),
        Event::Contact(contact) => Some(contact.time_us),
        Event::Coupled(coupled) => Some(coupled.time_us),
        Event::Recording(recording) => Some(recording.end_us),
        Event::Fault(report) => Some(report.time_us),
        Event::Banner(_)
        | Event::Held { .. }
        | Event::Reply { .. }
        | Event::Passed { .. }
        | Event::Telemetry(_)
        | Event::Statistics(_) => None,
    }
}
