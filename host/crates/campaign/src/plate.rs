//! What concerns the plate as a whole: its placement, and whether its spheres have stayed.

use std::collections::BTreeSet;

use super::CampaignError;
use super::observe::Stage;
use super::procedure::Campaign;
use super::session::Session;

impl Campaign<'_> {
    /// Couples once more with every sphere of the present placement, at its first visit of this
    /// session, and compares: a sphere or a plate that moved in between makes the recordings
    /// worthless. It comes after the recordings, which it does not disturb.
    pub(super) fn compare(&mut self, session: &mut Session<'_>) -> Result<(), CampaignError> {
        let plan = self.assignment.plan;
        let mut compared = BTreeSet::new();
        for visit in &plan.spheres {
            let here = visit.place == self.place && self.places.has_coupled(visit);
            if here && compared.insert(visit.sphere_id) {
                self.with_reconnect(session, Some(visit), |campaign, session, _| {
                    campaign.sphere(session, visit)
                })?;
            }
        }
        Ok(())
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
        session.stage(Stage::Home, 0, plan);
        self.travel(session, "reach the home frame", &plan.home.joints)?;
        session.stage(Stage::Plate, 0, plan);
        session.plate(place)?;
        self.place = place;
        *stands = Some(place);
        Ok(true)
    }
}
