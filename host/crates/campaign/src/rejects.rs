//! Counts the recordings of a campaign and the poses that it gives up, and says which are left.

use spherecal_shared::protocol::host::FaultReport;

use super::CampaignError;
use super::observe::Rejected;
use super::procedure::Campaign;
use super::session::Session;
use spherecal_plan::{PlannedPose, Visit};

impl Campaign<'_> {
    /// Poses of a visit that are neither recorded nor given up, the poses to pass through on the
    /// way, and those after the last: they lead to where the nest leaves the sphere. None once the recordings are enough.
    pub(super) fn pending<'s>(&self, visit: &'s Visit) -> Vec<&'s PlannedPose> {
        if self.enough {
            return Vec::new();
        }
        let mut pending = Vec::new();
        let mut passed = Vec::new();
        for pose in &visit.poses {
            if pose.via {
                passed.push(pose);
            } else if self.done.contains(&(visit.sphere_id, pose.id)) {
                passed.clear();
            } else {
                pending.append(&mut passed);
                pending.push(pose);
            }
        }
        if !pending.is_empty() {
            pending.append(&mut passed);
        }
        pending
    }

    /// Asks whether the recordings so far are enough, and waits for the answer.
    pub(super) fn ask_enough(&mut self, session: &mut Session<'_>) -> Result<(), CampaignError> {
        while !self.enough {
            match session.enough() {
                Some(false) => break,
                Some(true) => self.enough = true,
                None => {
                    session.check_interrupt()?;
                    session.step()?;
                }
            }
        }
        Ok(())
    }

    /// Counts the latest recording, if it is new.
    pub(super) fn count(&mut self, session: &mut Session<'_>) {
        let Some(recording) = session.recorded.take() else {
            return;
        };
        if self.done.insert(recording) {
            self.recorded += 1;
            session.progress.done = self.done.len();
            session.report_progress();
        }
    }

    pub(super) fn give_up_pose(
        &mut self,
        session: &mut Session<'_>,
        sphere: u32,
        pose: u32,
        report: &FaultReport,
    ) -> Result<(), CampaignError> {
        let reason = format!("{:?} while {:?}", report.fault, report.phase);
        if self.done.contains(&(sphere, pose)) {
            return Ok(());
        }
        self.reject(session, sphere, pose, &reason)
    }

    pub(super) fn reject(
        &mut self,
        session: &mut Session<'_>,
        sphere: u32,
        pose: u32,
        reason: &str,
    ) -> Result<(), CampaignError> {
        session.journal().reject(sphere, pose, reason)?;
        session.note(&format!("pose {pose} (sphere {sphere}): given up ({reason})"));
        self.done.insert((sphere, pose));
        self.rejected.push(Rejected {
            sphere,
            pose,
            reason: reason.to_owned(),
        });
        session.progress.done = self.done.len();
        let planned = self.assignment.plan.recorded();
        if self.rejected.len() * 100 > planned * self.assignment.options.rejected_percent as usize {
            return Err(CampaignError::Rejected {
                rejected: self.rejected.len(),
                planned,
            });
        }
        Ok(())
    }
}
