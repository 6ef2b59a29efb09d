//! One connection to one cell: steps time, stores and acknowledges, and turns
//! commands and waits into plain calls.
//!
//! What the campaign does depends on what it hears, and when it does it is
//! counted from the controller's own times: every command is to start a fixed
//! lead after the event that led to it. What arrives is heard one event at a
//! time. So a link that loses and repeats frames, or a host that is slow,
//! changes no tick of what the arm does, as long as a frame gets through within
//! the lead; a command that does not starts when it comes, and is counted late.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};

use spherecal_shared::protocol::frame::LinkCounters;
use spherecal_shared::protocol::host::{
    Banner, Command, Contact, Coupled, Event, FaultReport, Phase, Refusal, Sample, SessionId, Statistics,
};
use spherecal_shared::protocol::{PROTOCOL_VERSION, SCHEMA};

use super::observe::{Moved, Observer, Progress, Stage, TelemetrySummary, force};
use super::recovery::{GREET_S, LOST_S};
use super::{CampaignError, Tour, plausible};
use crate::link::{Arrival, Device, HostEndpoint, Injected, Timing};

/// Why a journal did not take what came.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// It could not be written.
    #[error("{message}")]
    Store {
        /// What happened, and the remedy, in words for the user.
        message: String,
    },
    /// A run that is repeated from its start measured something else.
    #[error(
        "sphere {sphere}, pose {pose}: repeating the run from its start gave another recording than the one that is \
         stored: it was begun by another version of this program, or its configuration has changed; begin a new run \
         without --resume. The stored recordings are as they were"
    )]
    Differs {
        /// Id of the sphere.
        sphere: u32,
        /// Id of the pose.
        pose: u32,
    },
}

/// Where events go before they are acknowledged.
pub trait Journal {
    /// Notes that the controller is about to be greeted under this number:
    /// events of this session and of earlier ones of the same run are to be
    /// kept; others are those of another run, and are to be passed over.
    ///
    /// # Errors
    /// When it could not be noted.
    fn greet(&mut self, _session: SessionId) -> Result<(), JournalError> {
        Ok(())
    }

    /// Makes a batch of events durable. A recording that is already there is
    /// not stored again, and that is no error.
    ///
    /// # Errors
    /// When nothing of the batch could be stored.
    fn append(&mut self, events: &[Arrival]) -> Result<(), JournalError>;

    /// Notes that a pose was given up.
    ///
    /// # Errors
    /// When it could not be noted.
    fn reject(&mut self, sphere: u32, pose: u32, reason: &str) -> Result<(), JournalError>;
}

/// How often an observer hears of progress at least, in µs of device time.
const PROGRESS_US: u64 = 100_000;
/// The first command after a greeting starts when the controller's clock shows
/// a multiple of this, in µs: so that what a lost greeting costs is not seen.
const ROUND_US: u64 = 500_000;
/// How long the controller may take to answer a command, in s of device time.
const ANSWER_S: f64 = 10.0;

/// How long a cleared fault is watched for coming back, in µs of device time.
const CLEAR_US: u64 = 50_000;

/// How a wait ended.
pub(super) enum Waited<T> {
    /// What was waited for.
    Got(T),
    /// A fault came first.
    Fault(FaultReport),
}

/// One connection to one cell.
pub struct Session<'a> {
    cell: &'a mut dyn Device,
    endpoint: HostEndpoint,
    journal: &'a mut dyn Journal,
    observer: &'a mut dyn Observer,
    interrupt: &'a AtomicBool,
    down: Vec<u8>,
    up: Vec<u8>,
    arrived: Vec<Arrival>,
    /// What has arrived and was not heard yet.
    inbox: VecDeque<Arrival>,
    /// Joints of the robot.
    joints: usize,
    /// How long after its cause a command starts, in µs.
    lead_us: u64,
    /// Whether the controller was greeted and has not answered yet.
    greeting: bool,
    /// When, by the controller's clock, what was heard last happened, in µs.
    heard_us: u64,
    last_progress_us: u64,
    /// Time of the cell at which a frame of the controller last came, in µs.
    alive_us: u64,
    pub(super) progress: Progress,
    pub(super) banner: Option<Banner>,
    pub(super) phase: Phase,
    /// Phase changes heard so far: a wait for rest first wants to see motion.
    pub(super) changes: u64,
    pub(super) reply: Option<(u32, Result<(), Refusal>)>,
    pub(super) pending_fault: Option<FaultReport>,
    pub(super) faults: Vec<FaultReport>,
    pub(super) contacts: Vec<Contact>,
    pub(super) coupled: Option<Coupled>,
    pub(super) recorded: Option<(u32, u32)>,
    pub(super) passed: Option<u32>,
    /// The newest sample of the control loop.
    pub(super) sample: Option<Sample>,
    pub(super) statistics: Statistics,
    pub(super) telemetry: TelemetrySummary,
}

impl<'a> Session<'a> {
    /// A session that has not spoken yet; its commands start `lead_us` after
    /// what led to them, and it stops when `interrupt` is set.
    pub fn new(
        cell: &'a mut dyn Device,
        journal: &'a mut dyn Journal,
        observer: &'a mut dyn Observer,
        interrupt: &'a AtomicBool,
        lead_us: u64,
    ) -> Self {
        Self {
            cell,
            endpoint: HostEndpoint::new(Timing::default()),
            journal,
            observer,
            interrupt,
            down: Vec::new(),
            up: Vec::new(),
            arrived: Vec::new(),
            inbox: VecDeque::new(),
            joints: 0,
            lead_us,
            greeting: false,
            heard_us: 0,
            last_progress_us: 0,
            alive_us: 0,
            progress: Progress::default(),
            banner: None,
            phase: Phase::Idle,
            changes: 0,
            reply: None,
            pending_fault: None,
            faults: Vec::new(),
            contacts: Vec::new(),
            coupled: None,
            recorded: None,
            passed: None,
            sample: None,
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

    /// What was done to frames on purpose.
    pub fn injected(&self) -> Injected {
        self.cell.injected()
    }

    pub(super) fn journal(&mut self) -> &mut dyn Journal {
        self.journal
    }

    pub(super) fn note(&mut self, text: &str) {
        self.observer.note(text);
    }

    pub(super) fn stage(&mut self, stage: Stage, sphere: u32, tour: &Tour) {
        self.progress.stage = stage;
        self.progress.sphere = sphere;
        self.progress.spheres = tour.stops.len();
        self.progress.poses = tour.poses();
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

    /// Hears the next thing that has arrived, after a control period if nothing has.
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
            .map_err(crate::link::LinkError::from)?;
        self.cell.step(&self.down, &mut self.up)?;
        let journal = &mut *self.journal;
        let joints = self.joints;
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

    fn hear(&mut self, arrival: &Arrival) {
        if let Some(time_us) = time_of(&arrival.body) {
            self.heard_us = self.heard_us.max(time_us);
        }
        match &arrival.body {
            Event::Banner(banner) => {
                self.banner = Some(banner.clone());
                // The next command starts at a round time; what a late repeat of
                // the banner says changes nothing about those after it.
                if std::mem::take(&mut self.greeting) {
                    let earliest = arrival.sent_us.saturating_add(self.lead_us).saturating_add(1);
                    self.heard_us = earliest.next_multiple_of(ROUND_US).saturating_sub(self.lead_us);
                }
            }
            Event::Held { .. } => {}
            Event::Reply { sequence, result } => self.reply = Some((*sequence, *result)),
            Event::Phase(change) => {
                self.phase = change.phase;
                self.changes += 1;
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
                self.telemetry.add(arrival);
                if let Some(sample) = samples.last() {
                    self.progress.force_n = force(sample);
                    self.sample = Some(*sample);
                }
            }
            Event::Statistics(statistics) => self.statistics = *statistics,
            Event::Passed { pose } => self.passed = Some(*pose),
        }
    }

    /// Whether the user wants to stop.
    fn check_interrupt(&self) -> Result<(), CampaignError> {
        if self.interrupt.load(Ordering::Relaxed) {
            Err(CampaignError::Interrupted)
        } else {
            Ok(())
        }
    }

    /// Sends a command and waits for its reply.
    pub(super) fn ask(&mut self, what: &str, command: Command) -> Result<Result<(), Refusal>, CampaignError> {
        let start_us = match command {
            // Nothing is known yet of the controller's clock.
            Command::Hello => 0,
            _ => self.heard_us.saturating_add(self.lead_us).max(1),
        };
        self.ask_at(start_us, what, command)
    }

    /// As [`ask`](Self::ask), of a command that is to start at `start_us`.
    fn ask_at(&mut self, start_us: u64, what: &str, command: Command) -> Result<Result<(), Refusal>, CampaignError> {
        let sequence = self.endpoint.send_at(start_us, command);
        // It is answered when it has started, and an answer that is lost must be
        // asked for again: what nothing but the answer leads to starts a lead later.
        if start_us > 0 {
            self.heard_us = self.heard_us.max(start_us.saturating_add(self.lead_us));
        }
        let start = self.now_us();
        self.reply = None;
        loop {
            self.step()?;
            if let Some((number, result)) = self.reply
                && number == sequence
            {
                return Ok(result);
            }
            self.check_time(start, ANSWER_S, || format!("answer to \"{what}\""))?;
        }
    }

    /// Has the arm stop and hold, at once.
    pub(super) fn stop_at_once(&mut self) -> Result<(), CampaignError> {
        self.ask_at(0, "stop", Command::Stop).map(|_| ())
    }

    /// Sends a command that must not be refused.
    pub(super) fn order(&mut self, what: &str, command: Command) -> Result<(), CampaignError> {
        self.ask(what, command)?.map_err(|refusal| CampaignError::Refused {
            what: what.to_owned(),
            refusal,
        })
    }

    /// Sends a command; the fault that kept it from being carried out, if there was one.
    pub(super) fn carry_out(&mut self, what: &str, command: Command) -> Result<Option<FaultReport>, CampaignError> {
        match self.ask(what, command)? {
            Ok(()) => Ok(None),
            Err(Refusal::FaultPending) => {
                // Its report is on the way.
                match self.wait("report its fault", ANSWER_S, |_| None::<()>)? {
                    Waited::Fault(report) => Ok(Some(report)),
                    Waited::Got(()) => Ok(None),
                }
            }
            Err(refusal) => Err(CampaignError::Refused {
                what: what.to_owned(),
                refusal,
            }),
        }
    }

    /// Sends a command that sets the arm in motion, and waits until it rests again,
    /// so many s at most; the fault, if one came.
    pub(super) fn carry_to_rest(
        &mut self,
        what: &str,
        command: Command,
        limit_s: f64,
    ) -> Result<Option<FaultReport>, CampaignError> {
        let before = self.changes;
        if let Some(report) = self.carry_out(what, command)? {
            return Ok(Some(report));
        }
        let rest = |s: &Self| (s.changes > before && s.phase == Phase::Idle).then_some(());
        match self.wait(what, limit_s, rest)? {
            Waited::Got(()) => Ok(None),
            Waited::Fault(report) => Ok(Some(report)),
        }
    }

    /// Lets time pass, in s.
    pub(super) fn rest(&mut self, time_s: f64) -> Result<(), CampaignError> {
        let start = self.now_us();
        while (self.now_us().saturating_sub(start) as f64) * 1e-6 < time_s {
            self.check_interrupt()?;
            self.step()?;
            self.check_time(start, f64::INFINITY, String::new)?;
        }
        // By the controller's clock, too: what comes next starts that much later.
        self.heard_us = self.heard_us.saturating_add((time_s * 1e6) as u64);
        Ok(())
    }

    /// Steps until `done` says so or a fault comes.
    pub(super) fn wait<T>(
        &mut self,
        what: &str,
        limit_s: f64,
        mut done: impl FnMut(&Self) -> Option<T>,
    ) -> Result<Waited<T>, CampaignError> {
        let start = self.now_us();
        loop {
            self.check_interrupt()?;
            self.step()?;
            if let Some(report) = self.pending_fault
                && self.phase == Phase::Fault
            {
                return Ok(Waited::Fault(report));
            }
            if let Some(value) = done(self) {
                return Ok(Waited::Got(value));
            }
            self.check_time(start, limit_s, || what.to_owned())?;
        }
    }

    fn check_time(&self, start_us: u64, limit_s: f64, what: impl FnOnce() -> String) -> Result<(), CampaignError> {
        let silent_s = self.now_us().saturating_sub(self.alive_us) as f64 * 1e-6;
        if self.banner.is_some() && silent_s > LOST_S {
            return Err(CampaignError::Lost { silent_s });
        }
        if self.now_us().saturating_sub(start_us) as f64 * 1e-6 > limit_s {
            return Err(CampaignError::Timeout {
                what: what(),
                limit_s,
                phase: self.phase,
            });
        }
        Ok(())
    }

    /// Greets the controller and checks who it is.
    pub(super) fn greet(&mut self, joints: usize) -> Result<(), CampaignError> {
        self.joints = joints;
        self.greeting = true;
        let session = self.endpoint.next_session();
        self.journal.greet(session)?;
        if let Err(error) = self.order("greet", Command::Hello) {
            // One that does not understand a greeting may still say why.
            return match (self.greet_again(joints), error) {
                (Err(why), CampaignError::Timeout { .. }) => Err(why),
                (_, error) => Err(error),
            };
        }
        let Waited::Got(banner) = self.wait("send its banner", ANSWER_S, |s| s.banner.clone())? else {
            // A controller that was left in a fault says so before its banner.
            return self.greet_again(joints);
        };
        check_banner(&banner, joints)
    }

    fn greet_again(&self, joints: usize) -> Result<(), CampaignError> {
        match &self.banner {
            Some(banner) => check_banner(banner, joints),
            None if self.endpoint.foreign() > 0 => Err(CampaignError::Schema {
                found: "unknown".to_owned(),
                expected: SCHEMA,
            }),
            None => Err(CampaignError::Timeout {
                what: "send its banner".to_owned(),
                limit_s: ANSWER_S,
                phase: self.phase,
            }),
        }
    }

    /// Has the plate moved to a placement, by the simulation or by a person,
    /// for whom it waits as long as it takes.
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

    /// Clears a fault, if there is one; the fault that came back at once, if one did.
    pub(super) fn clear_fault(&mut self) -> Result<Option<FaultReport>, CampaignError> {
        let quiet = self.pending_fault.take().is_none() && self.phase != Phase::Fault;
        self.order("clear the fault", Command::ClearFault)?;
        if quiet && self.pending_fault.is_none() {
            return Ok(None);
        }
        // The fault is over when the controller says so, not when it says yes.
        let start = self.now_us();
        loop {
            self.step()?;
            if self.phase != Phase::Fault && self.now_us().saturating_sub(start) > CLEAR_US {
                return Ok(None);
            }
            if let (Phase::Fault, Some(report)) = (self.phase, self.pending_fault) {
                return Ok(Some(report));
            }
            self.check_time(start, ANSWER_S, || "leave the fault".to_owned())?;
        }
    }

    /// Greets a controller that fell silent or was reset, for as long as it may take.
    pub(super) fn regreet(&mut self, joints: usize) -> Result<(), CampaignError> {
        let start = self.now_us();
        self.inbox.clear();
        self.banner = None;
        self.pending_fault = None;
        self.phase = Phase::Idle;
        self.greeting = true;
        let session = self.endpoint.next_session();
        self.journal.greet(session)?;
        let sequence = self.endpoint.send(Command::Hello);
        self.reply = None;
        while self.banner.is_none() || self.reply.is_none_or(|(number, _)| number != sequence) {
            self.check_interrupt()?;
            self.step()?;
            let silent_s = self.now_us().saturating_sub(start) as f64 * 1e-6;
            if silent_s > GREET_S {
                return Err(CampaignError::Lost { silent_s });
            }
        }
        self.banner
            .as_ref()
            .map_or(Ok(()), |banner| check_banner(banner, joints))
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

fn check_banner(banner: &Banner, joints: usize) -> Result<(), CampaignError> {
    if banner.protocol != PROTOCOL_VERSION {
        return Err(CampaignError::Protocol {
            version: banner.version.to_string(),
            found: banner.protocol,
            expected: PROTOCOL_VERSION,
        });
    }
    if banner.schema != SCHEMA {
        return Err(CampaignError::Schema {
            found: format!(
                "{:016x}, version {}, build {}",
                banner.schema, banner.version, banner.build
            ),
            expected: SCHEMA,
        });
    }
    let version = env!("CARGO_PKG_VERSION");
    if banner.version != version {
        return Err(CampaignError::Version {
            found: banner.version.to_string(),
            build: banner.build.to_string(),
            expected: version,
        });
    }
    if usize::from(banner.joints) != joints {
        return Err(CampaignError::Joints {
            controller: usize::from(banner.joints),
            robot: joints,
        });
    }
    Ok(())
}
