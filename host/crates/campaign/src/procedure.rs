//! Algorithm 2 from the host's side, and Section 6 after a fault.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::AtomicBool;

use spherecal_shared::Joints;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::{Command, Fault, FaultReport, Phase, PoseCommand, Refusal};

use super::force::ForceSense;
use super::observe::{CampaignObserver, CampaignStage, Outcome, Rejected};
use super::places::Places;
use super::recovery::policy;
use super::retry::{CouplingEnd, DescentEnd, Waypoints};
use super::seats::Seats;
use super::session::{Session, Waited};
use super::words::describe;
use super::{Assignment, CampaignError};
use spherecal_link::{Device, Journal};
use spherecal_plan::Visit;

/// How work at a sphere ended.
pub(super) enum AtSphere {
    /// All poses are recorded or given up, and the nest is off the sphere.
    Finished,
    /// A fault; the arm holds.
    Fault(FaultReport, Option<u32>),
    /// Another coupling must confirm this one or decide. The nest is off the sphere.
    Again,
}

/// Runs a campaign to its end or to a typed stop. Returns the outcome in both cases.
pub fn run(
    assignment: &Assignment<'_>,
    cell: &mut dyn Device,
    journal: &mut dyn Journal,
    observer: &mut dyn CampaignObserver,
    interrupt: &AtomicBool,
) -> (Outcome, Result<(), CampaignError>) {
    let lead_us = u64::from(assignment.options.lead_ms) * 1000;
    let mut session = Session::new(cell, journal, observer, interrupt, lead_us);
    let mut campaign = Campaign::new(assignment);
    session.progress.done = campaign.done.len();
    session.progress.done_before = campaign.done.len();
    let mut result = campaign.all(&mut session);
    if matches!(result, Err(CampaignError::Interrupted)) {
        // Leave the arm holding and damped. A refusal here does not change the outcome.
        if let Err(error) = session.stop_at_once().and_then(|()| session.drain(20)) {
            result = Err(error);
        }
    }
    let outcome = Outcome {
        firmware: session
            .banner
            .as_ref()
            .map(|b| format!("{} {}", b.version, b.build).trim_end().to_owned())
            .unwrap_or_default(),
        recorded: campaign.recorded,
        rejected: campaign.rejected,
        faults: session.faults.clone(),
        contacts: session.contacts.clone(),
        simulated_us: session.now_us(),
        ticks: session.ticks(),
        link: session.counters(),
        statistics: session.statistics,
        telemetry: session.telemetry,
        drive: session.drive_record(),
    };
    (outcome, result)
}

pub(super) struct Campaign<'a> {
    pub(super) assignment: &'a Assignment<'a>,
    pub(super) done: BTreeSet<(u32, u32)>,
    pub(super) rejected: Vec<Rejected>,
    pub(super) recorded: usize,
    /// Whether the recordings are enough before the last pose.
    pub(super) enough: bool,
    pub(super) waypoints: Waypoints,
    pub(super) places: Places,
    pub(super) seats: Seats,
    /// Placement in which the plate stands.
    pub(super) place: u32,
    /// Whether the nest may be on a sphere.
    pub(super) touching: bool,
    /// What the controller works with.
    pub(super) procedure: Procedure,
}

impl<'a> Campaign<'a> {
    /// A campaign that has done nothing in this session.
    pub(super) fn new(assignment: &'a Assignment<'a>) -> Self {
        let waypoints = Waypoints::new(assignment.robot, assignment.tool);
        Self {
            assignment,
            done: assignment.done.clone(),
            rejected: Vec::new(),
            recorded: 0,
            enough: false,
            places: Places::recall(assignment.plan, assignment.seated, waypoints.chain()),
            seats: Seats::recall(assignment.plan, assignment.seated, assignment.options.confirm_seats),
            waypoints,
            place: 0,
            touching: false,
            procedure: *assignment.procedure,
        }
    }

    /// Performs the handshake and sends the controller robot, tool and procedure.
    pub(super) fn begin(&self, session: &mut Session<'_>) -> Result<(), CampaignError> {
        session.stage(CampaignStage::Connect, 0, self.assignment.plan);
        session.handshake(self.assignment.robot.dof())?;
        session.clear_fault()?;
        self.take_over(session)?;
        self.configure(session)
    }

    pub(super) fn configuration(&self) -> Command {
        Command::Configure {
            tool: *self.assignment.tool,
            procedure: self.procedure,
        }
    }

    /// Sends robot and procedure; a fault that comes meanwhile is cleared, and both are sent again.
    pub(super) fn configure(&self, session: &mut Session<'_>) -> Result<(), CampaignError> {
        session.sense = Some(ForceSense::new(self.assignment.robot, self.assignment.tool));
        let attempts = self.assignment.options.attempts.max(1);
        for attempt in 1.. {
            let robot = Command::Robot(self.assignment.robot.driven()?);
            let report = match session.carry_out("take the robot", robot)? {
                None => session.carry_out("take the procedure", self.configuration())?,
                fault => fault,
            };
            let Some(report) = report else {
                break;
            };
            if attempt >= attempts {
                let what = "take robot and procedure".to_owned();
                return Err(CampaignError::Motion { what, attempts, report });
            }
            session.clear_fault()?;
        }
        Ok(())
    }

    /// Brings a controller that an earlier host left in the middle of a step to rest in free space.
    /// The configuration that follows says that the nest is free, so an arm that is still on a
    /// sphere must leave it first.
    pub(super) fn take_over(&self, session: &mut Session<'_>) -> Result<(), CampaignError> {
        for _ in 0..self.assignment.options.attempts.max(1) {
            match session.ask("stop", Command::Stop)? {
                Ok(()) | Err(Refusal::FaultPending) => {}
                Err(refusal) => {
                    return Err(CampaignError::Refused {
                        what: "stop".to_owned(),
                        refusal,
                    });
                }
            }
            match self.leave(session) {
                Ok(None) => {
                    session.note("an earlier host left the arm on a sphere");
                    return Ok(());
                }
                Ok(Some(_)) => {
                    session.clear_fault()?;
                }
                // New, or nothing was touched.
                Err(CampaignError::Refused {
                    refusal: Refusal::Phase | Refusal::NotConfigured,
                    ..
                }) => return Ok(()),
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    fn all(&mut self, session: &mut Session<'_>) -> Result<(), CampaignError> {
        let plan = self.assignment.plan;
        self.with_reconnect(session, None, |campaign, session, again| {
            // After a reconnection the controller has already been configured, and the nest is free.
            if again {
                return Ok(());
            }
            campaign.begin(session)?;
            let goes_on = !campaign.done.is_empty() || !campaign.assignment.seated.is_empty();
            if goes_on {
                campaign.free_the_nest(session)
            } else {
                Ok(())
            }
        })?;
        // Whether the arm is away from home, and the visit that it has just left as planned.
        let (mut away, mut left) = (false, None);
        let mut stands = (!plan.several_places()).then_some(0);
        for (number, visit) in plan.spheres.iter().enumerate() {
            self.with_reconnect(session, None, |campaign, session, _| campaign.ask_enough(session))?;
            if self.pending(visit).is_empty() {
                continue;
            }
            if stands.is_some_and(|place| place != visit.place) {
                self.second_visits(session)?;
            }
            let at_home = self.have_plate(session, &mut stands, visit.place)?;
            let straight = at_home || (!visit.over_home && left.is_some_and(|l| l + 1 == number));
            let faults = session.faults.len();
            let lost = self.with_reconnect(session, Some(visit), |campaign, session, again| {
                if again || !straight {
                    session.stage(CampaignStage::Home, 0, plan);
                    campaign.travel(session, "reach the home frame", &plan.home.joints)?;
                }
                if campaign.pending(visit).is_empty() {
                    return Ok(());
                }
                campaign.sphere(session, visit)
            })?;
            away = true;
            left = (!lost && session.faults.len() == faults).then_some(number);
        }
        if stands.is_some() {
            away |= self.second_visits(session)?;
        }
        if away {
            self.with_reconnect(session, None, |campaign, session, _| {
                session.stage(CampaignStage::Home, 0, plan);
                campaign.travel(session, "reach the home frame", &plan.home.joints)
            })?;
        }
        session.drain(20)?;
        session.stage(CampaignStage::Done, 0, plan);
        Ok(())
    }

    /// All poses of one sphere, with as many attempts as are needed and allowed.
    pub(super) fn sphere(&mut self, session: &mut Session<'_>, visit: &Visit) -> Result<(), CampaignError> {
        let plan = self.assignment.plan;
        let mut in_vain = 0;
        let mut failures: BTreeMap<u32, u32> = BTreeMap::new();
        let mut approach = visit.approach.joints.clone();
        // Descents in a row that did not find the seat.
        let mut missed = 0;
        loop {
            session.stage(CampaignStage::Approach, visit.sphere_id, plan);
            self.travel(session, "reach the approach frame", &approach)?;
            let before = self.recorded;
            let contacts = session.contacts.len();
            let (report, pose) = match self.judged(session, visit)? {
                AtSphere::Finished => {
                    self.touching = false;
                    return Ok(());
                }
                AtSphere::Again => continue,
                AtSphere::Fault(report, pose) => (report, pose),
            };
            // Where slower turns may help, neither pose nor sphere is given up.
            let again = pose.is_some_and(|pose| failures.contains_key(&pose));
            let slower = self.slower_turn(&report, again);
            let new = self.recorded > before || slower.is_some();
            in_vain = if new { 1 } else { in_vain + 1 };
            if Waypoints::helps(&report) {
                missed += 1;
                let contact = session.contacts.get(contacts..).and_then(<[_]>::last);
                let last = DescentEnd::new(contact, session.sample().map(|s| s.tcp_m));
                approach = self.waypoints.retry(visit, missed, &last);
            }
            let what = describe(&report);
            session.note(&format!("sphere {}: {what}; recovering", visit.sphere_id));
            if let Some(pose) = pose
                && policy(report.fault).blames_pose
            {
                let count = failures.entry(pose).or_default();
                *count += 1;
                if *count >= self.assignment.options.pose_attempts && slower.is_none() {
                    self.give_up_pose(session, visit.sphere_id, pose, &report)?;
                    in_vain = 0;
                }
            }
            session.stage(CampaignStage::Recover, visit.sphere_id, plan);
            self.let_go(session, visit, report)?;
            self.touching = false;
            if let Some(speed_rad_s) = slower {
                self.turn_with(session, speed_rad_s)?;
            }
            if in_vain >= self.assignment.options.attempts {
                return Err(if report.fault == Fault::NoContact {
                    CampaignError::NoContact {
                        sphere: visit.sphere_id,
                        attempts: in_vain,
                    }
                } else {
                    CampaignError::GivenUp {
                        sphere: visit.sphere_id,
                        attempts: in_vain,
                        report,
                    }
                });
            }
            if self.pending(visit).is_empty() {
                return Ok(());
            }
        }
    }

    /// Time limit from the start of the descent to the seated nest, in s.
    pub(super) fn couple_limit(&self) -> f64 {
        let p = self.assignment.procedure;
        p.approach.tare_s + 2.0 * p.approach.travel_m / p.approach.speed_m_s + p.couple.hold_s + p.seating.test_s + 30.0
    }

    /// One approach: touch, couple, poses, decouple.
    pub(super) fn attempt(&mut self, session: &mut Session<'_>, visit: &Visit) -> Result<AtSphere, CampaignError> {
        let plan = self.assignment.plan;
        let p = self.assignment.procedure;
        match self.couple(session, visit)? {
            CouplingEnd::Seated => {}
            CouplingEnd::Again => return Ok(AtSphere::Again),
            CouplingEnd::Fault(report) => return Ok(AtSphere::Fault(report, None)),
        }
        session.stage(CampaignStage::Poses, visit.sphere_id, plan);
        let pending = self.pending(visit);
        let limit = 30.0 + p.turn.longest_settle_s() + 2e-3 * f64::from(p.record.samples);
        for pose in pending {
            self.ask_enough(session)?;
            if self.enough && !pose.via {
                continue;
            }
            session.recorded = None;
            session.passed = None;
            let command = Command::Pose(PoseCommand {
                pose: pose.id,
                orientation: pose.orientation,
                elbow_rad: pose.elbow_rad,
                posture: joints(&pose.joints),
                record: !pose.via,
            });
            match session.ask("take a pose", command)? {
                Ok(()) => {}
                Err(Refusal::FaultPending) => {}
                Err(Refusal::Target) if pose.via => continue,
                Err(refusal @ Refusal::Target) => {
                    self.reject(session, visit.sphere_id, pose.id, &refusal.to_string())?;
                    continue;
                }
                Err(refusal) => {
                    return Err(CampaignError::Refused {
                        what: format!("take pose {} (sphere {})", pose.id, visit.sphere_id),
                        refusal,
                    });
                }
            }
            let wanted = (visit.sphere_id, pose.id);
            let there = |s: &Session<'_>| {
                let there = s.recorded == Some(wanted) || (pose.via && s.passed == Some(pose.id));
                (there && s.phase == Phase::Coupled).then_some(())
            };
            let waited = session.wait("record a pose", limit, there);
            // Stored, so it counts, whatever came after it.
            self.count(session);
            if let Waited::Fault(report) = waited? {
                return Ok(AtSphere::Fault(report, (!pose.via).then_some(pose.id)));
            }
        }

        session.stage(CampaignStage::Decouple, visit.sphere_id, plan);
        if let Some(report) = self.leave(session)? {
            self.let_go(session, visit, report)?;
        }
        Ok(AtSphere::Finished)
    }

    /// Has the plate moved to `place` unless it `stands` there, with the arm at home. Returns
    /// whether the arm moved home for that.
    pub(super) fn have_plate(
        &mut self,
        session: &mut Session<'_>,
        stands: &mut Option<u32>,
        place: u32,
    ) -> Result<bool, CampaignError> {
        if *stands == Some(place) {
            return Ok(false);
        }
        let plan = self.assignment.plan;
        session.stage(CampaignStage::Home, 0, plan);
        self.travel(session, "reach the home frame", &plan.home.joints)?;
        session.stage(CampaignStage::Plate, 0, plan);
        session.plate(place)?;
        self.place = place;
        *stands = Some(place);
        Ok(true)
    }
}

/// Joint values in the link's type. Values beyond the protocol's maximum are cut, and the
/// controller then refuses the rest.
pub(super) fn joints(values: &[f64]) -> Joints {
    values.iter().copied().take(spherecal_shared::MAX_JOINTS).collect()
}
