//! Places whose rows scatter more than the others.

use std::collections::BTreeMap;

use serde::Serialize;

use spherecal_model::statistics::median;

use super::linear::Linear;
use super::selection::FALSE_FINDINGS;
use super::tail::log_tail;
use crate::course::Course;

/// Fewest rows of a place, and of the others.
const FEWEST: usize = 5;

/// A place whose rows are typically much further off than those of the others.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ScatteredPlace {
    /// Its number.
    pub place: u32,
    /// In words, with what to do.
    pub words: String,
    /// Median residual over that of the other places, in units of the noise.
    pub ratio: f64,
    /// Chance of it where all places are alike, all places counted: logarithm to the base 10.
    pub log10_p: f64,
}

impl ScatteredPlace {
    /// Ratio from which a place is named.
    pub const LIMIT: f64 = 3.0;
}

/// The places that scatter, worst first. Medians and ranks: one row that is far off makes no place bad.
pub(crate) fn scattered(linear: &Linear, course: &Course) -> Vec<ScatteredPlace> {
    let fitted = &linear.x * &linear.estimate;
    let mut lengths: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
    for (k, row) in linear.rows.iter().enumerate() {
        let Some(place) = course.place.get(row.index) else {
            return Vec::new();
        };
        // The whitening carries the root of the robust weight, which hides just such places.
        let own = (linear.y.rows(3 * k, 3) - fitted.rows(3 * k, 3)).norm() / row.weight.max(1e-12).sqrt();
        lengths.entry(*place).or_default().push(own);
    }
    let places = lengths.len();
    let mut found: Vec<ScatteredPlace> = lengths
        .iter()
        .filter_map(|(&place, own)| {
            let others: Vec<f64> = lengths.iter().filter(|l| *l.0 != place).flat_map(|l| l.1.clone()).collect();
            if own.len() < FEWEST || others.len() < FEWEST {
                return None;
            }
            let ratio = median(own.clone()) / median(others.clone()).max(1e-12);
            let log_p = (log_chance(own, &others) + (places as f64).ln()).min(0.0);
            (ratio >= ScatteredPlace::LIMIT && log_p < FALSE_FINDINGS.ln()).then(|| ScatteredPlace {
                place,
                words: format!(
                    "the {} rows at {} are typically {ratio:.1} times as far off as the others: measure this place again, \
                     or leave its rows out",
                    own.len(),
                    course.place_name(place)
                ),
                ratio,
                log10_p: log_p / core::f64::consts::LN_10,
            })
        })
        .collect();
    found.sort_by(|a, b| b.ratio.total_cmp(&a.ratio));
    found
}

/// `ln` of the chance that the first are so far above the second where both are alike (Mann-Whitney,
/// normal approximation).
fn log_chance(own: &[f64], others: &[f64]) -> f64 {
    let above: usize = own.iter().map(|o| others.iter().filter(|x| o > x).count()).sum();
    let (a, b) = (own.len() as f64, others.len() as f64);
    let z = (above as f64 - 0.5 * a * b) / (a * b * (a + b + 1.0) / 12.0).sqrt();
    if z > 0.0 {
        log_tail(z * z, 1) - core::f64::consts::LN_2
    } else {
        -core::f64::consts::LN_2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if the chance departs from a table (Mann-Whitney of 10 and 10 with no overlap is 5.4e-6
    // exactly, 7.9e-5 by the normal approximation), or is not a half where both are alike.
    #[test]
    fn ranks_have_their_chance() {
        let high: Vec<f64> = (10..20).map(f64::from).collect();
        let low: Vec<f64> = (0..10).map(f64::from).collect();
        let chance = log_chance(&high, &low).exp();
        assert!((chance - 7.85e-5).abs() < 2e-6, "{chance}");
        assert!(log_chance(&low, &high).exp() >= 0.5);
    }
}
