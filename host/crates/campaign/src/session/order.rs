//! Commands and their answers, waits and their limits.

use spherecal_shared::protocol::host::{Command, FaultReport, Phase, Refusal};

use super::Session;
use crate::CampaignError;
use crate::recovery::LOST_S;

/// How long the controller may take to answer a command, in s of device time.
pub(super) const ANSWER_S: f64 = 10.0;
/// How long a cleared fault is watched in case it returns, in µs of device time.
const CLEAR_US: u64 = 50_000;

/// How a wait ended.
pub(crate) enum Waited<T> {
    /// What was waited for.
    Got(T),
    /// A fault came first.
    Fault(FaultReport),
}

impl Session<'_> {
    /// Sends a command and waits for its reply.
    pub(crate) fn ask(&mut self, what: &str, command: Command) -> Result<Result<(), Refusal>, CampaignError> {
        let start_us = match command {
            // Nothing is known yet of the controller's clock.
            Command::Hello => 0,
            _ => self.heard_us.saturating_add(self.lead_us).max(1),
        };
        self.ask_at(start_us, what, command)
    }

    fn ask_at(&mut self, start_us: u64, what: &str, command: Command) -> Result<Result<(), Refusal>, CampaignError> {
        let sequence = self.endpoint.send_at(start_us, command);
        self.start_us = start_us;
        // The answer comes when the command has started, and a lost answer must be requested again.
        // Anything that follows from the answer alone starts one lead later.
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
    pub(crate) fn stop_at_once(&mut self) -> Result<(), CampaignError> {
        self.ask_at(0, "stop", Command::Stop).map(|_| ())
    }

    /// Sends a command that must not be refused.
    pub(crate) fn order(&mut self, what: &str, command: Command) -> Result<(), CampaignError> {
        self.ask(what, command)?.map_err(|refusal| CampaignError::Refused {
            what: what.to_owned(),
            refusal,
        })
    }

    /// Sends a command. Returns the fault that prevented it, if there was one.
    pub(crate) fn carry_out(&mut self, what: &str, command: Command) -> Result<Option<FaultReport>, CampaignError> {
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

    /// Sends a command that moves the arm, and waits until the arm rests again, for at most the
    /// given number of seconds. Returns the fault, if one came.
    pub(crate) fn carry_to_rest(
        &mut self,
        what: &str,
        command: Command,
        limit_s: f64,
    ) -> Result<Option<FaultReport>, CampaignError> {
        if let Some(report) = self.carry_out(what, command)? {
            return Ok(Some(report));
        }
        self.come_to_rest(what, limit_s)
    }

    /// Waits until the arm rests after the last command, for at most `limit_s` (s). Returns the fault, if one came.
    pub(crate) fn come_to_rest(&mut self, what: &str, limit_s: f64) -> Result<Option<FaultReport>, CampaignError> {
        match self.wait(what, limit_s, |s| s.rests().then_some(()))? {
            Waited::Got(()) => Ok(None),
            Waited::Fault(report) => Ok(Some(report)),
        }
    }

    /// Whether the arm has come to rest after the last command. The report of an earlier rest may
    /// arrive after the answer to the last command, and does not count.
    pub(crate) fn rests(&self) -> bool {
        self.phase == Phase::Idle && self.changed_us >= self.start_us
    }

    /// Lets time pass, in s.
    pub(crate) fn rest(&mut self, time_s: f64) -> Result<(), CampaignError> {
        let start = self.now_us();
        while (self.now_us().saturating_sub(start) as f64) * 1e-6 < time_s {
            self.check_interrupt()?;
            self.step()?;
            self.check_time(start, f64::INFINITY, String::new)?;
        }
        // The controller's clock advances too: the next command starts that much later.
        self.heard_us = self.heard_us.saturating_add((time_s * 1e6) as u64);
        Ok(())
    }

    /// Waits for a sample of the control loop, until it is not `needed`, and at most for `limit_s` (s): from then on it is known
    /// where the arm is.
    pub(crate) fn see(&mut self, limit_s: f64, needed: impl Fn(&Self) -> bool) -> Result<(), CampaignError> {
        let start = self.now_us();
        let in_time = |now_us: u64| now_us.saturating_sub(start) as f64 * 1e-6 < limit_s;
        while self.samples.is_empty() && needed(self) && in_time(self.now_us()) {
            self.check_interrupt()?;
            self.step()?;
        }
        Ok(())
    }

    /// Steps until `done` says so or a fault comes.
    pub(crate) fn wait<T>(
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

    /// Fails if `limit_s` (s) have passed between `start_us` and the last exchange, or if the controller is silent. What
    /// has arrived and was not handled yet comes first: after a slow disk it may be the answer.
    fn check_time(&self, start_us: u64, limit_s: f64, what: impl FnOnce() -> String) -> Result<(), CampaignError> {
        if !self.inbox.is_empty() {
            return Ok(());
        }
        let silent_s = self.exchanged_us.saturating_sub(self.alive_us) as f64 * 1e-6;
        if self.banner.is_some() && silent_s > LOST_S {
            return Err(CampaignError::Lost { silent_s });
        }
        if self.exchanged_us.saturating_sub(start_us) as f64 * 1e-6 > limit_s {
            return Err(CampaignError::Timeout {
                what: what(),
                limit_s,
                phase: self.phase,
            });
        }
        Ok(())
    }

    /// Clears a fault, if there is one. Returns the fault that came back at once, if one did.
    pub(crate) fn clear_fault(&mut self) -> Result<Option<FaultReport>, CampaignError> {
        let quiet = self.pending_fault.take().is_none() && self.phase != Phase::Fault;
        self.order("clear the fault", Command::ClearFault)?;
        if quiet && self.pending_fault.is_none() {
            return Ok(None);
        }
        // The fault is over when the controller reports it over, not when it accepts the command.
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
}
