//! Gauss-Newton and Levenberg-Marquardt on the paper's fitness, with normal equations that are
//! collapsed where that is exact.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Vector3};

use super::{DistanceProblem, MM};
use crate::chain::{N, OWN};
use crate::error::IdentifyError;
use crate::options::Pairs;
use crate::parameters::Kind;

/// Most steps of Gauss-Newton and Levenberg-Marquardt.
const STEPS: usize = 60;
/// Converged when no parameter moves more than this (mm or rad).
const SETTLED: f64 = 1e-11;

/// Normal equations of the problem at one point, in mm and rad.
pub(super) struct Equations {
    pub(super) matrix: DMatrix<f64>,
    gradient: DVector<f64>,
    pub(super) objective: f64,
}

impl DistanceProblem {
    /// Normal equations at `x`.
    pub(super) fn equations(&self, x: &[f64]) -> Equations {
        let state = self.state(x);
        let m = self.columns.len();
        let mut general = [Vector3::zeros(); OWN];
        let mut joints = [Vector3::zeros(); N];
        let mut tcps = Vec::with_capacity(self.poses());
        let mut jacobians: Vec<DMatrix<f64>> = Vec::with_capacity(self.poses());
        for observation in &self.prepared {
            let k = state.at(observation);
            state.columns(&self.layout, &k, &observation.load, &mut general, &mut joints);
            let mut jacobian = DMatrix::zeros(3, m);
            for (c, &column) in self.columns.iter().enumerate() {
                let v = match self.table[column].kind {
                    Kind::Theta(i) => joints[i],
                    _ => general[column.min(general.len() - 1)],
                };
                jacobian.column_mut(c).copy_from(&(v * (MM / self.unit(column))));
            }
            tcps.push(k.tcp * MM);
            jacobians.push(jacobian);
        }
        let mut sum = Equations {
            matrix: DMatrix::zeros(m, m),
            gradient: DVector::zeros(m),
            objective: 0.0,
        };
        if self.absolute || self.pairs == Pairs::Vector {
            let rotation = &self.base.rotation;
            let errors = tcps
                .iter()
                .zip(&self.prepared)
                .map(|(p, o)| rotation.tr_mul(&self.error(p, o)));
            let errors: Vec<Vector3<f64>> = errors.collect();
            let all: Vec<usize> = (0..errors.len()).collect();
            sum.collapse(&errors, &jacobians, &all, !self.absolute);
            return sum;
        }
        let mut by_sphere: BTreeMap<Option<usize>, Vec<usize>> = BTreeMap::new();
        for (i, observation) in self.prepared.iter().enumerate() {
            by_sphere.entry(observation.sphere).or_default().push(i);
        }
        let spheres: Vec<&Vec<usize>> = by_sphere.values().collect();
        for (k, own) in spheres.iter().enumerate() {
            sum.collapse(&tcps, &jacobians, own, true);
            for other in &spheres[k + 1..] {
                for &i in *own {
                    for &j in *other {
                        let d = tcps[i] - tcps[j];
                        let along = d / d.norm().max(1e-12);
                        let residual = self.norm_residual(&tcps[i], &tcps[j], i, j);
                        let row = (&jacobians[i] - &jacobians[j]).tr_mul(&along);
                        sum.matrix.ger(1.0, &row, &row, 1.0);
                        sum.gradient.axpy(residual, &row, 1.0);
                        sum.objective += residual * residual;
                    }
                }
            }
        }
        sum
    }

    /// Gauss-Newton (`damped` false) or Levenberg-Marquardt from the nominal values.
    ///
    /// # Errors
    /// Singular equations, or a step that diverges.
    pub fn solve(&self, damped: bool) -> Result<Vec<f64>, IdentifyError> {
        let singular = || IdentifyError::Singular {
            free: self.columns.len(),
        };
        let mut x = self.nominal();
        let mut now = self.equations(&x);
        let mut lambda = if damped { 1e-3 } else { 0.0 };
        for _ in 0..STEPS {
            let mut a = now.matrix.clone();
            for i in 0..a.nrows() {
                a[(i, i)] *= 1.0 + lambda;
            }
            let step = a.cholesky().ok_or_else(singular)?.solve(&now.gradient);
            let next: Vec<f64> = x.iter().zip(step.iter()).map(|(x, s)| x - s).collect();
            let there = self.equations(&next);
            if !there.objective.is_finite() {
                return Err(IdentifyError::Diverged {
                    rms_mm: (now.objective / self.poses() as f64).sqrt(),
                });
            }
            let settled = step.amax() < SETTLED;
            if damped && there.objective > now.objective && !settled {
                lambda = (lambda * 10.0).max(1e-9);
                if lambda > 1e12 {
                    break;
                }
                continue;
            }
            lambda /= 10.0;
            x = next;
            now = there;
            if settled {
                break;
            }
        }
        Ok(x)
    }
}

impl Equations {
    /// Adds `N Σ |e_i − ē|²` over `members` (or `Σ |e_i|²` when not `centred`).
    fn collapse(&mut self, errors: &[Vector3<f64>], jacobians: &[DMatrix<f64>], members: &[usize], centred: bool) {
        let m = self.gradient.len();
        let count = members.len() as f64;
        if members.is_empty() {
            return;
        }
        let (mut mean, mut mean_jacobian) = (Vector3::zeros(), DMatrix::zeros(3, m));
        let mut factor = 1.0;
        if centred {
            for &i in members {
                mean += errors[i] / count;
                mean_jacobian += &jacobians[i] / count;
            }
            factor = count;
        }
        for &i in members {
            let e = errors[i] - mean;
            let j = &jacobians[i] - &mean_jacobian;
            self.matrix.gemm_tr(factor, &j, &j, 1.0);
            self.gradient.gemv_tr(factor, &j, &e, 1.0);
            self.objective += factor * e.norm_squared();
        }
    }
}
