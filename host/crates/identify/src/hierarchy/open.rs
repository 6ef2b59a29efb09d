//! How well the sizes of the groups are known, and what that adds to the error of a prediction.
//!
//! The posterior of the unknowns holds at one size of each group, the best one. Few members, or rows that hardly
//! determine them, leave a size open. To first order in its logarithm `l` the posterior moves by
//! `dx = 2 P Λ x dl` and `dP = 2 P Λ P dl`, with the covariance `P` and the prior precision `Λ` of the group. The
//! covariance of the logarithms is the inverse of their expected information (restricted likelihood, and hyperprior),
//! `2 (δ (n − 2 tr P̃) + |P̃|²) + 1/s²` with `P̃ = Λ^½ P Λ^½` between two groups. A group whose mean is `r` times its size
//! also pulls by that mean: `dx` gets `P Λ^½ r`, and the information `r² (n − Σ P̃)`.

use nalgebra::{DMatrix, DVector};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};

/// The sizes' own errors.
#[derive(Clone, Debug, Default)]
pub(crate) struct OpenSizes {
    groups: Vec<Group>,
    /// Change of the estimate with the logarithm of each size, one group a column.
    shifts: DMatrix<f64>,
    /// Root of the covariance of the logarithms.
    root: DMatrix<f64>,
}

/// A group that has one size.
#[derive(Clone, Debug)]
pub(super) struct Group {
    /// Members: position among the free unknowns, and prior precision.
    pub(super) members: Vec<(usize, f64)>,
    /// Standard deviation of the logarithm of the size before the data.
    pub(super) spread: f64,
    /// Mean of the members before the data, by their size.
    pub(super) mean: f64,
}

impl OpenSizes {
    /// `deviation` is the estimate minus the nominal value of every unknown.
    pub(super) fn new(groups: Vec<Group>, deviation: &[f64], covariance: &DMatrix<f64>) -> Self {
        let count = groups.len();
        let mut shifts = DMatrix::zeros(deviation.len(), count);
        let mut information = DMatrix::zeros(count, count);
        for (f, group) in groups.iter().enumerate() {
            information[(f, f)] = group.spread.powi(-2);
            for &(at, precision) in &group.members {
                let push = 2.0 * precision * deviation[at] + precision.sqrt() * group.mean;
                shifts.column_mut(f).axpy(push, &covariance.column(at), 1.0);
                let shared = |&(other, p): &(usize, f64)| (precision * p).sqrt() * covariance[(at, other)];
                let of_mean = 1.0 - group.members.iter().map(shared).sum::<f64>();
                information[(f, f)] += 2.0 - 4.0 * precision * covariance[(at, at)] + group.mean.powi(2) * of_mean;
            }
            for (g, other) in groups.iter().enumerate() {
                let pairs = group
                    .members
                    .iter()
                    .flat_map(|a| other.members.iter().map(move |b| (a, b)));
                let square = |(&(i, p), &(k, o)): (&(usize, f64), &(usize, f64))| p * o * covariance[(i, k)].powi(2);
                information[(f, g)] += 2.0 * pairs.map(square).sum::<f64>();
            }
        }
        let known = information.cholesky().map(|c| c.inverse());
        let root = known.and_then(nalgebra::Matrix::cholesky);
        Self {
            root: root.map_or_else(|| DMatrix::zeros(count, count), |c| c.l()),
            groups,
            shifts,
        }
    }

    /// No sizes, of so many unknowns.
    pub(crate) fn none(unknowns: usize) -> Self {
        Self {
            shifts: DMatrix::zeros(unknowns, 0),
            ..Self::default()
        }
    }

    /// The same about another posterior with the same sizes.
    pub(super) fn about(self, deviation: &[f64], covariance: &DMatrix<f64>) -> Self {
        Self::new(self.groups, deviation, covariance)
    }

    /// What open sizes do to displacements: `columns` are those of the unknowns (3n x m), `spread` is `columns * P`
    /// without the motion that does not count.
    pub(crate) fn effect(&self, columns: &DMatrix<f64>, spread: &DMatrix<f64>) -> Effect {
        let total = columns.dot(spread).max(1e-300);
        let of = |group: &Group| {
            let own = group
                .members
                .iter()
                .map(|&(at, p)| p * spread.column(at).norm_squared());
            (own.sum::<f64>() / total).clamp(0.0, 1.0)
        };
        Effect {
            shares: self.groups.iter().map(of).collect(),
            shifts: columns * &self.shifts,
        }
    }

    /// Covariance of a displacement by what the estimate shifts with the sizes: `columns` are its own of the free unknowns (m x 3).
    pub(crate) fn covariance(&self, columns: &DMatrix<f64>) -> DMatrix<f64> {
        let moved = columns.tr_mul(&self.shifts) * &self.root;
        &moved * moved.transpose()
    }

    /// One draw of the logarithms of the sizes about their estimates.
    pub(crate) fn draw(&self, random: &mut ChaCha8Rng) -> DVector<f64> {
        let white = DVector::from_fn(self.root.ncols(), |_, _| StandardNormal.sample(random));
        &self.root * white
    }
}

/// What other sizes do to displacements.
pub(crate) struct Effect {
    /// Share of the mean square error that each group's prior holds.
    shares: Vec<f64>,
    /// Displacements (3n) by the logarithm of each size.
    pub(crate) shifts: DMatrix<f64>,
}

impl Effect {
    /// Factor of the error when the sizes' logarithms change, and the noise by a factor: of one unknown that its prior
    /// holds with the share `s` and the data with `1 − s`, `(s e^(−2 l) + (1 − s) / c²)^(−1/2)`.
    pub(crate) fn factor(&self, logarithms: &DVector<f64>, noise: f64) -> f64 {
        let of = |(s, l): (&f64, &f64)| s * ((-2.0 * l).exp() - 1.0);
        let held: f64 = self.shares.iter().sum::<f64>().min(1.0);
        let sizes: f64 = self.shares.iter().zip(logarithms.iter()).map(of).sum();
        (1.0 + sizes + (1.0 - held) * (noise.powi(-2) - 1.0))
            .max(1e-6)
            .powf(-0.5)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::{Group, OpenSizes};

    // Fails if the estimate moves with the size of its group in another way than its own equations say, or if the error
    // of an unknown that only its prior holds does not follow the size, or not the noise where the data hold it.
    #[test]
    fn an_estimate_moves_with_the_size_of_its_group() {
        let one = |x: f64| DMatrix::from_element(1, 1, x);
        let group = || Group {
            members: vec![(0, 4.0)],
            spread: 2.0,
            mean: 0.7,
        };
        // The mean is 0.7 of the size, which is 0.5.
        let at = |l: f64| {
            let lambda = 4.0 * (-2.0 * l).exp();
            let a = DMatrix::from_row_slice(2, 2, &[3.0 + lambda, 0.5, 0.5, 2.0]);
            let p = a.try_inverse().expect("regular");
            (&p * DVector::from_vec(vec![2.0 + lambda * 0.35 * l.exp(), 1.0]), p)
        };
        let (x, p) = at(0.0);
        let open = OpenSizes::new(vec![group()], &[x[0] - 0.35, x[1]], &p);
        let slope: DVector<f64> = (at(1e-5).0 - at(-1e-5).0) / 2e-5;
        assert!((open.shifts.column(0) - slope).norm() < 1e-8, "{:?}", open.shifts);
        let columns = DMatrix::identity(2, 2);
        let effect = open.effect(&columns, &p);
        let slope = (at(1e-5).1.trace() / at(-1e-5).1.trace()).ln() / 4e-5;
        let factor = |l: f64| effect.factor(&DVector::from_element(1, l), 1.0).ln();
        assert!(((factor(1e-5) - factor(-1e-5)) / 2e-5 - slope).abs() < 1e-6, "{slope}");
        let alone = OpenSizes::new(vec![group()], &[0.0], &one(0.25));
        let held = alone.effect(&one(1.0), &one(0.25));
        assert!((held.factor(&DVector::from_element(1, 0.3), 5.0) - 0.3_f64.exp()).abs() < 1e-12);
        assert!((alone.root[(0, 0)] - 2.0).abs() < 1e-9, "{}", alone.root);
        let free = OpenSizes::new(Vec::new(), &[0.0], &one(0.25)).effect(&one(1.0), &one(0.25));
        assert!((free.factor(&DVector::zeros(0), 5.0) - 5.0).abs() < 1e-12);
    }
}
