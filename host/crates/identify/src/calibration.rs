//! The result: a calibrated robot with everything that is known about its errors.

use nalgebra::{DMatrix, Matrix3, Vector3};
use serde::Serialize;
use spherecal_shared::robot::{Robot, Tool};

use super::chain::{N, OWN, State};
use super::identifiability::Identifiability;
use super::load::Nominal;
use super::map::{self, Fit};
use super::options::{Method, Model, Options};
use super::parameters::{Layout, Reference, Unit};
use super::residuals::{GroupFit, Residual, residuals};
use super::target_fit::{OrientationFit, TargetFit, target_fits};
use spherecal_model::{Experiment, Pose, Sphere};

/// One parameter's row of the result.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ParameterEstimate {
    /// Name, as in [`super::parameters`].
    pub name: String,
    /// Unit of all its values.
    pub unit: Unit,
    /// Value before the data were seen.
    pub nominal: f64,
    /// Value now.
    pub estimate: f64,
    /// Standard deviation now; 0 where it was fixed.
    pub sigma: f64,
    /// Standard deviation before the data were seen.
    pub prior_sigma: f64,
    /// Whether it was estimated at all.
    pub free: bool,
    /// Whether the data determine it: `sigma` is under half of `prior_sigma`.
    pub identified: bool,
    /// Whether it left its nominal value by a thousandth of `prior_sigma`.
    pub moved: bool,
    /// Why the prior is what it is, or why the parameter is fixed.
    pub reason: String,
}

/// The base seen from one reference frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FramePose {
    /// The frame: the tracker's, or the plate's in one of its places.
    pub reference: Reference,
    /// F0 in that frame.
    pub base: Pose,
}

/// Factors on the table's priors of the robot's effects.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PriorFactors {
    /// Of joint compliance, link bending and base tilt.
    pub stiffness: f64,
    /// Of encoder harmonics.
    pub harmonics: f64,
}

/// A calibrated robot.
#[derive(Clone, Debug, Serialize)]
pub struct Calibration {
    /// Method that made it.
    pub method: Method,
    /// Errors that are modelled.
    pub model: Model,
    /// Calibrated robot: geometry by its table, everything else as nominal.
    pub robot: Robot,
    /// Calibrated tool.
    pub tool: Tool,
    /// F0 seen from the first reference frame (the plate, or the tracker).
    pub base: Pose,
    /// F0 seen from every reference frame.
    pub frames: Vec<FramePose>,
    /// Joint compliance, base to flange, in rad/(N m): `q − c τ` is the joint's angle.
    pub compliance_rad_per_nm: Vec<f64>,
    /// Encoder harmonics by joint and order: cosine and sine part, in rad.
    pub harmonics_rad: Vec<Vec<[f64; 2]>>,
    /// Link bending by joint about x and y of its frame, in rad/(N m).
    pub bending_rad_per_nm: Vec<[f64; 2]>,
    /// Base tilt about x and y of F0, in rad/(N m).
    pub tilt_rad_per_nm: [f64; 2],
    /// The plate with the spheres where the data put them within their certificate.
    pub spheres: Vec<Sphere>,
    /// Every parameter of the model.
    pub parameters: Vec<ParameterEstimate>,
    /// What the data can tell.
    pub identifiability: Identifiability,
    /// Residuals of the calibration set.
    pub residual: Residual,
    /// Goodness of fit by sphere and place.
    pub groups: Vec<GroupFit>,
    /// Every target of the tool, where the data have several or measured orientations; else empty.
    pub targets: Vec<TargetFit>,
    /// The measured orientations, where the data have them.
    pub orientation: Option<OrientationFit>,
    /// Noise found, as a factor on [`super::Noise`]. Where rows have several parts, the noise of each was
    /// estimated before ([`Self::targets`]), and this is about 1.
    pub noise_scale: f64,
    /// Parameters that the data determine, out of those free.
    pub effective_parameters: f64,
    /// Natural logarithm of the model's evidence; compares models on the same data.
    pub log_evidence: f64,
    /// Factors on the priors of the effects that the evidence chose.
    pub prior_factors: PriorFactors,
    /// Natural logarithm of the likelihood of heavy tails of the residuals over light ones; 0 where
    /// none was compared.
    pub heavy_tails: f64,
    /// Highest order of the encoder harmonics that the evidence left in the model.
    pub harmonic_orders: usize,
    /// Factor on the noise in estimate and covariance: 1 where residuals do not
    /// repeat from pose to pose, up to [`super::Noise::inflation`] where they do.
    pub noise_inflation: f64,
    /// Whether the robot's description has no masses, so that assumed ones gave
    /// the load its shape (and compliance is relative to them).
    pub assumed_masses: bool,
    /// Covariance of the free parameters, in the order in which
    /// [`Self::parameters`] lists them, SI units.
    #[serde(skip)]
    pub covariance: DMatrix<f64>,
    #[serde(skip)]
    pub(crate) inner: Inner,
}

/// What predictions are computed from.
#[derive(Clone, Debug)]
pub(crate) struct Inner {
    layout: Layout,
    state: State,
    pub(crate) nominal: Nominal,
    columns: Vec<usize>,
    /// Variance of the joint noise that stays in every pose, in rad².
    joint_variance: f64,
    /// Whether the fit took the joints' torques from the data.
    measured_torque: bool,
}

impl Calibration {
    /// TCP in F0, in m, at encoder angles `q` (rad).
    ///
    /// `tau` are measured joint torques (N m). They take the place of the model's gravity where
    /// the fit was made with measured torques, and are not used where it was not. Joints that are missing
    /// count as zero.
    pub fn tcp_m(&self, q: &[f64], tau: Option<&[f64]>) -> Vector3<f64> {
        let load = self.inner.nominal.load(q, tau.filter(|_| self.inner.measured_torque));
        self.inner.state.evaluate(&pad(q), &load).tcp
    }

    /// Target `number` of the tool (from 1: the TCP) in F0, in m, as [`Self::tcp_m`] gives the TCP. A number
    /// that the data do not have gives the TCP.
    pub fn target_m(&self, number: usize, q: &[f64], tau: Option<&[f64]>) -> Vector3<f64> {
        let load = self.inner.nominal.load(q, tau.filter(|_| self.inner.measured_torque));
        self.inner.state.target_at(&pad(q), &load, number.saturating_sub(1))
    }

    /// Orientation of the measured body in F0: 3 x 3. That of the last frame where the data have no orientations.
    pub fn body_rotation(&self, q: &[f64], tau: Option<&[f64]>) -> Matrix3<f64> {
        let load = self.inner.nominal.load(q, tau.filter(|_| self.inner.measured_torque));
        let state = &self.inner.state;
        state.body_at(&state.evaluate(&pad(q), &load), &load)
    }

    /// Orientation of the measured body in the last frame of the table: 3 x 3.
    pub(crate) fn body_in_flange(&self) -> Matrix3<f64> {
        self.inner.state.body
    }

    /// TCP in the first reference frame (plate or tracker), in m.
    pub fn tcp_world_m(&self, q: &[f64], tau: Option<&[f64]>) -> Vector3<f64> {
        self.base.point(&self.tcp_m(q, tau))
    }

    /// Covariance of the TCP predicted by [`Self::tcp_world_m`], in m², axes of
    /// the first reference frame: all parameters with their correlations, and
    /// the joint noise of a single pose.
    pub fn tcp_covariance(&self, q: &[f64]) -> Matrix3<f64> {
        self.covariance_of(q, true)
    }

    /// The same for [`Self::tcp_m`]: of the TCP in the robot's own frame F0, without
    /// the uncertainty of where the base stands (axes of the first reference frame).
    pub fn tcp_covariance_in_base(&self, q: &[f64]) -> Matrix3<f64> {
        self.covariance_of(q, false)
    }

    fn covariance_of(&self, q: &[f64], base: bool) -> Matrix3<f64> {
        let inner = &self.inner;
        let columns = self.prediction_columns(q, base);
        let picked = columns.select_columns(&inner.columns);
        let mut covariance = Matrix3::zeros();
        let product = &picked * &self.covariance * picked.transpose();
        covariance.copy_from(&product);
        for j in 0..inner.layout.n {
            let column: Vector3<f64> = columns.fixed_view::<3, 1>(0, inner.layout.joint(j)).into();
            covariance += column * column.transpose() * inner.joint_variance;
        }
        covariance
    }

    /// Columns of the prediction in the first reference frame: 3 x layout.
    fn prediction_columns(&self, q: &[f64], base: bool) -> DMatrix<f64> {
        let inner = &self.inner;
        let (layout, state) = (&inner.layout, &inner.state);
        let load = inner.nominal.load(q, None);
        let k = state.evaluate(&pad(q), &load);
        let mut general = [Vector3::zeros(); OWN];
        let mut joints = [Vector3::zeros(); N];
        state.columns(layout, &k, &load, &mut general, &mut joints);
        let rotation = self.base.rotation;
        let mut columns = DMatrix::zeros(3, layout.len());
        for (c, column) in general.iter().enumerate().take(layout.general()) {
            columns.fixed_view_mut::<3, 1>(0, c).copy_from(&(rotation * column));
        }
        for j in 0..layout.n {
            let along = rotation * joints[j];
            let mut at = layout.joint(j);
            let mut put = |value: f64| {
                columns.fixed_view_mut::<3, 1>(0, at).copy_from(&(along * value));
                at += 1;
            };
            put(1.0);
            if layout.stiffness {
                put(-load.joint[j][2]);
            }
            let (c, s) = k.trig[j];
            let (mut ck, mut sk) = (c, s);
            for _ in 0..layout.orders {
                put(ck);
                put(sk);
                (ck, sk) = (ck * c - sk * s, sk * c + ck * s);
            }
        }
        if base && !layout.references.is_empty() {
            let turned = rotation * k.tcp;
            for axis in 0..3 {
                let e: Vector3<f64> = Vector3::ith(axis, 1.0);
                columns.fixed_view_mut::<3, 1>(0, layout.base(0) + axis).copy_from(&e);
                columns
                    .fixed_view_mut::<3, 1>(0, layout.base(0) + 3 + axis)
                    .copy_from(&e.cross(&turned));
            }
        }
        columns
    }

    /// How the TCP in F0 depends on the free parameters at the configurations (three
    /// rows each), the covariance of those parameters, and the standard deviations of their priors: of all on
    /// which it depends.
    pub(crate) fn spread_in_base(&self, configurations: &[Vec<f64>]) -> (DMatrix<f64>, DMatrix<f64>, Vec<f64>) {
        let free = &self.inner.columns;
        let mut columns = DMatrix::zeros(3 * configurations.len(), free.len());
        for (k, q) in configurations.iter().enumerate() {
            let own = self.prediction_columns(q, false).select_columns(free);
            columns.rows_mut(3 * k, 3).copy_from(&own);
        }
        let moving: Vec<usize> = (0..free.len()).filter(|&c| columns.column(c).amax() > 0.0).collect();
        let covariance = self.covariance.select_rows(&moving).select_columns(&moving);
        let priors: Vec<f64> = self
            .parameters
            .iter()
            .filter(|p| p.free)
            .map(|p| p.prior_sigma)
            .collect();
        let priors = moving.iter().map(|&c| priors.get(c).copied().unwrap_or(f64::INFINITY));
        (columns.select_columns(&moving), covariance, priors.collect())
    }

    /// Names of the free parameters, in the order of [`Self::covariance`].
    pub fn free_names(&self) -> Vec<&str> {
        self.parameters
            .iter()
            .filter(|p| p.free)
            .map(|p| p.name.as_str())
            .collect()
    }

    /// How the TCP depends on the free parameters at joint angles `q` (3 rows, axes of
    /// F0), and where the arm stands.
    pub(crate) fn workspace_rows(&self, q: &[f64]) -> (DMatrix<f64>, crate::diagnosis::linear::Posture) {
        let inner = &self.inner;
        let load = inner.nominal.load(q, None);
        let k = inner.state.evaluate(&pad(q), &load);
        let r = DMatrix::from_iterator(3, 3, self.base.rotation.transpose().iter().copied());
        let columns: DMatrix<f64> = r * self.prediction_columns(q, false);
        (
            columns.select_columns(&inner.columns),
            crate::diagnosis::linear::Posture::new(&inner.layout, &k, q, &load),
        )
    }

    /// Correlation matrix of the free parameters.
    pub fn correlation(&self) -> DMatrix<f64> {
        let c = &self.covariance;
        DMatrix::from_fn(c.nrows(), c.ncols(), |i, j| c[(i, j)] / (c[(i, i)] * c[(j, j)]).sqrt())
    }
}

fn pad(q: &[f64]) -> [f64; N] {
    let mut padded = [0.0; N];
    for (slot, angle) in padded.iter_mut().zip(q) {
        *slot = *angle;
    }
    padded
}

/// Writes the result of a fit.
pub(crate) fn finish(experiment: &Experiment, options: &Options, model: Model, fit: Fit) -> Calibration {
    let Fit {
        layout,
        table,
        start,
        state,
        nominal,
        ..
    } = &fit;
    let mut robot = experiment.robot.clone();
    for (joint, row) in robot.joints.iter_mut().zip(&state.rows) {
        joint.mdh = *row;
    }
    let mut tool = experiment.tool;
    tool.tcp_m = state.tcp.into();
    let mut sigma = vec![0.0; layout.len()];
    for (i, &column) in fit.unknowns.columns.iter().enumerate() {
        sigma[column] = fit.covariance[(i, i)].max(0.0).sqrt();
    }
    let parameters = table
        .iter()
        .zip(&sigma)
        .map(|(p, &sigma)| {
            let (nominal, estimate) = (start.get(p.kind), state.get(p.kind));
            ParameterEstimate {
                name: p.name.clone(),
                unit: p.unit,
                nominal,
                estimate,
                sigma,
                prior_sigma: p.prior_sigma,
                free: p.free,
                identified: p.free && sigma < 0.5 * p.prior_sigma,
                moved: p.free && (estimate - nominal).abs() > 1e-3 * p.prior_sigma.min(1e-3),
                reason: p.reason.to_owned(),
            }
        })
        .collect();
    let frames: Vec<FramePose> = layout
        .references
        .iter()
        .zip(&state.bases)
        .map(|(&reference, &base)| FramePose { reference, base })
        .collect();
    let spheres = experiment.spheres.iter().map(|sphere| {
        let mut sphere = *sphere;
        if let Some(at) = layout.spheres.iter().position(|id| *id == sphere.id) {
            for axis in 0..3 {
                sphere.position_m[axis] += state.spheres[at][axis];
            }
            let own = &sigma[layout.sphere(at)..layout.sphere(at) + 3];
            sphere.sigma_m = own.iter().copied().fold(0.0, f64::max);
        }
        sphere
    });
    let (residual, groups) = residuals(&fit);
    let (targets, orientation) = target_fits(&fit);
    let joint_noise = fit.whitening.joint * fit.scale.powi(2);
    Calibration {
        method: options.method,
        model,
        robot,
        tool,
        base: frames.first().map(|f| f.base).unwrap_or_default(),
        frames,
        compliance_rad_per_nm: state.compliance.clone(),
        harmonics_rad: state.harmonics.clone(),
        bending_rad_per_nm: state.bending.clone(),
        tilt_rad_per_nm: state.tilt,
        spheres: spheres.collect(),
        parameters,
        identifiability: fit.identifiability.clone(),
        residual,
        groups,
        targets,
        orientation,
        noise_scale: fit.scale,
        effective_parameters: fit.effective,
        log_evidence: fit.log_evidence,
        prior_factors: PriorFactors {
            stiffness: fit.choice.stiffness,
            harmonics: fit.choice.harmonics,
        },
        heavy_tails: fit.heavy_tails,
        harmonic_orders: fit.choice.orders.min(layout.orders),
        noise_inflation: fit.inflation,
        assumed_masses: nominal.assumed(),
        inner: Inner {
            layout: layout.clone(),
            state: state.clone(),
            nominal: nominal.clone(),
            columns: fit.unknowns.columns.clone(),
            joint_variance: joint_noise,
            measured_torque: map::measured(experiment, nominal, options.torque),
        },
        covariance: fit.covariance,
    }
}
