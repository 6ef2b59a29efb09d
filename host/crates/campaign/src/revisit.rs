//! Couplings, and the comparison of every second one with the first.
//!
//! ```text
//!   couple ─▶ seated: the place is known and this is it
//!          ├▶ again: the nest is off the sphere; another coupling must decide
//!          └▶ fault
//! ```
//!
//! After the poses of a placement every sphere is coupled once more, as at its first visit. So a
//! sphere that moved meanwhile is noticed while the arm is still there.

use spherecal_shared::protocol::host::{ApproachCommand, Command, Fault, Phase};

use super::CampaignError;
use super::observe::CampaignStage;
use super::procedure::{AtSphere, Campaign};
use super::retry::{CouplingEnd, DescentEnd, Waypoints};
use super::seats::SeatVerdict;
use super::session::{Session, Waited};
use super::words::describe;
use spherecal_plan::Visit;

/// Whether a fault can come from a sphere that is not where it was.
fn of_the_sphere(fault: Fault) -> bool {
    matches!(
        fault,
        Fault::NoContact
            | Fault::NotSeated
            | Fault::ContactLost
            | Fault::StillCoupled
            | Fault::Force
            | Fault::Pressing
            | Fault::PathDeviation
    )
}

impl Campaign<'_> {
    /// Touches and couples the sphere of `visit` from its approach frame, and compares the coupling
    /// with earlier ones.
    /// Errors: the sphere moved, or its couplings scatter; the nest is off the sphere then.
    pub(super) fn couple(&mut self, session: &mut Session<'_>, visit: &Visit) -> Result<CouplingEnd, CampaignError> {
        session.stage(CampaignStage::Couple, visit.sphere_id, self.assignment.plan);
        session.coupled = None;
        let approach = ApproachCommand {
            sphere: visit.sphere_id,
            direction: visit.approach_direction,
        };
        if let Some(report) = session.carry_out("approach", Command::Approach(approach))? {
            return Ok(CouplingEnd::Fault(report));
        }
        self.touching = true;
        let seated = |s: &Session<'_>| {
            s.coupled
                .filter(|c| c.sphere == visit.sphere_id && s.phase == Phase::Coupled)
        };
        let coupled = match session.wait("touch and couple", self.couple_limit(), seated)? {
            Waited::Got(coupled) => coupled,
            Waited::Fault(report) => return Ok(CouplingEnd::Fault(report)),
        };
        let found = self.places.check(visit, &coupled.centre_m);
        let seating = found.and_then(|()| {
            self.waypoints.seated(visit, &coupled);
            self.seats.take(visit, &coupled)
        });
        match &seating {
            Ok(SeatVerdict::Sound) => return Ok(CouplingEnd::Seated),
            Ok(SeatVerdict::Replaced(by_m)) => {
                session.note(&format!(
                    "sphere {}: its couplings are now {:.2} mm from its earlier ones: those had seated badly, or the sphere \
                     moved; see what the report says of its recordings",
                    visit.sphere_id,
                    by_m * 1e3
                ));
                return Ok(CouplingEnd::Seated);
            }
            Ok(SeatVerdict::Drifted(by_m)) => {
                session.note(&format!(
                    "sphere {}: {:.2} mm from its place before, as an arm and a plate that warm up may drift; let them warm \
                     up before a run",
                    visit.sphere_id,
                    by_m * 1e3
                ));
                return Ok(CouplingEnd::Seated);
            }
            Ok(SeatVerdict::Unconfirmed) => {}
            Ok(SeatVerdict::Off(by_m)) => session.note(&format!(
                "sphere {}: {:.2} mm from the couplings before; coupling again",
                visit.sphere_id,
                by_m * 1e3
            )),
            Err(error) => session.note(&error.to_string()),
        }
        let fault = self.leave(session)?;
        if let Err(error) = seating {
            if let Some(report) = fault {
                self.let_go(session, visit, report)?;
            }
            self.touching = false;
            return Err(error);
        }
        if let Some(report) = fault {
            return Ok(CouplingEnd::Fault(report));
        }
        self.touching = false;
        Ok(CouplingEnd::Again)
    }

    /// An attempt at a sphere. It tells what the coupling was worth: it counts with the first recording, and was none if the
    /// nest left the sphere in the first turn.
    pub(super) fn judged(&mut self, session: &mut Session<'_>, visit: &Visit) -> Result<AtSphere, CampaignError> {
        let before = self.recorded;
        let end = self.attempt(session, visit);
        if self.recorded > before {
            self.seats.recorded(visit);
        } else if matches!(&end, Ok(AtSphere::Fault(report, Some(_))) if report.fault == Fault::ContactLost) {
            self.seats.lost(visit);
        }
        end
    }

    /// Couples every sphere of the present placement once more whose place is known. Returns whether
    /// there was one.
    pub(super) fn second_visits(&mut self, session: &mut Session<'_>) -> Result<bool, CampaignError> {
        if !self.assignment.options.second_visits {
            return Ok(false);
        }
        let plan = self.assignment.plan;
        let visits = spherecal_plan::second_visits(plan, self.place, |visit| self.seats.knows(visit));
        for visit in &visits {
            self.with_reconnect(session, Some(visit), |campaign, session, _| {
                campaign.second_visit(session, visit)
            })?;
        }
        Ok(!visits.is_empty())
    }

    /// Goes to the approach frame of `visit`, over home if the straight way is not clear, and couples
    /// until there is a decision.
    fn second_visit(&mut self, session: &mut Session<'_>, visit: &Visit) -> Result<(), CampaignError> {
        let plan = self.assignment.plan;
        let attempts = self.assignment.options.attempts.max(1);
        let mut approach = visit.approach.joints.clone();
        if !self.is_straight(session, &approach) {
            session.stage(CampaignStage::Home, 0, plan);
            self.travel(session, "reach the home frame", &plan.home.joints)?;
        }
        let mut failed = 0;
        loop {
            session.stage(CampaignStage::Approach, visit.sphere_id, plan);
            self.travel(session, "reach the approach frame", &approach)?;
            let contacts = session.contacts.len();
            let report = match self.couple(session, visit)? {
                CouplingEnd::Seated => {
                    session.stage(CampaignStage::Decouple, visit.sphere_id, plan);
                    if let Some(report) = self.leave(session)? {
                        self.let_go(session, visit, report)?;
                    }
                    self.touching = false;
                    return Ok(());
                }
                CouplingEnd::Again => continue,
                CouplingEnd::Fault(report) => report,
            };
            failed += 1;
            if Waypoints::helps(&report) {
                let contact = session.contacts.get(contacts..).and_then(<[_]>::last);
                let last = DescentEnd::new(contact, session.sample().map(|s| s.tcp_m));
                approach = self.waypoints.retry(visit, failed, &last);
            }
            session.note(&format!(
                "sphere {}: {} at its second visit; recovering",
                visit.sphere_id,
                describe(&report)
            ));
            session.stage(CampaignStage::Recover, visit.sphere_id, plan);
            self.let_go(session, visit, report)?;
            self.touching = false;
            if failed >= attempts {
                return Err(if of_the_sphere(report.fault) {
                    CampaignError::Gone {
                        sphere: visit.sphere_id,
                        attempts: failed,
                        fault: report.fault,
                    }
                } else {
                    CampaignError::GivenUp {
                        sphere: visit.sphere_id,
                        attempts: failed,
                        report,
                    }
                });
            }
        }
    }
}
