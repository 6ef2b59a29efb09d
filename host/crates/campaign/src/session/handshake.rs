//! Handshakes: first contact with the controller, and repeats.

use spherecal_shared::protocol::host::{Banner, Command, Phase};
use spherecal_shared::protocol::{PROTOCOL_VERSION, SCHEMA};

use super::Session;
use super::order::{ANSWER_S, Waited};
use crate::CampaignError;
use crate::recovery::HANDSHAKE_S;

impl Session<'_> {
    /// Begins a session with the controller and checks its banner.
    pub(crate) fn handshake(&mut self, joints: usize) -> Result<(), CampaignError> {
        self.joints = joints;
        self.in_handshake = true;
        let session = self.endpoint.next_session();
        self.journal.handshake(session)?;
        if let Err(error) = self.order("answer the handshake", Command::Hello) {
            // A controller that does not understand the handshake may still state why.
            return match (self.check_identity(joints), error) {
                (Err(why), CampaignError::Timeout { .. }) => Err(why),
                (_, error) => Err(error),
            };
        }
        let Waited::Got(banner) = self.wait("send its banner", ANSWER_S, |s| s.banner.clone())? else {
            // A controller that was left in a fault reports the fault before its banner.
            return self.check_identity(joints);
        };
        check_banner(&banner, joints)
    }

    fn check_identity(&self, joints: usize) -> Result<(), CampaignError> {
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

    /// Repeats the handshake with a controller that fell silent or was reset, for as long as the
    /// limit allows.
    pub(crate) fn repeat_handshake(&mut self, joints: usize) -> Result<(), CampaignError> {
        let start = self.now_us();
        self.inbox.clear();
        self.banner = None;
        self.pending_fault = None;
        // Nobody knows where the arm is now.
        self.samples.clear();
        // Its clock may have restarted.
        self.phase = Phase::Idle;
        self.changed_us = 0;
        self.in_handshake = true;
        let session = self.endpoint.next_session();
        self.journal.handshake(session)?;
        let sequence = self.endpoint.send(Command::Hello);
        self.reply = None;
        while self.banner.is_none() || self.reply.is_none_or(|(number, _)| number != sequence) {
            self.check_interrupt()?;
            self.step()?;
            let silent_s = self.now_us().saturating_sub(start) as f64 * 1e-6;
            if silent_s > HANDSHAKE_S {
                return Err(CampaignError::Lost { silent_s });
            }
        }
        self.banner
            .as_ref()
            .map_or(Ok(()), |banner| check_banner(banner, joints))
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
