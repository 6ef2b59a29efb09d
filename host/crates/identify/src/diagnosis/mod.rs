//! What can be said of a fit beyond its estimates: how large its error is over the
//! workspace, what the model leaves out, and which causes the data name.

mod alternatives;
mod budget;
mod causes;
mod columns;
mod component;
mod dense;
mod discrepancy;
mod expected;
mod finding;
pub(crate) mod linear;
mod patterns;
mod payload;
mod scan;
mod scatter;
mod selection;
mod size;
mod tail;
mod words;

pub use crate::course::Course;
pub use alternatives::{Alternative, Family};
pub use budget::{BudgetTerm, ErrorBudget, Source};
pub use expected::{WORKSPACE, workspace};
pub use finding::{FamilyTest, Finding};
pub use scatter::ScatteredPlace;

use nalgebra::{DMatrix, DVector, Vector3};
use serde::Serialize;

pub(crate) use self::expected::{Rigid, Size, has_heavy_tails};
pub(crate) use self::tail::log_tail;

use self::component::{GroupOf, ParameterGroup};
use self::dense::{Factor, transposed_product};
use self::discrepancy::Discrepancy;
use self::expected::Field;
use self::linear::{Linear, Posture};
use self::payload::LoadEffects;
use self::scan::scan;
use crate::calibration::finish;
use crate::error::IdentifyError;
use crate::expected_error::ExpectedError;
use crate::options::{Options, Torque};
use crate::parameters::{Kind, Parameter};
use crate::{geometry_fit, priors};
use spherecal_model::Experiment;

/// A cause that the model leaves out and the data speak for.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Unmodelled {
    /// In words.
    pub words: String,
    /// Root mean square displacement of the TCP over the observations, in mm.
    pub rms_mm: f64,
    /// Natural logarithm of the evidence for it against its absence.
    pub evidence: f64,
}

/// Evidence (natural logarithm) from which a cause is listed.
const LISTED: f64 = 3.0;

/// What the data say about a fit.
#[derive(Clone, Debug)]
pub struct Diagnosis {
    /// Error of the full model over the workspace.
    pub expected: ExpectedError,
    /// The mean of that over the draws alone, in mm: without what heavy tails of the residuals add.
    pub(crate) drawn_mm: f64,
    /// Causes that the data name, strongest first.
    pub findings: Vec<Finding>,
    /// Largest statistic of each family of causes.
    pub families: Vec<FamilyTest>,
    /// Places whose rows scatter more than the others, worst first.
    pub scattered: Vec<ScatteredPlace>,
    /// Causes that the model leaves out and the data speak for.
    pub unmodelled: Vec<Unmodelled>,
    /// Root mean square displacement of the TCP by the noise of one pose, in mm.
    pub noise_mm: f64,
    /// The parameter that the data moved furthest from its nominal value.
    pub moved: Option<MovedParameter>,
    /// Joint angles of the workspace, in rad, and the estimated TCP at each, in m.
    workspace: Vec<Vec<f64>>,
    tcp_m: Vec<Vector3<f64>>,
    field: Field,
}

/// A parameter that the data moved away from its nominal value.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MovedParameter {
    /// Its name.
    pub name: String,
    /// How far, in standard deviations of its prior.
    pub sigmas: f64,
    /// Whether it describes the shape of the arm: a length or a twist of a link.
    pub shape: bool,
}

impl Diagnosis {
    /// The expected error over the workspace of another model of the same robot: the
    /// nominal one, or geometry alone. `tcp_m` gives its TCP in its own frame F0, in m,
    /// at joint angles in rad.
    pub fn expected_error_of(&self, tcp_m: impl Fn(&[f64]) -> Vector3<f64>) -> ExpectedError {
        self.field.expected(Some(&self.off(tcp_m)))
    }

    /// The same by source: what the plate, the seating, the noise of the joints, the open
    /// parameters and the model contribute.
    /// None where the equations have no solution.
    pub fn budget_of(&self, tcp_m: impl Fn(&[f64]) -> Vector3<f64>) -> Option<ErrorBudget> {
        self.field.budget(&self.off(tcp_m))
    }

    /// Root mean square error over the workspace that the expected error is made from, in mm, by draws. The total of the
    /// budget is the same figure without drawing.
    pub fn drawn_rms_mm_of(&self, tcp_m: impl Fn(&[f64]) -> Vector3<f64>) -> f64 {
        self.field.rms(&self.off(tcp_m)) * 1e3
    }

    /// How likely it is that one model is no better than another, by mean TCP error
    /// over the workspace: the share of the draws in which it is not.
    pub fn chance_not_better(
        &self,
        model_m: impl Fn(&[f64]) -> Vector3<f64>,
        than_m: impl Fn(&[f64]) -> Vector3<f64>,
    ) -> f64 {
        let own = self.field.drawn(&self.off(model_m));
        let other = self.field.drawn(&self.off(than_m));
        let not_better = own.iter().zip(&other).filter(|(a, b)| a >= b).count();
        not_better as f64 / own.len().max(1) as f64
    }

    /// Renumbers the rows of the findings: row `k` is `rows[k]`, to be found in `all`. Both
    /// are in ascending order.
    pub(crate) fn renumber(&mut self, all: &[usize], rows: &[usize]) {
        for finding in &mut self.findings {
            let known = finding
                .rows
                .iter()
                .filter_map(|k| all.binary_search(rows.get(*k)?).ok());
            finding.rows = known.collect();
        }
    }

    /// A model's TCP minus the estimate's over the workspace, in m.
    fn off(&self, tcp_m: impl Fn(&[f64]) -> Vector3<f64>) -> Vec<Vector3<f64>> {
        let points = self.workspace.iter().zip(&self.tcp_m);
        points.map(|(q, estimate)| tcp_m(q) - estimate).collect()
    }
}

/// Groups of parameters whose priors are known alike.
fn groups(table: &[Parameter]) -> Vec<ParameterGroup> {
    let key = |k: &Kind| match *k {
        Kind::A(_) | Kind::D(_) => 0,
        Kind::Alpha(_) | Kind::Beta(_) => 1,
        Kind::Theta(_) => 2,
        Kind::Compliance(_) => 3,
        Kind::Bending(..) | Kind::Tilt(_) => 4,
        Kind::Cosine(_, 1) | Kind::Sine(_, 1) => 5,
        Kind::Cosine(_, 2) | Kind::Sine(_, 2) => 6,
        Kind::Cosine(_, 3..=5) | Kind::Sine(_, 3..=5) => 7,
        Kind::Cosine(..) | Kind::Sine(..) => 8,
        Kind::Tool(_) | Kind::Target(..) | Kind::Body(_) | Kind::Base(..) | Kind::Sphere(..) | Kind::Seat(..) => 9,
    };
    let mut columns: Vec<[Vec<usize>; 2]> = vec![Default::default(); 10];
    for (i, parameter) in table.iter().enumerate() {
        columns[key(&parameter.kind)][usize::from(parameter.set_by_user)].push(i);
    }
    let group = |(key, [own, given]): (usize, [Vec<usize>; 2])| {
        let of = match key {
            0 => GroupOf::Lengths,
            1 | 2 | 9 => GroupOf::Geometry,
            _ => GroupOf::Effects,
        };
        [
            ParameterGroup::new(own, key < 9, of),
            ParameterGroup::new(given, false, of),
        ]
    };
    let found = columns.into_iter().enumerate().flat_map(group);
    found.filter(|g| !g.columns.is_empty()).collect()
}

/// Fits the model to the calibration set and says what the data tell about the fit:
/// its expected error over `workspace` (joint angles, rad; see [`workspace`]), and the
/// causes that they name. `course` says in which order and in which coupling the
/// observations were made; see [`Course::in_order`].
///
/// # Errors
/// Data or options that cannot be used, or equations that have no solution.
pub fn diagnose(
    experiment: &Experiment,
    options: &Options,
    course: &Course,
    workspace: &[Vec<f64>],
) -> Result<Diagnosis, IdentifyError> {
    let fit = geometry_fit::fit(experiment, options, options.model, |_| true)?;
    let table: Vec<Parameter> = fit.unknowns.columns.iter().map(|c| fit.table[*c].clone()).collect();
    let scale = table
        .iter()
        .map(|p| {
            if p.set_by_user {
                p.prior_sigma
            } else {
                priors::default_of(p.kind, experiment, &fit.layout).prior_sigma
            }
        })
        .collect();
    let linear = Linear::new(&fit, scale);
    let moved = furthest(&table, &fit.unknowns.deviation);
    let layout = fit.layout.clone();
    let calibration = finish(experiment, options, options.model, fit);
    let first = Discrepancy::find(&linear, course, groups(&table))?;
    // Of a robot without masses the load has no size, and measured torques hold any load.
    let loaded = LoadEffects {
        compliance: &calibration.compliance_rad_per_nm,
        columns: (0..layout.n)
            .map(|joint| table.iter().position(|p| p.kind == Kind::Compliance(joint)))
            .collect(),
        com_from_tcp_m: com_from_tcp(experiment),
        arm_kg: experiment.robot.joints.iter().map(|joint| joint.link.mass_kg).sum(),
    };
    let by_model = !calibration.assumed_masses && options.torque != Torque::Measured;
    let (mut findings, families, discrepancy) = scan(&linear, &layout, course, by_model.then_some(&loaded), first)?;
    let configurations: Vec<(DMatrix<f64>, Posture)> = workspace
        .iter()
        .map(|q| {
            let (mut rows, posture) = calibration.workspace_rows(q);
            for (mut column, sigma) in rows.column_iter_mut().zip(&linear.scale) {
                column.scale_mut(*sigma);
            }
            (rows, posture)
        })
        .collect();
    if !findings.is_empty() {
        harm(&linear, &discrepancy, &configurations, &mut findings)?;
    }
    let unmodelled = discrepancy
        .components
        .iter()
        .filter(|c| c.gain > LISTED)
        .map(|c| Unmodelled {
            words: c.shape.cause.words(),
            rms_mm: c.amplitude * discrepancy.noise_m * 1e3,
            evidence: c.gain,
        });
    let mut unmodelled: Vec<Unmodelled> = unmodelled.collect();
    unmodelled.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    let noise_mm = discrepancy.noise_m * 1e3;
    let certified = |(_, p): &(usize, &Parameter)| matches!(p.kind, Kind::Sphere(..));
    let plate = table.iter().enumerate().filter(certified).map(|(column, _)| column);
    let size = Size::of(calibration.heavy_tails);
    let field = Field::draw(&linear, discrepancy, &configurations, plate.collect(), size)?;
    let expected = field.expected(None);
    Ok(Diagnosis {
        drawn_mm: expected.mean / size.factor,
        expected,
        findings,
        families,
        scattered: scatter::scattered(&linear, course),
        unmodelled,
        noise_mm,
        moved,
        workspace: workspace.to_vec(),
        tcp_m: configurations.iter().map(|c| c.1.tcp).collect(),
        field,
    })
}

/// Centre of mass of the tool seen from the TCP, in m: half way to the flange where the tool has no mass.
fn com_from_tcp(experiment: &Experiment) -> Vector3<f64> {
    let (tcp, body) = (experiment.tool.tcp(), &experiment.tool.body);
    if body.mass_kg > 0.0 {
        body.com() - tcp
    } else {
        -0.5 * tcp
    }
}

/// The parameter that is furthest from its nominal value, in sigmas of its prior as it was stated: a prior that the
/// data widened would hide that they are those of another arm.
/// Effects that have no nominal value and frames that have no prior do not count.
fn furthest(table: &[Parameter], deviation: &[f64]) -> Option<MovedParameter> {
    let candidates = table.iter().zip(deviation.iter()).filter_map(|(p, by)| {
        let shape = match p.kind {
            Kind::A(_) | Kind::D(_) | Kind::Alpha(_) | Kind::Beta(_) => true,
            Kind::Theta(_) | Kind::Tool(_) | Kind::Sphere(..) => false,
            _ => return None,
        };
        let sigmas = by.abs() / p.stated_sigma;
        sigmas.is_finite().then(|| MovedParameter {
            name: p.name.clone(),
            sigmas,
            shape,
        })
    });
    candidates.max_by(|a, b| a.sigmas.total_cmp(&b.sigmas))
}

/// What each finding does to the calibration: the mean displacement over the
/// workspace of the estimate that took it for a property of the robot.
fn harm(
    linear: &Linear,
    discrepancy: &Discrepancy,
    configurations: &[(DMatrix<f64>, Posture)],
    findings: &mut [Finding],
) -> Result<(), IdentifyError> {
    let m = discrepancy.m;
    let d = discrepancy.sigmas(|_| true).rows(0, m).into_owned();
    let mut a = discrepancy.n.view((0, 0), (m, m)).into_owned();
    for r in 0..m {
        for c in 0..m {
            a[(r, c)] *= d[r] * d[c] / linear.s2;
        }
        a[(r, r)] += 1.0;
    }
    let factor = Factor::new(a).ok_or(IdentifyError::Singular { free: m })?;
    let points: Vec<Vector3<f64>> = configurations.iter().map(|c| c.1.tcp).collect();
    let rigid = Rigid::new(&points);
    for finding in findings {
        let columns: Vec<DVector<f64>> = finding.columns.iter().map(|c| c.0.clone()).collect();
        let y = DMatrix::from_columns(&columns) * &finding.effect;
        let right = transposed_product(&linear.x, &DMatrix::from_columns(&[y]))
            .column(0)
            .component_mul(&d)
            / linear.s2;
        let x = factor.solve_vector(&right).component_mul(&d);
        let mut moved = DMatrix::zeros(3 * configurations.len(), 1);
        for (k, (rows, _)) in configurations.iter().enumerate() {
            let v = rows * &x;
            for axis in 0..3 {
                moved[(3 * k + axis, 0)] = v[axis];
            }
        }
        rigid.remove(&mut moved);
        let lengths = moved
            .as_slice()
            .chunks_exact(3)
            .map(|v| Vector3::from_column_slice(v).norm());
        finding.harm_mm = lengths.sum::<f64>() / configurations.len().max(1) as f64 * 1e3;
    }
    Ok(())
}
