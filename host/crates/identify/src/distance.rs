//! The paper's fitness (Equations 9 to 13) as a problem for any optimiser: 21 link parameters in mm
//! and rad, with tool and base as measured.
//!
//! For contacts the residuals are differences of distances between poses. With `e_i = R P(q_i) −
//! S_i`, the sum of `|e_i − e_j|²` over all pairs is exactly `N Σ |e_i − ē|²`. This collapsed form
//! is linear in the poses, while the paper sums 44,850 terms. [`Pairs::Vector`] uses it, with the
//! base rotation at its nominal value. [`Pairs::Norm`] compares lengths, `|P_i − P_j| − |S_i −
//! S_j|`, and so needs no base. Its pairs on one sphere collapse in the same way, because their
//! certified distance is zero; pairs between spheres are summed one by one.
//!
//! For absolute points the residuals are `R P(q_i) + t − p_i` (Equation 13).

use nalgebra::{DMatrix, Matrix3, Vector3};
use spherecal_shared::robot::Tool;

use super::algorithm1::{Columns, Scaling, position_jacobian, reduce};
use super::calibration::Calibration;
use super::chain::{Prepared, State};
use super::error::IdentifyError;
use super::finish::finish;
use super::hierarchy::cross::CrossEffects;
use super::hierarchy::open::OpenSizes;
use super::hierarchy::sizes::Strangeness;
use super::hierarchy::{Ends, FEWEST, Fit, prepare, register};
use super::identifiability::analyse;
use super::load::Nominal;
use super::normal::{Whitening, accumulate, groups};
use super::options::{Method, Model, Options, Pairs, Torque};
use super::parameter_table::table;
use super::parameters::{Kind, Layout, Parameter, Unit};
use super::solve::Unknowns;
use super::targets::Reference;
use spherecal_model::halton::halton;
use spherecal_model::{Experiment, Observation, Pose, Set, Target};

mod newton;

/// mm per m.
const MM: f64 = 1000.0;

/// A distance problem: objective, residual normal equations, start.
#[derive(Clone, Debug)]
pub struct DistanceProblem {
    layout: Layout,
    table: Vec<Parameter>,
    /// Optimised columns of the layout, in the order of the paper's table: alpha, a, theta, d, row
    /// by row.
    columns: Vec<usize>,
    start: State,
    nominal: Nominal,
    prepared: Vec<Prepared>,
    pairs: Pairs,
    absolute: bool,
    /// Base rotation of the vector form and base of absolute data.
    base: Pose,
}

/// `count` unscrambled Halton configurations over the joint limits. The first item of the sequence,
/// the corner of the lower limits, is left out.
pub fn halton_configurations(robot: &spherecal_shared::robot::Robot, count: usize) -> Vec<Vec<f64>> {
    (1..=count)
        .map(|index| {
            robot
                .joints
                .iter()
                .enumerate()
                .map(|(j, joint)| {
                    let l = &joint.limits;
                    l.min_rad + (l.max_rad - l.min_rad) * halton(index, j)
                })
                .collect()
        })
        .collect()
}

impl DistanceProblem {
    /// The problem of an experiment's calibration set.
    ///
    /// # Errors
    /// The data cannot be used, are too few, or mix sphere contacts with points.
    pub fn new(experiment: &Experiment, options: &Options) -> Result<Self, IdentifyError> {
        experiment.check()?;
        let several = |o: &Observation| matches!(o.target, Target::Points(_) | Target::Frame(_));
        if experiment.observations.iter().any(several) {
            return Err(IdentifyError::Method {
                method: options.method.name(),
                reason: "the paper's fitness takes one point per row: use full or geometry for several targets or \
                         poses"
                    .to_owned(),
            });
        }
        let layout = Layout::new(experiment, 0, false);
        let nominal = Nominal::new(&experiment.robot, &experiment.tool);
        let wanted = |i: usize| {
            let chosen = options.subset.as_ref().is_none_or(|s| s.contains(&i));
            chosen && experiment.observations.get(i).is_some_and(|o| o.set == Set::Calibrate)
        };
        let prepared = prepare(experiment, &layout, &nominal, Torque::Model, wanted)?;
        if prepared.len() < FEWEST {
            return Err(IdentifyError::TooFewObservations {
                found: prepared.len(),
                needed: FEWEST,
            });
        }
        if layout.references.len() != 1 {
            return Err(IdentifyError::Method {
                method: options.method.name(),
                reason: "the paper's fitness supports one placement of the plate, or only absolute points: \
                         use full or geometry"
                    .to_owned(),
            });
        }
        let mut table = table(experiment, &layout, options)?;
        // The columns that Algorithm 1 keeps for a TCP on the flange axis, as in the paper's Table
        // 2.
        let flange = Tool {
            tcp_m: [0.0; 3],
            ..experiment.tool
        };
        let links = Columns {
            first_row: false,
            tool: false,
            base: false,
        };
        let draws = halton_configurations(&experiment.robot, 29);
        let jacobian = position_jacobian(&experiment.robot, &flange, &draws, links);
        let left = reduce(&jacobian, Scaling::Millimetre).kept;
        let mut columns = Vec::new();
        for name in &jacobian.names {
            if let Some(at) = table.iter().position(|p| p.name == *name) {
                let named = options.parameters.0.get(name).and_then(|o| o.free);
                if named.unwrap_or_else(|| left.contains(name)) {
                    columns.push(at);
                }
            }
        }
        for (at, parameter) in table.iter_mut().enumerate() {
            parameter.free = columns.contains(&at);
            if !parameter.free && matches!(parameter.kind, Kind::Tool(_) | Kind::Base(..) | Kind::Sphere(..)) {
                parameter.reason = "fixed: as measured, as in the paper";
            } else if !parameter.free {
                parameter.reason = "fixed: redundant by Algorithm 1";
            }
        }
        let mut start = State::nominal(&experiment.robot, &experiment.tool, &layout);
        for parameter in &table {
            if !matches!(parameter.kind, Kind::Base(..)) {
                let now = start.get(parameter.kind);
                start.add(parameter.kind, parameter.nominal - now);
            }
        }
        start.refresh();
        register(&mut start, &prepared, options.base.as_ref());
        Ok(Self {
            absolute: layout.references == [Reference::Tracker],
            base: start.bases.first().copied().unwrap_or_default(),
            pairs: options.pairs,
            layout,
            table,
            columns,
            start,
            nominal,
            prepared,
        })
    }

    /// Number of poses.
    pub fn poses(&self) -> usize {
        self.prepared.len()
    }

    /// Number of pairs that the fitness is summed over.
    pub fn pairs(&self) -> usize {
        self.poses() * (self.poses() - 1) / 2
    }

    /// Base rotation in the plate's (or tracker's) frame, constant in the vector form.
    pub fn base_rotation(&self) -> Matrix3<f64> {
        self.base.rotation
    }

    /// Names of the parameters, in order.
    pub fn names(&self) -> Vec<&str> {
        self.columns.iter().map(|c| self.table[*c].name.as_str()).collect()
    }

    fn unit(&self, column: usize) -> f64 {
        if self.table[column].unit == Unit::Metre {
            MM
        } else {
            1.0
        }
    }

    /// Nominal values, in mm and rad.
    pub fn nominal(&self) -> Vec<f64> {
        let value = |c: &usize| self.start.get(self.table[*c].kind) * self.unit(*c);
        self.columns.iter().map(value).collect()
    }

    /// Standard deviations of the priors, in mm and rad; useful first steps.
    pub fn prior_sigmas(&self) -> Vec<f64> {
        let value = |c: &usize| self.table[*c].prior_sigma * self.unit(*c);
        self.columns.iter().map(value).collect()
    }

    fn state(&self, x: &[f64]) -> State {
        let mut state = self.start.clone();
        for (&column, value) in self.columns.iter().zip(x) {
            let kind = self.table[column].kind;
            state.add(kind, value / self.unit(column) - state.get(kind));
        }
        state.refresh();
        state
    }

    /// TCPs in F0 at parameters `x`, in mm.
    pub fn tcps_mm(&self, x: &[f64]) -> Vec<Vector3<f64>> {
        let state = self.state(x);
        let tcp = |p: &Prepared| state.at(p).tcp * MM;
        self.prepared.iter().map(tcp).collect()
    }

    /// The fitness at `x` (mm and rad), in mm².
    pub fn objective_mm2(&self, x: &[f64]) -> f64 {
        let tcps = self.tcps_mm(x);
        if self.absolute || self.pairs == Pairs::Vector {
            let errors: Vec<_> = tcps.iter().zip(&self.prepared).map(|(p, o)| self.error(p, o)).collect();
            if self.absolute {
                return errors.iter().map(Vector3::norm_squared).sum();
            }
            let mean = errors.iter().sum::<Vector3<f64>>() / errors.len() as f64;
            let sum: f64 = errors.iter().map(|e| (e - mean).norm_squared()).sum();
            return sum * errors.len() as f64;
        }
        let mut sum = 0.0;
        for (i, a) in tcps.iter().enumerate() {
            for (j, b) in tcps.iter().enumerate().skip(i + 1) {
                sum += self.norm_residual(a, b, i, j).powi(2);
            }
        }
        sum
    }

    /// The fitness over a subset of the pairs (a mini-batch), in mm².
    ///
    /// Indices out of range are ignored.
    pub fn batch_mm2(&self, x: &[f64], pairs: &[(usize, usize)]) -> f64 {
        let state = self.state(x);
        let tcp = |i: usize| self.prepared.get(i).map(|p| state.at(p).tcp * MM);
        let term = |&(i, j): &(usize, usize)| match (tcp(i), tcp(j)) {
            (Some(a), Some(b)) if self.pairs == Pairs::Vector => {
                let (a, b) = (self.error(&a, &self.prepared[i]), self.error(&b, &self.prepared[j]));
                (a - b).norm_squared()
            }
            (Some(a), Some(b)) => self.norm_residual(&a, &b, i, j).powi(2),
            _ => 0.0,
        };
        pairs.iter().map(term).sum()
    }

    /// `R P + t − S` in mm. For contacts `t` is left out, because it cancels in pairs.
    fn error(&self, tcp_mm: &Vector3<f64>, observation: &Prepared) -> Vector3<f64> {
        let turned = self.base.rotation * tcp_mm - observation.target * MM;
        if self.absolute {
            turned + self.base.position * MM
        } else {
            turned
        }
    }

    fn norm_residual(&self, a: &Vector3<f64>, b: &Vector3<f64>, i: usize, j: usize) -> f64 {
        (a - b).norm() - (self.prepared[i].target - self.prepared[j].target).norm() * MM
    }

    /// The result at parameters `x` (mm and rad), from any optimiser.
    pub fn calibration(&self, experiment: &Experiment, options: &Options, x: &[f64]) -> Calibration {
        let mut state = self.state(x);
        if !self.absolute {
            // The distances do not contain the base, so the base is registered to the calibrated
            // model.
            register(&mut state, &self.prepared, None);
        }
        let equations = self.equations(x);
        let m = self.columns.len();
        let count = self.poses() as f64;
        let freedom = (3.0 * count - m as f64 - 3.0).max(1.0);
        // Every pose occurs in many pairs: convert to one residual per pose.
        let per_pose = if self.absolute { 1.0 } else { count };
        let variance = equations.objective / per_pose / freedom;
        let inverse = equations.matrix.try_inverse().unwrap_or_else(|| DMatrix::zeros(m, m));
        // The calibration lists its parameters in column order.
        let mut order: Vec<usize> = (0..m).collect();
        order.sort_by_key(|i| self.columns[*i]);
        let covariance = DMatrix::from_fn(m, m, |r, c| {
            let (r, c) = (order[r], order[c]);
            let units = self.unit(self.columns[r]) * self.unit(self.columns[c]);
            inverse[(r, c)] * variance * per_pose / units
        });
        let millimetre = 1e-6;
        let mut whitening = Whitening::new(&options.noise);
        (whitening.joint, whitening.seating, whitening.point) = (0.0, millimetre, millimetre);
        whitening.along.fill(millimetre);
        let grouped = groups(&self.prepared);
        let weights = vec![1.0; self.poses()];
        let design = accumulate(
            &self.start,
            &self.layout,
            &self.prepared,
            &grouped,
            &whitening,
            &weights,
        );
        let identifiability = analyse(&design, &self.table, self.poses());
        let fit = Fit {
            layout: self.layout.clone(),
            unknowns: Unknowns::new(&self.table),
            table: self.table.clone(),
            start: self.start.clone(),
            state,
            nominal: self.nominal.clone(),
            groups: grouped,
            prepared: self.prepared.clone(),
            whitening: Whitening {
                seating: millimetre * variance,
                point: millimetre * variance,
                along: whitening.along.map(|along| along * variance),
                ..whitening
            },
            shares: weights.clone(),
            weights,
            effective: m as f64,
            cross: CrossEffects::none(&covariance),
            by_causes: std::collections::BTreeMap::new(),
            displaced: std::collections::BTreeMap::new(),
            scale: crate::hierarchy::Scale::Known,
            ends: Ends::default(),
            left: std::collections::BTreeMap::new(),
            left_out: std::collections::BTreeMap::new(),
            open: OpenSizes::none(covariance.nrows()),
            covariance,
            log_evidence: f64::NAN,
            nu: 0.0,
            strangeness: Strangeness::default(),
            identifiability,
        };
        finish(experiment, options, Model::Geometry, fit)
    }
}

/// `lm` and `gauss-newton`.
pub(crate) fn identify(experiment: &Experiment, options: &Options) -> Result<Calibration, IdentifyError> {
    let problem = DistanceProblem::new(experiment, options)?;
    let x = problem.solve(options.method == Method::Lm)?;
    Ok(problem.calibration(experiment, options, &x))
}
