//! What a campaign does after a fault, and after the controller was lost: Section 6 of the paper.
//! How long it waits and how often it tries is in [`recovery`](super::recovery).

use spherecal_shared::protocol::host::{Command, FaultReport, Refusal};

use super::CampaignError;
use super::observe::CampaignStage;
use super::procedure::{Campaign, joints};
use super::recovery::policy;
use super::session::Session;
use spherecal_plan::{Scene, Visit};

/// Time limit of a free motion at the usual speed, in s of device time: half a turn takes an arm 8 s.
const MOTION_S: f64 = 60.0;
/// That usual speed, in rad/s.
const USUAL_RAD_S: f64 = 0.5;

/// Delay before a fault is cleared, in s, at attempt number `attempt` from 0.
fn pause_s(report: &FaultReport, attempt: u32) -> f64 {
    policy(report.fault).pause_s * f64::from(1u32 << attempt.min(8))
}

impl Campaign<'_> {
    /// Carries out `work`, and repeats it after the controller was lost and found again: without
    /// limit while new recordings arrive, otherwise for a limited number of failed attempts.
    /// Returns whether the controller was lost. `work` is told whether this is a repetition.
    pub(super) fn with_reconnect(
        &mut self,
        session: &mut Session<'_>,
        visit: Option<&Visit>,
        work: impl Fn(&mut Self, &mut Session<'_>, bool) -> Result<(), CampaignError>,
    ) -> Result<bool, CampaignError> {
        let (mut in_vain, mut again) = (0, false);
        loop {
            let before = self.recorded;
            match work(self, session, again) {
                Err(lost @ (CampaignError::Lost { .. } | CampaignError::Restarted)) => {
                    again = true;
                    in_vain = if self.recorded > before { 1 } else { in_vain + 1 };
                    if in_vain > self.assignment.options.attempts {
                        return Err(lost);
                    }
                    while let Err(error) = self.reconnect(session, visit) {
                        in_vain += 1;
                        let lost = matches!(error, CampaignError::Lost { .. } | CampaignError::Restarted);
                        if !lost || in_vain > self.assignment.options.attempts {
                            return Err(error);
                        }
                    }
                }
                other => return other.map(|()| again),
            }
        }
    }

    /// Decouples from the sphere. Returns the fault, if one came.
    pub(super) fn leave(&self, session: &mut Session<'_>) -> Result<Option<FaultReport>, CampaignError> {
        session.carry_to_rest("leave the sphere", Command::Decouple, self.decouple_limit())
    }

    fn decouple_limit(&self) -> f64 {
        let p = &self.assignment.procedure.decouple;
        p.retreat_m / p.speed_m_s + p.settle_s + 20.0
    }

    /// The scene in which the arm moves: the plate where it stands, and the spheres where they were
    /// found. `None` if the planner cannot compute with the robot.
    pub(super) fn scene(&self) -> Option<Scene> {
        let chain = self.waypoints.chain()?;
        let found = self.places.found(self.place);
        let limits = &self.assignment.procedure.limits;
        Some(Scene::new(self.assignment.plan, chain, self.place, limits, &found))
    }

    /// Joint angles of the newest sample, in rad.
    fn posture(&self, session: &Session<'_>) -> Option<Vec<f64>> {
        let n = self.assignment.robot.dof();
        let sample = session.sample()?;
        let q: Vec<f64> = sample.q.iter().take(n).map(|q| f64::from(*q)).collect();
        (q.len() == n).then_some(q)
    }

    /// Direction of approach opposite to the best retreat from the sphere of `visit`.
    fn way_off(&self, session: &Session<'_>, visit: &Visit) -> [f64; 3] {
        let straight = visit.approach_direction;
        let (Some(scene), Some(q)) = (self.scene(), self.posture(session)) else {
            return straight;
        };
        scene.retreat(&q, straight, self.assignment.procedure.decouple.retreat_m)
    }

    /// Decouples from the sphere of `visit` after a fault, away from what the nest touches and in a
    /// direction that leaves the joints room. Returns the fault, if one came. Does nothing if there
    /// was no contact.
    fn pull_off(&self, session: &mut Session<'_>, visit: &Visit) -> Result<Option<FaultReport>, CampaignError> {
        let way = if self.touching {
            self.way_off(session, visit)
        } else {
            visit.approach_direction
        };
        if way != visit.approach_direction {
            let retreat = Command::Retreat { direction: way };
            return session.carry_to_rest(
                "retreat from the sphere beside its approach direction",
                retreat,
                self.decouple_limit(),
            );
        }
        match self.leave(session) {
            Err(CampaignError::Refused {
                refusal: Refusal::Phase,
                ..
            }) => Ok(None),
            other => other,
        }
    }

    /// Clears the fault, decouples the nest if it is coupled, and leaves the arm holding in free
    /// space. Waits first, and longer each time the fault returns.
    pub(super) fn let_go(
        &self,
        session: &mut Session<'_>,
        visit: &Visit,
        first: FaultReport,
    ) -> Result<(), CampaignError> {
        let attempts = self.assignment.options.attempts.max(1);
        let mut report = first;
        for attempt in 0..attempts {
            session.rest(pause_s(&report, attempt))?;
            if let Some(again) = session.clear_fault()? {
                report = again;
                continue;
            }
            let Some(again) = self.pull_off(session, visit)? else {
                return Ok(());
            };
            report = again;
        }
        Err(CampaignError::GivenUp {
            sphere: visit.sphere_id,
            attempts,
            report,
        })
    }

    /// Repeats the handshake with a controller that was lost, configures it again, and retreats
    /// along the approach of `visit` if the nest may be on a sphere, because a controller that was
    /// reset does not know that. From here a link that was down looks the same as a controller that
    /// was reset, and needs the same steps.
    fn reconnect(&mut self, session: &mut Session<'_>, visit: Option<&Visit>) -> Result<(), CampaignError> {
        session.note("the controller was reset or silent: repeating the handshake");
        session.stage(
            CampaignStage::Recover,
            visit.map_or(0, |s| s.sphere_id),
            self.assignment.plan,
        );
        session.repeat_handshake(self.assignment.robot.dof())?;
        session.clear_fault()?;
        self.take_over(session)?;
        self.configure(session)?;
        // Its last recording may have been in transit when it was lost.
        self.count(session);
        let Some(visit) = visit.filter(|_| self.touching) else {
            return Ok(());
        };
        let attempts = self.assignment.options.attempts.max(1);
        let mut last = None;
        for attempt in 0..attempts {
            let direction = self.way_off(session, visit);
            let retreat = Command::Retreat { direction };
            let Some(report) = session.carry_to_rest("retreat from the sphere", retreat, self.decouple_limit())? else {
                self.touching = false;
                return Ok(());
            };
            session.rest(pause_s(&report, attempt))?;
            last = session.clear_fault()?.or(Some(report));
        }
        last.map_or(Ok(()), |report| {
            Err(CampaignError::GivenUp {
                sphere: visit.sphere_id,
                attempts,
                report,
            })
        })
    }

    /// A free motion to `target` (rad), with as many attempts as are allowed. Where the straight
    /// joint motion would come too near to spheres, plate, arm or limits, it goes through vias. After
    /// a fault the way is planned again from where the arm stands.
    pub(super) fn travel(&self, session: &mut Session<'_>, what: &str, target: &[f64]) -> Result<(), CampaignError> {
        let attempts = self.assignment.options.attempts.max(1);
        let mut last = None;
        for attempt in 0..attempts {
            let Some(report) = self.go(session, what, target)? else {
                return Ok(());
            };
            session.rest(pause_s(&report, attempt))?;
            last = session.clear_fault()?.or(Some(report));
        }
        last.map_or(Ok(()), |report| {
            Err(CampaignError::Motion {
                what: what.to_owned(),
                attempts,
                report,
            })
        })
    }

    /// Whether the straight joint motion to `target` (rad) is clear.
    pub(super) fn is_straight(&self, session: &Session<'_>, target: &[f64]) -> bool {
        let (Some(scene), Some(q)) = (self.scene(), self.posture(session)) else {
            return false;
        };
        scene.way(&q, target).is_some_and(|way| way.len() == 1)
    }

    /// Time limit of a free motion at the speed of the procedure, in s.
    fn motion_limit(&self) -> f64 {
        MOTION_S * (USUAL_RAD_S / self.assignment.procedure.motion.speed_rad_s).max(1.0)
    }

    /// One free motion on a clear way. Returns the fault, if one came.
    pub(super) fn go(
        &self,
        session: &mut Session<'_>,
        what: &str,
        target: &[f64],
    ) -> Result<Option<FaultReport>, CampaignError> {
        let way = match (self.scene(), self.posture(session)) {
            (Some(scene), Some(q)) => scene
                .way(&q, target)
                .ok_or_else(|| CampaignError::Blocked { what: what.to_owned() })?,
            // Before the first sample nothing is known of the arm.
            _ => vec![target.to_vec()],
        };
        if way.len() > 1 {
            session.note(&format!(
                "the straight motion to {what} is not clear: {} vias",
                way.len() - 1
            ));
        }
        for target in way {
            let target = joints(&target);
            if let Some(report) = session.carry_to_rest(what, Command::Move { target }, self.motion_limit())? {
                return Ok(Some(report));
            }
        }
        Ok(None)
    }
}
