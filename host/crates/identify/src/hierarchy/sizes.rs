//! How large the errors of this robot are: the standard deviation of each group of random effects.
//!
//! Every parameter but base and spheres belongs to a [`Family`] whose members are `N(μ, (t c)²)`, with a size `t` that
//! the data find and a fixed factor `c` (1/k of a harmonic of order k). The mean is the nominal value; that of the links' bending,
//! whose sign is known, is `r t c`, so that it follows the size. The size has a hyperprior,
//! `ln t ~ N(ln t₀, s²)`: `t₀` is the prior of the table of parameters, `s` is in [`constants`](super::constants). So a group
//! that the data do not determine keeps its ordinary size, and its effect is a part of the stated error.
//!
//! One update is a step of Fellner and Schall (Wood and Fasiolo 2017) on the restricted likelihood: with the posterior mean `x`
//! and variance `P` of each member, `Σ (x/c)²` is taken for the sum of squares of `Σ (1 − P/(t c)²)` numbers, which is what the
//! data tell; the new size is the maximum of that likelihood and the hyperprior. It ends where expectation and maximisation
//! would, in a fraction of their rounds. Of bending the mean moves, too: the likelihood of its members is taken as it is, with the
//! same gradient.

use nalgebra::DMatrix;

use super::constants::{ECCENTRIC_ORDERS, FACTORS, HARMONICS, SEAT_M, SEATS_NU};
use super::{open::Group, springs};
use crate::parameters::{Kind, Parameter};
use crate::solve::Unknowns;

/// Parameters that have one size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Family {
    /// Lengths `a` and `d`.
    Lengths,
    /// Twists `alpha` and `beta`.
    Twists,
    /// Joint offsets `theta`.
    Offsets,
    /// The TCP in the flange frame.
    Tool,
    /// Compliance of the joints.
    Compliance,
    /// Bending of the links.
    Bending,
    /// Tilt of the base.
    Tilt,
    /// Low harmonics of all joints: eccentricity of encoders and gears.
    Eccentricity,
    /// Their high harmonics: ripple of the gears.
    Ripple,
    /// Scale of the instrument or the certificate.
    Scale,
    /// Seats of the couplings on the nest.
    Seats,
}

impl Family {
    /// The group of a parameter and its factor on the group's size; `None` for those whose prior is fixed.
    fn of(parameter: &Parameter) -> Option<(Self, f64)> {
        if parameter.set_by_user {
            return None;
        }
        match parameter.kind {
            Kind::A(_) | Kind::D(_) => Some((Self::Lengths, 1.0)),
            Kind::Alpha(_) | Kind::Beta(_) => Some((Self::Twists, 1.0)),
            Kind::Theta(_) => Some((Self::Offsets, 1.0)),
            Kind::Tool(_) => Some((Self::Tool, 1.0)),
            Kind::Compliance(_) => Some((Self::Compliance, 1.0)),
            Kind::Bending(..) => Some((Self::Bending, 1.0)),
            Kind::Tilt(_) => Some((Self::Tilt, 1.0)),
            Kind::Cosine(_, k) | Kind::Sine(_, k) if k > ECCENTRIC_ORDERS => Some((Self::Ripple, 1.0)),
            Kind::Cosine(_, k) | Kind::Sine(_, k) => Some((Self::Eccentricity, 1.0 / k as f64)),
            Kind::Scale => Some((Self::Scale, 1.0)),
            Kind::Seat(..) => Some((Self::Seats, 1.0)),
            Kind::Target(..) | Kind::Body(_) | Kind::Base(..) | Kind::Sphere(..) => None,
        }
    }
}

/// Ordinary size of a group, where `table` is the prior of the table of parameters.
fn ordinary_of(family: Family, table: f64) -> f64 {
    match family {
        Family::Eccentricity => HARMONICS.0,
        Family::Ripple => HARMONICS.1,
        Family::Seats => SEAT_M,
        _ => table,
    }
}

/// Standard deviation of the logarithm of a group's size.
fn spread_of(family: Family) -> f64 {
    match family {
        Family::Lengths | Family::Twists | Family::Tilt => FACTORS.made,
        Family::Eccentricity | Family::Ripple => FACTORS.made,
        Family::Offsets | Family::Tool | Family::Scale | Family::Seats => FACTORS.wide,
        Family::Compliance | Family::Bending => FACTORS.compliance,
    }
    .ln()
}

/// Mean of a group's members by its size. That of joints is fixed: makers choose their stiffness.
fn mean_of(family: Family, parameter: &Parameter) -> f64 {
    match family {
        Family::Bending => parameter.nominal / parameter.prior_sigma,
        _ => 0.0,
    }
}

/// The size of one group.
#[derive(Clone, Debug)]
pub(crate) struct Size {
    pub(crate) family: Family,
    /// Members: position among the unknowns, and factor.
    members: Vec<(usize, f64)>,
    /// Median of the hyperprior, SI unit of the members.
    ordinary: f64,
    /// Standard deviation of its logarithm.
    spread: f64,
    /// The present size.
    pub(crate) now: f64,
    /// Mean of the members by their size.
    mean: f64,
    /// Last change of the logarithm; 0 where the next one does not follow from it.
    last: f64,
    /// Weights of seats, by three members, of Student's t: a coupling that sat badly does not make the others uncertain.
    weights: Vec<f64>,
}

impl Size {
    /// A step to where this one and the last, of which the next ones are a constant share, would end (Aitken 1926).
    fn ahead(&mut self, step: f64) -> f64 {
        let share = step / self.last;
        if SHARES.contains(&share) {
            self.last = 0.0;
            let most = NEWTON.1.max(step.abs());
            return (step / (1.0 - share)).clamp(-most, most);
        }
        self.last = step;
        step
    }

    /// Gives the group another size, and its members the mean that follows.
    fn change(&mut self, now: f64, unknowns: &mut Unknowns) {
        for &(at, factor) in &self.members {
            unknowns.deviation[at] -= factor * self.mean * (now - self.now);
        }
        self.now = now;
    }

    /// Weight of a member's prior.
    fn weight(&self, member: usize) -> f64 {
        self.weights.get(member / 3).copied().unwrap_or(1.0)
    }
}

/// How strange the shape of an arm is. Far off, the arm is not the one that was described.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Strangeness {
    /// Standard deviations of the hyperprior between the size of the errors and an ordinary one.
    pub(crate) sigmas: f64,
    /// Size of the errors, 1 sigma, in m or rad.
    pub(crate) size: f64,
    /// Whether they are those of lengths, and not of twists.
    pub(crate) lengths: bool,
}

/// Sizes of all groups of a model.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sizes(pub(crate) Vec<Size>);

/// Shares of two steps by which they are taken for the first of many.
const SHARES: std::ops::Range<f64> = 0.2..0.9;
/// Newton steps for one size, and the largest change of its logarithm in one.
const NEWTON: (usize, f64) = (20, 1.0);

impl Sizes {
    /// Every group of the free parameters of `table`, at its ordinary size.
    pub(crate) fn new(table: &[Parameter], unknowns: &Unknowns) -> Self {
        let mut sizes: Vec<Size> = Vec::new();
        for (at, &column) in unknowns.columns.iter().enumerate() {
            let parameter = &table[column];
            let Some((family, factor)) = Family::of(parameter) else {
                continue;
            };
            if let Some(size) = sizes.iter_mut().find(|size| size.family == family) {
                size.members.push((at, factor));
            } else {
                let ordinary = ordinary_of(family, parameter.prior_sigma / factor);
                sizes.push(Size {
                    family,
                    members: vec![(at, factor)],
                    ordinary,
                    spread: spread_of(family),
                    now: ordinary,
                    mean: mean_of(family, parameter),
                    last: 0.0,
                    weights: Vec::new(),
                });
            }
        }
        Self(sizes)
    }

    /// Gives the group of a family another size. `false` without that group.
    pub(crate) fn set(&mut self, family: Family, size: f64) -> bool {
        let group = self.0.iter_mut().find(|group| group.family == family);
        group.map(|group| group.now = size).is_some()
    }

    /// Gives every group the size that its family has in `others`.
    pub(super) fn begin_at(&mut self, others: &Self, unknowns: &mut Unknowns) {
        for size in &mut self.0 {
            if let Some(other) = others.0.iter().find(|other| other.family == size.family) {
                size.change(other.now, unknowns);
            }
        }
    }

    /// Every group.
    pub(super) fn groups(&self, unknowns: &Unknowns) -> Vec<Group> {
        let member = |&(at, _): &(usize, f64)| (at, unknowns.precision[at]);
        let of = |size: &Size| Group {
            members: size.members.iter().map(member).collect(),
            spread: size.spread,
            mean: size.mean,
        };
        self.0.iter().map(of).collect()
    }

    /// Writes the priors that follow from the sizes.
    pub(crate) fn apply(&self, unknowns: &mut Unknowns) {
        for size in &self.0 {
            for (k, &(at, factor)) in size.members.iter().enumerate() {
                unknowns.precision[at] = size.weight(k) * (size.now * factor).powi(-2);
            }
        }
    }

    /// One update of every size from the posterior's covariance `Rᵀ R`. Returns the largest change of a logarithm.
    pub(crate) fn update(&mut self, unknowns: &mut Unknowns, root: &DMatrix<f64>) -> f64 {
        let variances: Vec<f64> = root.column_iter().map(|column| column.norm_squared()).collect();
        let mut moved: f64 = 0.0;
        for size in &mut self.0 {
            let mean_square = |&(at, factor): &(usize, f64)| (unknowns.deviation[at] / factor).powi(2);
            let squares: Vec<f64> = size.members.iter().map(mean_square).collect();
            // What the data tell of each member: one minus the share of its prior's variance that is left.
            let told = |&(at, _): &(usize, f64)| (1.0 - unknowns.precision[at] * variances[at]).clamp(0.0, 1.0);
            let numbers: f64 = size.members.iter().map(told).sum();
            if size.family == Family::Seats {
                let variance = |&(at, factor): &(usize, f64)| variances[at] / (factor * factor);
                let expected: Vec<f64> = size
                    .members
                    .iter()
                    .map(variance)
                    .zip(&squares)
                    .map(|(p, x)| p + x)
                    .collect();
                let of_seat =
                    |seat: &[f64]| (SEATS_NU + 3.0) / (SEATS_NU + seat.iter().sum::<f64>() / size.now.powi(2));
                size.weights = expected.chunks(3).map(of_seat).collect();
            }
            let sum: f64 = squares
                .iter()
                .enumerate()
                .map(|(k, square)| size.weight(k) * square)
                .sum();
            let next = if size.mean == 0.0 {
                penalised(sum, numbers, size.ordinary.ln(), size.spread, size.now.ln())
            } else {
                let told = springs::measured(&size.members, (size.now, size.mean), &unknowns.deviation, root);
                springs::size(&told, size.ordinary.ln(), size.spread)
            };
            let step = next - size.now.ln();
            moved = moved.max(step.abs());
            let step = size.ahead(step);
            size.change((size.now.ln() + step).exp(), unknowns);
        }
        moved
    }

    /// Writes the priors that were found into the table of parameters.
    pub(crate) fn describe(&self, unknowns: &Unknowns, table: &mut [Parameter]) {
        for (&column, precision) in unknowns.columns.iter().zip(&unknowns.precision) {
            table[column].prior_sigma = precision.powf(-0.5);
        }
        for size in &self.0 {
            for &(at, factor) in &size.members {
                table[unknowns.columns[at]].nominal += factor * size.mean * (size.now - size.ordinary);
            }
        }
    }

    /// How far the sizes of lengths and twists are from ordinary ones: that of the farther one.
    pub(crate) fn strangeness(&self) -> Strangeness {
        let shape = self
            .0
            .iter()
            .filter(|size| matches!(size.family, Family::Lengths | Family::Twists));
        let each = shape.map(|size| Strangeness {
            sigmas: (size.now / size.ordinary).ln() / size.spread,
            size: size.now,
            lengths: size.family == Family::Lengths,
        });
        each.max_by(|a, b| a.sigmas.total_cmp(&b.sigmas)).unwrap_or_default()
    }

    /// Minus the logarithm of the hyperprior, up to a constant.
    pub(crate) fn penalty(&self) -> f64 {
        let of = |size: &Size| 0.5 * ((size.now / size.ordinary).ln() / size.spread).powi(2);
        self.0.iter().map(of).sum()
    }
}

/// The logarithm `l` that maximises `−n l − S e^{−2l}/2 − (l − m)²/(2 s²)`, from `start`.
pub(crate) fn penalised(sum: f64, count: f64, middle: f64, spread: f64, start: f64) -> f64 {
    let weak = spread.powi(-2);
    let mut l = start;
    for _ in 0..NEWTON.0 {
        let data = sum * (-2.0 * l).exp();
        let gradient = data - count - (l - middle) * weak;
        let step = (gradient / (2.0 * data + weak)).clamp(-NEWTON.1, NEWTON.1);
        l += step;
        if step.abs() < 1e-9 {
            break;
        }
    }
    l
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if steps of which each is the same share of the last do not end where their sum does, or if a step that does not
    // follow from the last one, or has none before it, is another than itself.
    #[test]
    fn steps_of_a_constant_share_end_at_their_sum() {
        let mut size = Size {
            family: Family::Lengths,
            members: Vec::new(),
            ordinary: 1.0,
            spread: 1.0,
            now: 1.0,
            mean: 0.0,
            last: 0.0,
            weights: Vec::new(),
        };
        // 0.08 and 0.06 are the first of steps whose sum is 0.32.
        assert_eq!(size.ahead(0.08), 0.08);
        assert!((size.ahead(0.06) - 0.24).abs() < 1e-12);
        for step in [0.06, -0.04, 0.03, 0.03, 0.001] {
            assert_eq!(size.ahead(step), step);
        }
        assert_eq!(size.ahead(1.0), 1.0);
        assert_eq!(size.ahead(0.8), NEWTON.1);
    }

    // Fails if a size is not the root mean square of many members, if one of no data leaves its hyperprior's
    // median, or if few members move it as far as many.
    #[test]
    fn a_size_lies_between_data_and_hyperprior() {
        let (middle, spread) = (1e-3_f64.ln(), 3.0_f64.ln());
        let many = penalised(1e6 * 4e-4, 1e6, middle, spread, middle).exp();
        assert!((many / 2e-2 - 1.0).abs() < 1e-3, "{many}");
        let none = penalised(0.0, 0.0, middle, spread, middle).exp();
        assert!((none / 1e-3 - 1.0).abs() < 1e-9, "{none}");
        let few = penalised(2.0 * 4e-4, 2.0, middle, spread, middle).exp();
        assert!(few > 2e-3 && few < 2e-2, "{few}");
    }
}
