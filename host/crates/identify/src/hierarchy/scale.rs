//! A scale of the instrument or the certificate that is as wrong as a mistake makes it.

use rayon::prelude::*;
use spherecal_model::statistics::median;

use super::constants::{HOPELESS, LARGEST_SCALE, SCALE_EVIDENCE, SCALE_RESIDUAL, WRONG_SCALE};
use super::sizes::Family;
use super::{Found, Scale, Search};
use crate::chain::Prepared;
use crate::parameters::Kind;

impl Found<'_> {
    /// This, or a search from here with a scale that is as wrong as a mistake makes it, whichever has the more evidence, and
    /// which. A single small parameter holds its own size down, so that the first search does not find this mode.
    pub(super) fn or_with_a_wrong_scale(self) -> (Self, Scale) {
        let mut search = self.search.clone();
        // Rows that the first search does not explain, of an arm of 1 m, are not a matter of the scale.
        if self.median_m() > HOPELESS || !search.sizes.set(Family::Scale, WRONG_SCALE) {
            return (self, Scale::Known);
        }
        let shares = &self.search.alike.share;
        // An arm that shrinks with its targets makes the noise of its joints small, and is no explanation; on the way there and
        // back the search never settles.
        let fits = |wide: &Found<'_>| {
            wide.settled
                && wide.scale().abs() < LARGEST_SCALE
                && wide.median_m() <= SCALE_RESIDUAL * self.median_m()
                && wide.log_evidence(shares) > self.log_evidence(shares) + SCALE_EVIDENCE
        };
        match search.run().ok().filter(fits) {
            Some(wide) => (wide, Scale::Doubted),
            None => (self, Scale::Known),
        }
    }

    /// Median distance of the rows from their targets, in m.
    fn median_m(&self) -> f64 {
        let Search { state, prepared, .. } = &self.search;
        let distance = |row: &Prepared| state.residual(row, &state.at(row).tcp).norm();
        median(prepared.par_iter().map(distance).collect())
    }

    /// The estimated scale.
    fn scale(&self) -> f64 {
        let unknowns = &self.search.unknowns;
        let mut pairs = unknowns.columns.iter().zip(unknowns.deviation.iter());
        let scale = pairs.find(|(column, _)| self.search.table[**column].kind == Kind::Scale);
        scale.map_or(0.0, |(_, deviation)| *deviation)
    }
}
