//! Steps 2 to 5: the controller holds the arm, moves it and touches a sphere.

use std::sync::atomic::AtomicBool;

use nalgebra::Vector3;
use spherecal_link::Device;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::{ApproachCommand, Command, FaultReport, Phase};
use spherecal_shared::robot::JointLimits;

use super::figure::{late, punctuality};
use super::watch::{CALM, MovingLimits, SLOW, SOFT, WatchedSamples, aside, gentle};
use super::{Attendant, CommissioningStep, Figure, StepEnd, StepReport};
use crate::observe::{CampaignObserver, CampaignStage};
use crate::procedure::{Campaign, joints};
use crate::session::{Session, Waited};
use crate::teach::NoJournal;
use crate::{Assignment, CampaignError, describe, remedy};

/// Time limit of one turn, in s.
const TURN_S: f64 = 60.0;
/// The largest speed that counts as the set one, as a factor.
const OVERSHOOT: f64 = 1.5;

struct CommissioningInProgress<'a, 's> {
    assignment: &'a Assignment<'a>,
    session: Session<'s>,
    attendant: &'a mut dyn Attendant,
    limits: MovingLimits,
    joints: Vec<JointLimits>,
}

/// Steps 2 to 5, as far as they pass. The arm is told to stop at the end of every way.
///
/// # Errors
/// The link fails, a report cannot be kept, or the user interrupts. A fault of the controller is not an error: the step
/// has failed.
pub fn commission_moving(
    assignment: &Assignment<'_>,
    device: &mut dyn Device,
    limits: &MovingLimits,
    attendant: &mut dyn Attendant,
    observer: &mut dyn CampaignObserver,
    interrupt: &AtomicBool,
) -> Result<Vec<StepReport>, CampaignError> {
    let mut nowhere = NoJournal;
    let lead_us = u64::from(assignment.options.lead_ms) * 1000;
    let mut commissioning = CommissioningInProgress {
        assignment,
        session: Session::new(device, &mut nowhere, observer, interrupt, lead_us),
        attendant,
        limits: *limits,
        joints: assignment.robot.joints.iter().map(|j| j.limits).collect(),
    };
    let mut reports = Vec::new();
    let result = commissioning.all(&mut reports);
    let stopped = commissioning.stop();
    result.and(stopped).map(|()| reports)
}

impl CommissioningInProgress<'_, '_> {
    fn all(&mut self, reports: &mut Vec<StepReport>) -> Result<(), CampaignError> {
        for step in CommissioningStep::ALL.into_iter().skip(1) {
            let ended = self.step(step);
            if self.session.statistics.simulated {
                self.attendant.simulated();
            }
            match ended {
                Ok(report) if report.verdict == StepEnd::Passed => {
                    self.attendant.done(&report)?;
                    reports.push(report);
                }
                Ok(report) => {
                    // First the arm, then the report: to keep it takes time.
                    let stopped = self.stop();
                    self.attendant.done(&report)?;
                    reports.push(report);
                    return stopped;
                }
                Err(error) => {
                    // What ended the procedure is kept, too. This error counts, not those that it causes.
                    let _ = self.stop();
                    let ended = StepReport::of(step, Vec::new(), Vec::new()).failed(error.to_string());
                    let _ = self.attendant.done(&ended);
                    return Err(error);
                }
            }
        }
        Ok(())
    }

    fn step(&mut self, step: CommissioningStep) -> Result<StepReport, CampaignError> {
        self.attendant.tell(step.expectation());
        let begun = step != CommissioningStep::ZeroStiffness;
        match self.agrees("Begin?", begun)? {
            Waited::Got(true) => {}
            Waited::Got(false) => return Ok(StepReport::declined(step)),
            Waited::Fault(fault) => return Ok(faulted(step, Vec::new(), &fault)),
        }
        let before = self.session.statistics;
        let done = match step {
            CommissioningStep::ReadOnly | CommissioningStep::ZeroStiffness => self.zero_stiffness()?,
            CommissioningStep::SoftHold => self.soft_hold()?,
            CommissioningStep::FreeMotion => self.free_motion()?,
            CommissioningStep::Contact => self.contact()?,
        };
        let punctuality = punctuality(&before, &self.session.statistics, self.limits.missed_share);
        let figures = |found: Vec<Figure>| found.into_iter().chain(punctuality.clone()).collect();
        let report = match done {
            Waited::Got(found) => late(StepReport::of(step, figures(found), Vec::new())),
            Waited::Fault(fault) => return Ok(late(faulted(step, figures(Vec::new()), &fault))),
        };
        if report.verdict != StepEnd::Passed {
            // Nothing is left to ask, and an answer would take time.
            return Ok(report);
        }
        Ok(match self.agrees("Was it as expected, without noise or trembling?", true)? {
            Waited::Got(true) => report,
            Waited::Got(false) => report.failed(
                "the person at the robot saw something else than expected: find out what, before the arm moves again"
                    .to_owned(),
            ),
            Waited::Fault(fault) => faulted(step, report.figures, &fault),
        })
    }

    /// The answer to a question. The arm is kept alive meanwhile, once the session has begun.
    fn agrees(&mut self, question: &str, begun: bool) -> Result<Waited<bool>, CampaignError> {
        self.attendant.ask(question);
        let attendant = &mut self.attendant;
        if begun {
            return self.session.wait("be answered", f64::INFINITY, |_| attendant.answer());
        }
        loop {
            if let Some(answer) = attendant.answer() {
                return Ok(Waited::Got(answer));
            }
            self.session.check_interrupt()?;
            // Before the first command nothing has to be kept alive but the link.
            self.session.step()?;
        }
    }

    /// Watches the arm for a while, or until a joint has moved by more than `moved_rad` or moves too fast.
    fn watch(&mut self, moved_rad: f64) -> Result<Waited<WatchedSamples>, CampaignError> {
        let (mut watch, limits) = (WatchedSamples::default(), &self.joints);
        let most_rad_s = self.limits.hold_rad_s;
        let (begun, time_us) = (self.session.now_us(), (self.limits.hold_s * 1e6) as u64);
        self.session.wait("be watched", 10.0 * self.limits.hold_s, |s| {
            watch.add(&s.samples, limits, s.period_s());
            let beyond = watch.moved_rad > moved_rad || watch.speed_rad_s > most_rad_s;
            let over = beyond || s.now_us().saturating_sub(begun) >= time_us;
            (over && watch.first.is_some()).then(|| watch.clone())
        })
    }

    fn configure(&mut self, procedure: &Procedure) -> Result<(), CampaignError> {
        let command = Command::Configure {
            tool: *self.assignment.tool,
            procedure: *procedure,
        };
        self.session.order("take the procedure", command)
    }

    fn zero_stiffness(&mut self) -> Result<Waited<Vec<Figure>>, CampaignError> {
        // The controller holds as soon as it is configured: softly, from the first moment on.
        let soft = gentle(self.assignment.procedure, SLOW, SOFT);
        let assignment = Assignment {
            procedure: &soft,
            ..*self.assignment
        };
        Campaign::new(&assignment).begin(&mut self.session)?;
        if let Some(fault) = self.session.carry_out("be guided", Command::HandGuide { on: true })? {
            return Ok(Waited::Fault(fault));
        }
        let watch = match self.watch(self.limits.sink_rad)? {
            Waited::Got(watch) => watch,
            Waited::Fault(fault) => return Ok(Waited::Fault(fault)),
        };
        let hold = self
            .session
            .carry_to_rest("hold", Command::HandGuide { on: false }, TURN_S)?;
        Ok(match hold {
            None => Waited::Got(watch.held(&self.limits, self.limits.sink_rad)),
            Some(fault) => Waited::Fault(fault),
        })
    }

    fn soft_hold(&mut self) -> Result<Waited<Vec<Figure>>, CampaignError> {
        self.session.stage(CampaignStage::Home, 0, self.assignment.plan);
        Ok(match self.watch(self.limits.soft_rad)? {
            Waited::Got(watch) => Waited::Got(watch.held(&self.limits, self.limits.soft_rad)),
            Waited::Fault(fault) => Waited::Fault(fault),
        })
    }

    fn free_motion(&mut self) -> Result<Waited<Vec<Figure>>, CampaignError> {
        let slow = gentle(self.assignment.procedure, SLOW, 1.0);
        self.configure(&slow)?;
        let Some(start) = self.session.sample() else {
            return Err(CampaignError::Timeout {
                what: "show where it stands".to_owned(),
                limit_s: self.limits.hold_s,
                phase: self.session.phase,
            });
        };
        let start: Vec<f64> = start.q.iter().take(self.joints.len()).map(|q| f64::from(*q)).collect();
        let assignment = Assignment {
            procedure: &slow,
            ..*self.assignment
        };
        let scene = Campaign::new(&assignment).scene();
        let mut watch = WatchedSamples::default();
        let mut missed_rad = 0.0f64;
        for (j, limit) in self.joints.clone().into_iter().enumerate() {
            let margin = self.assignment.procedure.limits.position_margin_rad;
            let clear = |away: &[f64]| scene.as_ref().is_none_or(|scene| scene.is_clear(&start, away));
            let Some(away) = aside(&start, j, &limit, margin, clear) else {
                return Err(CampaignError::Crowded { joint: j + 1 });
            };
            for target in [&away, &start] {
                if let Some(fault) = self.turn(j, target, &mut watch)? {
                    return Ok(Waited::Fault(fault));
                }
                let reached = watch.last.q.iter().zip(target).map(|(q, t)| (f64::from(*q) - t).abs());
                missed_rad = missed_rad.max(reached.fold(0.0, f64::max));
            }
        }
        let motion = &slow.motion;
        Ok(Waited::Got(vec![
            Figure::judged(
                "largest distance from a target at rest",
                missed_rad.to_degrees(),
                "deg",
                motion.tolerance_rad.to_degrees(),
            ),
            Figure::judged(
                "largest joint speed, mean of 0.2 s",
                watch.mean_rad_s.to_degrees(),
                "deg/s",
                (OVERSHOOT * motion.speed_rad_s).to_degrees(),
            ),
            Figure::shown("largest joint speed", watch.speed_rad_s.to_degrees(), "deg/s"),
            Figure::judged(
                "largest commanded torque, of the joint's limit",
                watch.torque_share * 100.0,
                "%",
                self.limits.torque_share * 100.0,
            ),
            Figure::judged("samples with a torque at its limit", watch.saturated as f64, "", 0.0),
        ]))
    }

    /// One motion of joint `j` (from 0) to `target`. Returns the fault, if one came.
    fn turn(
        &mut self,
        j: usize,
        target: &[f64],
        watch: &mut WatchedSamples,
    ) -> Result<Option<FaultReport>, CampaignError> {
        let what = format!("turn joint {}", j + 1);
        let command = Command::Move { target: joints(target) };
        if let Some(fault) = self.session.carry_out(&what, command)? {
            return Ok(Some(fault));
        }
        let limits = &self.joints;
        let waited = self.session.wait(&what, TURN_S, |s| {
            watch.add(&s.samples, limits, s.period_s());
            s.rests().then_some(())
        })?;
        Ok(match waited {
            Waited::Got(()) => None,
            Waited::Fault(fault) => Some(fault),
        })
    }

    fn contact(&mut self) -> Result<Waited<Vec<Figure>>, CampaignError> {
        let calm = gentle(self.assignment.procedure, CALM, 1.0);
        self.configure(&calm)?;
        let assignment = Assignment {
            procedure: &calm,
            ..*self.assignment
        };
        let campaign = Campaign::new(&assignment);
        let plan = assignment.plan;
        let session = &mut self.session;
        let Some(visit) = plan.spheres.first() else {
            return Err(CampaignError::Blocked {
                what: "sphere 1: the plan visits no sphere".to_owned(),
            });
        };
        session.stage(CampaignStage::Home, 0, plan);
        for (what, target) in [
            ("reach the home frame", &plan.home.joints),
            ("reach the approach frame", &visit.approach.joints),
        ] {
            if let Some(fault) = campaign.go(session, what, target)? {
                return Ok(Waited::Fault(fault));
            }
        }
        session.stage(CampaignStage::Couple, visit.sphere_id, plan);
        session.coupled = None;
        let contacts = session.contacts.len();
        let approach = ApproachCommand {
            sphere: visit.sphere_id,
            direction: visit.approach_direction,
        };
        if let Some(fault) = session.carry_out("approach", Command::Approach(approach))? {
            return Ok(Waited::Fault(fault));
        }
        let limit_s = campaign.couple_limit();
        let coupled = session.wait("touch and couple", limit_s, |s| {
            s.coupled.filter(|_| s.phase == Phase::Coupled)
        })?;
        let coupled = match coupled {
            Waited::Got(coupled) => coupled,
            Waited::Fault(fault) => return Ok(Waited::Fault(fault)),
        };
        if let Some(fault) = campaign.leave(session)? {
            return Ok(Waited::Fault(fault));
        }
        let off = (Vector3::from(coupled.centre_m) - Vector3::from(visit.position_m)).norm();
        let mut figures = Vec::new();
        if let Some(contact) = session.contacts.get(contacts) {
            let tare = Vector3::from(contact.tare_n).norm();
            figures.extend([
                Figure::judged("tare: force before the contact", tare, "N", calm.approach.tare_limit_n),
                Figure::shown("steady force at the contact", contact.force_n, "N"),
                Figure::judged(
                    "largest force of the descent, mean of 10 ms",
                    contact.peak_n,
                    "N",
                    self.limits.peak_n,
                ),
                Figure::shown("way to the contact", contact.travel_m * 1e3, "mm"),
            ]);
        }
        figures.extend([
            Figure::shown("movement from contact to seat", coupled.shift_m * 1e3, "mm"),
            Figure::judged(
                "movement under the test pull",
                coupled.test_m * 1e3,
                "mm",
                calm.seating.test_m * 1e3,
            ),
            Figure::shown("sphere from its nominal place", off * 1e3, "mm"),
        ]);
        Ok(Waited::Got(figures))
    }

    /// Has the arm stop and hold, where it moves.
    fn stop(&mut self) -> Result<(), CampaignError> {
        if self.session.banner.is_none() {
            return Ok(());
        }
        if !matches!(self.session.phase, Phase::Idle | Phase::Fault) {
            self.session.stop_at_once()?;
        }
        self.session.drain(20)
    }
}

/// The report of a step that a fault ended.
fn faulted(step: CommissioningStep, figures: Vec<Figure>, fault: &FaultReport) -> StepReport {
    StepReport::of(step, figures, Vec::new()).failed(format!(
        "the controller stopped with {}: {}. The arm holds, or its brakes are closed",
        describe(fault),
        remedy(fault.fault)
    ))
}
