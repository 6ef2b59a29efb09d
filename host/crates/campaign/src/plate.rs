//! What concerns the plate as a whole: its placement.

use super::CampaignError;
use super::observe::CampaignStage;
use super::procedure::Campaign;
use super::session::Session;

impl Campaign<'_> {
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
