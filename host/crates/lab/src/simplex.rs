//! The Nelder-Mead simplex, as SciPy and MATLAB implement it.
//!
//! Vocabulary. The *simplex* has n + 1 *vertices*, sorted by value. Each
//! iteration *reflects* the worst vertex through the centroid of the others,
//! then *expands*, *contracts* or *shrinks*. An *evaluation* is one call of the
//! function.
//!
//! [`minimise`] repeats `scipy.optimize.minimize(method="Nelder-Mead")` in the same order of
//! floating-point operations, including the interrupted iteration at the evaluation limit. So both
//! take the same path bit by bit if the function gives the same bits. MATLAB's `fminsearch` differs
//! only in its stopping rule. The first steps cause the paper's frozen parameters: 5 % of a value,
//! but an absolute 0.00025 for a value of zero, whatever its unit.

use serde::{Deserialize, Serialize};

/// First step of a value that is not zero, as a share of it.
const NONZERO_STEP: f64 = 0.05;
/// First step of a value that is zero.
const ZERO_STEP: f64 = 0.00025;

/// Whose rules end the search.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stopping {
    /// SciPy: absolute tolerances; the evaluation limit interrupts an iteration.
    #[default]
    Scipy,
    /// MATLAB's `fminsearch`: tolerances of at least ten units in the last place; limits are
    /// checked between iterations only.
    Fminsearch,
}

/// When the search ends.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SearchLimits {
    /// Most iterations; `None`: see [`SearchLimits::resolved`].
    pub iterations: Option<usize>,
    /// Most evaluations; `None`: see [`SearchLimits::resolved`].
    pub evaluations: Option<usize>,
    /// Converged when no vertex is farther than this from the best in any
    /// parameter (unit of the parameters), and ...
    pub x_tolerance: f64,
    /// ... no value differs from the best by more (unit of the function).
    pub f_tolerance: f64,
    /// Whose rules.
    pub stopping: Stopping,
}

impl Default for SearchLimits {
    fn default() -> Self {
        Self {
            iterations: None,
            evaluations: None,
            x_tolerance: 1e-4,
            f_tolerance: 1e-4,
            stopping: Stopping::Scipy,
        }
    }
}

impl SearchLimits {
    /// Most iterations and evaluations for `n` parameters. SciPy: 200 n of each if neither is
    /// given; no limit on one if only the other is given. `fminsearch`: 200 n for each that is not
    /// given.
    pub fn resolved(&self, n: usize) -> (usize, usize) {
        let usual = 200 * n;
        match (self.stopping, self.iterations, self.evaluations) {
            (_, Some(iterations), Some(evaluations)) => (iterations, evaluations),
            (Stopping::Fminsearch, iterations, evaluations) => {
                (iterations.unwrap_or(usual), evaluations.unwrap_or(usual))
            }
            (Stopping::Scipy, None, None) => (usual, usual),
            (Stopping::Scipy, iterations, evaluations) => {
                (iterations.unwrap_or(usize::MAX), evaluations.unwrap_or(usize::MAX))
            }
        }
    }
}

/// Why the search ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SearchEnd {
    /// Both tolerances were met.
    Converged,
    /// At the limit of evaluations: the result is the last state.
    Evaluations,
    /// At the limit of iterations: the result is the last state.
    Iterations,
}

/// Where the search ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Minimum {
    /// The best vertex.
    pub x: Vec<f64>,
    /// Its value.
    pub value: f64,
    /// Iterations, counted as SciPy counts (the first simplex is one).
    pub iterations: usize,
    /// Evaluations of the function.
    pub evaluations: usize,
    /// Why it ended.
    pub ended: SearchEnd,
    /// The last simplex, best vertex first.
    pub simplex: Vec<Vec<f64>>,
}

/// The first simplex of SciPy and `fminsearch` around `start`.
pub fn usual_simplex(start: &[f64]) -> Vec<Vec<f64>> {
    let moved = |k: usize| {
        let mut vertex = start.to_vec();
        vertex[k] = if vertex[k] == 0.0 {
            ZERO_STEP
        } else {
            (1.0 + NONZERO_STEP) * vertex[k]
        };
        vertex
    };
    std::iter::once(start.to_vec())
        .chain((0..start.len()).map(moved))
        .collect()
}

/// A simplex whose edges from `start` are the given `steps`.
pub fn stepped_simplex(start: &[f64], steps: &[f64]) -> Vec<Vec<f64>> {
    let moved = |k: usize| {
        let mut vertex = start.to_vec();
        vertex[k] += steps.get(k).copied().unwrap_or(ZERO_STEP);
        vertex
    };
    std::iter::once(start.to_vec())
        .chain((0..start.len()).map(moved))
        .collect()
}

/// The state of a search.
struct SimplexSearch<F> {
    function: F,
    vertices: Vec<Vec<f64>>,
    values: Vec<f64>,
    calls: usize,
    most_calls: usize,
    /// SciPy's rule: at the limit the current iteration is abandoned.
    interrupt: bool,
}

impl<F: FnMut(&[f64]) -> f64> SimplexSearch<F> {
    /// The function's value; `None` at the evaluation limit.
    fn value(&mut self, x: &[f64]) -> Option<f64> {
        if self.interrupt && self.calls >= self.most_calls {
            return None;
        }
        self.calls += 1;
        Some((self.function)(x))
    }

    /// Sorts the vertices by value; equal ones keep their order.
    fn sort(&mut self) {
        let mut order: Vec<usize> = (0..self.values.len()).collect();
        order.sort_by(|a, b| {
            let (a, b) = (self.values[*a], self.values[*b]);
            // As NumPy: NaN after everything else.
            a.partial_cmp(&b).unwrap_or_else(|| a.is_nan().cmp(&b.is_nan()))
        });
        self.vertices = order.iter().map(|i| std::mem::take(&mut self.vertices[*i])).collect();
        self.values = order.iter().map(|i| self.values[*i]).collect();
    }

    /// `c · centroid − w · worst`, in SciPy's order of operations.
    fn blend(&self, centroid: &[f64], c: f64, w: f64) -> Vec<f64> {
        let worst = &self.vertices[self.vertices.len() - 1];
        centroid.iter().zip(worst).map(|(x, y)| c * x - w * y).collect()
    }

    fn replace_worst(&mut self, x: Vec<f64>, value: f64) {
        let last = self.values.len() - 1;
        self.vertices[last] = x;
        self.values[last] = value;
    }

    /// One iteration without its sort; `None` if the limit interrupted it.
    fn iterate(&mut self) -> Option<()> {
        let n = self.values.len() - 1;
        let mut centroid = self.vertices[0].clone();
        for vertex in &self.vertices[1..n] {
            for (sum, x) in centroid.iter_mut().zip(vertex) {
                *sum += x;
            }
        }
        for x in &mut centroid {
            *x /= n as f64;
        }
        let reflected = self.blend(&centroid, 2.0, 1.0);
        let value = self.value(&reflected)?;
        if value < self.values[0] {
            let expanded = self.blend(&centroid, 3.0, 2.0);
            let further = self.value(&expanded)?;
            if further < value {
                self.replace_worst(expanded, further);
            } else {
                self.replace_worst(reflected, value);
            }
        } else if value < self.values[n - 1] {
            self.replace_worst(reflected, value);
        } else if value < self.values[n] {
            let contracted = self.blend(&centroid, 1.5, 0.5);
            let nearer = self.value(&contracted)?;
            if nearer <= value {
                self.replace_worst(contracted, nearer);
            } else {
                self.shrink()?;
            }
        } else {
            let contracted = self.blend(&centroid, 0.5, -0.5);
            let nearer = self.value(&contracted)?;
            if nearer < self.values[n] {
                self.replace_worst(contracted, nearer);
            } else {
                self.shrink()?;
            }
        }
        Some(())
    }

    /// Moves all vertices half way to the best. At the limit a vertex has moved but keeps its old
    /// value, as in SciPy.
    fn shrink(&mut self) -> Option<()> {
        for j in 1..self.values.len() {
            let moved: Vec<f64> = self.vertices[0]
                .iter()
                .zip(&self.vertices[j])
                .map(|(best, x)| best + 0.5 * (x - best))
                .collect();
            self.vertices[j].clone_from(&moved);
            self.values[j] = self.value(&moved)?;
        }
        Some(())
    }

    /// Whether both tolerances are met.
    fn settled(&self, limits: &SearchLimits) -> bool {
        let best = &self.vertices[0];
        let apart = self.vertices[1..]
            .iter()
            .flat_map(|v| v.iter().zip(best).map(|(x, b)| (x - b).abs()))
            .fold(0.0, f64::max);
        let differ = self.values[1..]
            .iter()
            .map(|v| (self.values[0] - v).abs())
            .fold(0.0, f64::max);
        let (x_tolerance, f_tolerance) = match limits.stopping {
            Stopping::Scipy => (limits.x_tolerance, limits.f_tolerance),
            Stopping::Fminsearch => {
                let largest = best.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                (
                    limits.x_tolerance.max(10.0 * spacing(largest)),
                    limits.f_tolerance.max(10.0 * spacing(self.values[0])),
                )
            }
        };
        // A NaN among the values meets no tolerance.
        apart <= x_tolerance && differ <= f_tolerance && self.values.iter().all(|v| !v.is_nan())
    }
}

/// Distance to the next larger number, MATLAB's `eps(x)`.
fn spacing(x: f64) -> f64 {
    let x = x.abs();
    if x.is_finite() { x.next_up() - x } else { f64::NAN }
}

/// Minimises `function` from a first simplex of n + 1 vertices of n parameters (see
/// [`usual_simplex`]). A simplex of another shape is returned unchanged, without an evaluation.
pub fn minimise(function: impl FnMut(&[f64]) -> f64, simplex: Vec<Vec<f64>>, limits: &SearchLimits) -> Minimum {
    let n = simplex.len().saturating_sub(1);
    if n == 0 || simplex.iter().any(|v| v.len() != n) {
        return Minimum {
            x: simplex.first().cloned().unwrap_or_default(),
            value: f64::NAN,
            iterations: 0,
            evaluations: 0,
            ended: SearchEnd::Evaluations,
            simplex,
        };
    }
    let (most_iterations, most_calls) = limits.resolved(n);
    let mut search = SimplexSearch {
        function,
        values: vec![f64::INFINITY; n + 1],
        vertices: simplex,
        calls: 0,
        most_calls,
        interrupt: limits.stopping == Stopping::Scipy,
    };
    for k in 0..=n {
        let vertex = search.vertices[k].clone();
        let Some(value) = search.value(&vertex) else { break };
        search.values[k] = value;
    }
    search.sort();
    let mut iterations = 1;
    let mut converged = false;
    while search.calls < most_calls && iterations < most_iterations {
        if search.settled(limits) {
            converged = true;
            break;
        }
        if search.iterate().is_some() {
            iterations += 1;
        }
        search.sort();
    }
    let ended = if converged {
        SearchEnd::Converged
    } else if search.calls >= most_calls {
        SearchEnd::Evaluations
    } else {
        SearchEnd::Iterations
    };
    Minimum {
        x: search.vertices[0].clone(),
        value: search.values[0],
        iterations,
        evaluations: search.calls,
        ended,
        simplex: search.vertices,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bowl(x: &[f64]) -> f64 {
        x.iter().enumerate().map(|(i, v)| (v - i as f64).powi(2)).sum()
    }

    // Fails if a converged search is not at the minimum.
    #[test]
    fn a_bowl_is_found() {
        let found = minimise(bowl, usual_simplex(&[3.0, 0.0, -1.0]), &SearchLimits::default());
        assert_eq!(found.ended, SearchEnd::Converged);
        for (i, x) in found.x.iter().enumerate() {
            assert!((x - i as f64).abs() < 1e-3);
        }
    }

    // Fails if SciPy's limit is exceeded, or if fminsearch's limit interrupts an iteration.
    #[test]
    fn limits_are_those_of_their_makers() {
        let limits = |stopping| SearchLimits {
            evaluations: Some(17),
            stopping,
            ..SearchLimits::default()
        };
        let start = usual_simplex(&[3.0, 0.0, -1.0]);
        let scipy = minimise(bowl, start.clone(), &limits(Stopping::Scipy));
        assert_eq!((scipy.evaluations, scipy.ended), (17, SearchEnd::Evaluations));
        let matlab = minimise(bowl, start, &limits(Stopping::Fminsearch));
        assert!((17..=17 + 4).contains(&matlab.evaluations));
    }

    #[test]
    fn a_simplex_of_the_wrong_shape_is_left_alone() {
        let found = minimise(bowl, vec![vec![1.0, 2.0]], &SearchLimits::default());
        assert_eq!((found.evaluations, found.x), (0, vec![1.0, 2.0]));
        assert!(minimise(bowl, vec![], &SearchLimits::default()).x.is_empty());
    }
}
