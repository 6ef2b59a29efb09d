//! Teaching: the operator leads the arm by hand over each sphere. Where the arm then stands is the
//! waypoint, as in Section 4.2 of the paper.
//!
//! The campaign sees what it always sees. The waypoint is computed from the encoders by the nominal
//! model, and includes the operator's aiming error.

use std::sync::atomic::AtomicBool;

use spherecal_shared::protocol::host::{Command, Phase};

use super::observe::{CampaignObserver, CampaignStage};
use super::procedure::Campaign;
use super::session::{Session, Waited};
use super::{Assignment, CampaignError};
use spherecal_link::{Arrival, Device, Journal, JournalError};

/// Time limit for an operator to lead the arm to a sphere, in s of device time.
const LED_S: f64 = 600.0;
/// Control periods after which a released arm is at rest.
const REST_TICKS: u32 = 1500;

/// Who leads the arm.
pub trait Operator {
    /// The arm is compliant now: lead it over the sphere with this id.
    fn lead(&mut self, sphere: u32);

    /// Whether it is there.
    fn is_there(&mut self) -> bool;

    /// The arm holds again: let go.
    fn let_go(&mut self);
}

/// Where the arm was led to.
#[derive(Clone, Debug, PartialEq)]
pub struct Taught {
    /// Id of the sphere.
    pub sphere: u32,
    /// Placement of the plate, from 0.
    pub place: u32,
    /// Joint angles as the encoders show them, in rad.
    pub joints: Vec<f64>,
}

/// A journal that discards everything, for teaching and for studies that only listen.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoJournal;

impl Journal for NoJournal {
    fn append(&mut self, _: &[Arrival]) -> Result<(), JournalError> {
        Ok(())
    }

    fn reject(&mut self, _: u32, _: u32, _: &str) -> Result<(), JournalError> {
        Ok(())
    }
}

/// Has the arm led over every sphere of the plan from home, once per placement of the plate.
///
/// # Errors
/// Any error that stops teaching. A fault while the arm is led is cleared and the step repeated, as
/// often as the options allow.
pub fn teach(
    assignment: &Assignment<'_>,
    device: &mut dyn Device,
    operator: &mut dyn Operator,
    observer: &mut dyn CampaignObserver,
    interrupt: &AtomicBool,
) -> Result<Vec<Taught>, CampaignError> {
    let plan = assignment.plan;
    let mut nowhere = NoJournal;
    let lead_us = u64::from(assignment.options.lead_ms) * 1000;
    let mut session = Session::new(device, &mut nowhere, observer, interrupt, lead_us);
    let mut campaign = Campaign::new(assignment);
    campaign.begin(&mut session)?;
    session.stage(CampaignStage::Home, 0, plan);
    campaign.travel(&mut session, "reach the home frame", &plan.home.joints)?;
    let mut taught: Vec<Taught> = Vec::new();
    let mut stands = (!plan.several_places()).then_some(0);
    for visit in &plan.spheres {
        if taught
            .iter()
            .any(|t| (t.sphere, t.place) == (visit.sphere_id, visit.place))
        {
            continue;
        }
        campaign.have_plate(&mut session, &mut stands, visit.place)?;
        session.stage(CampaignStage::Teach, visit.sphere_id, plan);
        let joints = lead(assignment, &mut session, operator, visit.sphere_id)?;
        taught.push(Taught {
            sphere: visit.sphere_id,
            place: visit.place,
            joints,
        });
    }
    session.stage(CampaignStage::Home, 0, plan);
    campaign.travel(&mut session, "reach the home frame", &plan.home.joints)?;
    session.stage(CampaignStage::Done, 0, plan);
    Ok(taught)
}

fn lead(
    assignment: &Assignment<'_>,
    session: &mut Session<'_>,
    operator: &mut dyn Operator,
    sphere: u32,
) -> Result<Vec<f64>, CampaignError> {
    let attempts = assignment.options.attempts.max(1);
    let mut last = None;
    for _ in 0..attempts {
        session.order("be guided", Command::HandGuide { on: true })?;
        operator.lead(sphere);
        let led = session.wait("be led to the sphere", LED_S, |_| operator.is_there().then_some(()))?;
        let report = match led {
            Waited::Got(()) => {
                session.order("hold", Command::HandGuide { on: false })?;
                operator.let_go();
                session.drain(REST_TICKS)?;
                if session.phase == Phase::Idle
                    && let Some(sample) = session.sample()
                {
                    let q = sample.q.iter().take(assignment.robot.dof());
                    return Ok(q.map(|q| f64::from(*q)).collect());
                }
                session.pending_fault
            }
            Waited::Fault(report) => Some(report),
        };
        operator.let_go();
        if let Some(report) = report {
            session.note(&format!(
                "sphere {sphere}: {:?} while being led; trying again",
                report.fault
            ));
        }
        last = report.or(last);
        session.clear_fault()?;
    }
    Err(match last {
        Some(report) => CampaignError::GivenUp {
            sphere,
            attempts,
            report,
        },
        None => CampaignError::Timeout {
            what: "show where it stands".to_owned(),
            limit_s: f64::from(REST_TICKS) * 1e-3,
            phase: session.phase,
        },
    })
}
