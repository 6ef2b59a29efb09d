//! What a campaign does after a fault, and after the controller was lost: Section 6 of the paper.
//! How long it waits and how often it tries is in [`recovery`](super::recovery).

use nalgebra::Vector3;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::{Command, Fault, FaultReport, Phase, Refusal};

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

/// How much slower than in the paper the arm turns where the paper's speed did not help.
const SLOWER: f64 = 3.0;

/// Distance of the computed TCP from the place where a sphere is expected, in m, from which on the nest is not on it.
/// Model errors make up to 12 mm of it ([`places`](super::places)) and joint offsets of 25 mrad, 0.9 m away, 22 mm. At the
/// rest the magnet pulls with less than 1 N.
const OFF_M: f64 = 0.040;
/// How long the arm may take to tell where it is, in s: its first states come as soon as the controller has its robot.
const SEEN_S: f64 = 2.0;

/// Delay before a fault is cleared, in s, at attempt number `attempt` from 0.
fn pause_s(report: &FaultReport, attempt: u32) -> f64 {
    policy(report.fault).pause_s * f64::from(1u32 << attempt.min(8))
}

impl<'a> Campaign<'a> {
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
        self.scene_at(self.place)
    }

    /// The scene with the plate at a placement.
    fn scene_at(&self, place: u32) -> Option<Scene> {
        let chain = self.waypoints.chain()?;
        let found = self.places.found(place);
        let limits = &self.assignment.procedure.limits;
        Some(Scene::new(self.assignment.plan, chain, place, limits, &found))
    }

    /// Joint angles of the newest sample, in rad.
    fn posture(&self, session: &Session<'_>) -> Option<Vec<f64>> {
        let n = self.assignment.robot.dof();
        let sample = session.sample()?;
        let q: Vec<f64> = sample.q.iter().take(n).map(|q| f64::from(*q)).collect();
        (q.len() == n).then_some(q)
    }

    /// Direction of approach opposite to the best retreat from the sphere of `visit`, after `failed` others.
    fn way_off(&self, session: &Session<'_>, visit: &Visit, failed: u32) -> [f64; 3] {
        let straight = visit.approach_direction;
        let (Some(scene), Some(q)) = (self.scene_at(visit.place), self.posture(session)) else {
            return straight;
        };
        let length_m = self.assignment.procedure.decouple.retreat_m;
        scene.retreat(&q, straight, length_m, failed as usize)
    }

    /// Distance of the computed TCP from where the sphere of `visit` is expected, in m: where it was found, or else where
    /// it was planned. `None` before the first sample.
    fn away_m(&self, session: &Session<'_>, visit: &Visit) -> Option<f64> {
        let found = self.places.found(visit.place);
        let known = found.iter().find(|(sphere, _)| *sphere == visit.sphere_id);
        let centre = known.map_or_else(|| visit.position_m.into(), |(_, centre)| *centre);
        let tcp = session.sample()?.tcp_m.map(f64::from);
        Some((Vector3::from(tcp) - centre).norm())
    }

    /// The visit on whose sphere the nest may be: that of the nearest sphere.
    fn sits_at(&self, session: &Session<'_>) -> Option<&'a Visit> {
        let visits = self.assignment.plan.spheres.iter();
        let near = visits.filter_map(|visit| Some((self.away_m(session, visit)?, visit)));
        let nearest = near.min_by(|a, b| a.0.total_cmp(&b.0));
        nearest.filter(|(away_m, _)| *away_m < OFF_M).map(|(_, visit)| visit)
    }

    /// Brings the nest off the sphere that it may be on. An earlier host may have been killed at any moment, and a
    /// controller that is new knows nothing of it. Only the arm itself tells for sure where it is: near the place of a
    /// sphere it retreats, which does no harm to a free arm.
    pub(super) fn free_the_nest(&self, session: &mut Session<'_>) -> Result<(), CampaignError> {
        session.see(SEEN_S, |_| true)?;
        let attempts = self.assignment.options.attempts.max(1);
        let mut last = None;
        for attempt in 0..attempts {
            let Some(visit) = self.sits_at(session) else {
                return Ok(());
            };
            session.stage(CampaignStage::Recover, visit.sphere_id, self.assignment.plan);
            session.note(&format!(
                "the nest may be on sphere {}: retreating first",
                visit.sphere_id
            ));
            let direction = self.way_off(session, visit, attempt);
            let retreat = Command::Retreat { direction };
            let Some(report) = session.carry_to_rest("retreat from the sphere", retreat, self.decouple_limit())? else {
                return Ok(());
            };
            session.rest(pause_s(&report, attempt))?;
            let report = session.clear_fault()?.unwrap_or(report);
            last = Some((visit.sphere_id, report));
        }
        match last.filter(|_| self.sits_at(session).is_some()) {
            None => Ok(()),
            Some((sphere, report)) => Err(CampaignError::GivenUp {
                sphere,
                attempts,
                report,
            }),
        }
    }

    /// Decouples from the sphere of `visit` after a fault, away from what the nest touches and in a
    /// direction that leaves the arm room. Returns the fault, if one came. Does nothing if there
    /// was no contact.
    fn pull_off(
        &self,
        session: &mut Session<'_>,
        visit: &Visit,
        failed: u32,
    ) -> Result<Option<FaultReport>, CampaignError> {
        let way = if self.touching {
            self.way_off(session, visit, failed)
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
            // The arm is off, and only what follows failed: a joint at the end of its range, or an elbow that creeps.
            let off = |away_m| away_m > OFF_M;
            if report.phase == Phase::Decoupling && self.away_m(session, visit).is_some_and(off) {
                return Ok(());
            }
            let Some(again) = self.pull_off(session, visit, attempt)? else {
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

    /// The speed of turns (rad/s) that may help after a nest left its sphere in one: cables of 1.5 N m pull a nest off in fast
    /// turns, because their torque changes faster than the law follows. First it is the paper's speed. If a turn to the same
    /// pose failed before (`again`), it is a third of that. `None` after other faults, or if the arm turns as slowly as that.
    pub(super) fn slower_turn(&self, report: &FaultReport, again: bool) -> Option<f64> {
        let (now, paper) = (&self.procedure.turn, Procedure::default().paper().turn);
        let slower = if again && now.speed_rad_s <= paper.speed_rad_s {
            paper.speed_rad_s / SLOWER
        } else {
            paper.speed_rad_s
        };
        let lost = report.fault == Fault::ContactLost && report.phase == Phase::Turning;
        (lost && slower < now.speed_rad_s).then_some(slower)
    }

    /// Turns with `speed_rad_s` for the rest of the session.
    pub(super) fn turn_with(&mut self, session: &mut Session<'_>, speed_rad_s: f64) -> Result<(), CampaignError> {
        let (turn, paper) = (&mut self.procedure.turn, Procedure::default().paper().turn);
        turn.speed_rad_s = speed_rad_s;
        turn.acceleration_rad_s2 = turn.acceleration_rad_s2.min(paper.acceleration_rad_s2);
        session.note("the nest left its sphere in a turn: the arm turns more slowly from here on");
        self.configure(session)
    }

    /// Repeats the handshake with a controller that was lost, configures it again, and brings the nest off
    /// its sphere, because a controller that was reset does not know of one. From here a link that was down
    /// looks the same as a controller that was reset, and needs the same steps.
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
        self.free_the_nest(session)?;
        self.touching = false;
        Ok(())
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
            (Some(_), None) => return self.go_unseen(session, what, target),
            (None, _) => vec![target.to_vec()],
        };
        if way.len() > 1 {
            session.note(&format!(
                "the straight way to {what} is blocked: the arm moves over {} points beside it",
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

    /// The first motion of a session, before the arm has told where it is. It tells in the first periods of the motion, in
    /// which it moves by less than a millimetre. If the nest may be on a sphere, or the straight motion is not clear, the
    /// arm stops, leaves the sphere, and the motion is planned.
    fn go_unseen(
        &self,
        session: &mut Session<'_>,
        what: &str,
        target: &[f64],
    ) -> Result<Option<FaultReport>, CampaignError> {
        let straight = Command::Move { target: joints(target) };
        if let Some(report) = session.carry_out(what, straight)? {
            return Ok(Some(report));
        }
        // A motion that is over needs no look. Over a bad link the next command would be late for it.
        session.see(SEEN_S, |session| !session.rests())?;
        let free = self.sits_at(session).is_none() && self.is_straight(session, target);
        if free || session.sample().is_none() {
            return session.come_to_rest(what, self.motion_limit());
        }
        // A fault that came meanwhile is reported by the next command.
        session.stop_at_once()?;
        self.free_the_nest(session)?;
        self.go(session, what, target)
    }
}
