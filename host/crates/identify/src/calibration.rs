//! The result: a calibrated robot with everything that is known about its errors.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, Matrix3, Vector3};
use serde::Serialize;
use spherecal_shared::robot::{Robot, Tool};

use super::chain::{N, OWN, State};
use super::hierarchy::cross::CrossEffects;
use super::hierarchy::open::OpenSizes;
use super::hierarchy::sizes::Strangeness;
use super::hierarchy::{Displacements, Ends, LeftOut};
use super::identifiability::Identifiability;
use super::load::Nominal;
use super::options::{Method, Model};
use super::parameters::{Kind, Layout, Override, Overrides, Unit};
use super::residuals::{GroupFit, Residual};
use super::target_fit::{OrientationFit, TargetFit};
use super::targets::Reference;
use spherecal_model::{Pose, Sphere};

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

/// Noise that the data have, each 1 sigma.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct NoiseFound {
    /// Error of each joint angle that the model does not describe, in rad.
    pub joint_rad: f64,
    /// Seating of the nest on a sphere, each axis, in m.
    pub seating_m: f64,
    /// A measured point, each axis, in m.
    pub point_m: f64,
    /// Degrees of freedom of Student's t; 0 for normal noise.
    pub student_t: f64,
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
    /// Noise found.
    pub noise: NoiseFound,
    /// Parameters that the data determine, out of those free.
    pub effective_parameters: f64,
    /// Natural logarithm of the model's evidence; compares models on the same data.
    pub log_evidence: f64,
    /// Whether the robot's description has no masses, so that assumed ones gave
    /// the load its shape (and compliance is relative to them).
    pub assumed_masses: bool,
    /// How far the sizes of lengths and twists are from ordinary ones.
    #[serde(skip)]
    pub(crate) strangeness: Strangeness,
    /// How well the sizes of the groups of parameters are known.
    #[serde(skip)]
    pub(crate) open: OpenSizes,
    /// Errors of joints by the angles of others, which the model does not hold, with the unknowns.
    #[serde(skip)]
    pub(crate) cross: CrossEffects,
    /// How far named causes in the cell displace the observations.
    #[serde(skip)]
    pub(crate) displaced: Displacements,
    /// Some observations, left out of their own prediction, by their index.
    #[serde(skip)]
    pub(crate) left_out: BTreeMap<usize, LeftOut>,
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
    pub(crate) layout: Layout,
    pub(crate) state: State,
    pub(crate) nominal: Nominal,
    pub(crate) columns: Vec<usize>,
    /// Variance of the joint noise that stays in every pose, in rad².
    pub(crate) joint_variance: f64,
    /// Variance of shifts of the tool that no joint makes, in m²; 0 where no row has several targets.
    pub(crate) shift_variance: f64,
    /// Where the search ended.
    pub(crate) ends: Ends,
    /// Whether the fit took the joints' torques from the data.
    pub(crate) measured_torque: bool,
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
    /// the first reference frame: all parameters with their correlations, what the sizes of their
    /// groups leave open, and the joint noise of a single pose. Errors outside of the model are not in it.
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
        let joints: Vec<Vector3<f64>> = (0..inner.layout.n)
            .map(|j| columns.fixed_view::<3, 1>(0, inner.layout.joint(j)).into())
            .collect();
        let free = inner.columns.len();
        let mut picked = DMatrix::zeros(self.cross.mean.len(), 3);
        picked
            .rows_mut(0, free)
            .copy_from(&columns.select_columns(&inner.columns).transpose());
        if picked.nrows() > free {
            let cross = self.cross.at(q, &joints).transpose();
            picked.rows_mut(free, cross.nrows()).copy_from(&cross);
        }
        let mean: Vector3<f64> = picked.tr_mul(&self.cross.mean).fixed_rows::<3>(0).into();
        let mut covariance = mean * mean.transpose();
        // Matrix by vector: nalgebra's product with three rows is ten times slower.
        for (at, column) in picked.column_iter().enumerate() {
            let along = &self.cross.covariance * column;
            let mut own = covariance.column_mut(at);
            own += picked.tr_mul(&along);
        }
        for column in joints {
            covariance += column * column.transpose() * inner.joint_variance;
        }
        covariance += Matrix3::from_diagonal_element(inner.shift_variance);
        covariance += self
            .open
            .covariance(&picked.rows(0, free).into_owned())
            .fixed_view::<3, 3>(0, 0);
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

    /// How the TCP depends on the free parameters at joint angles `q`, and on the joints' errors (3 x free, axes of F0). With
    /// a frame and a sphere, the prediction is that of a measurement there.
    pub(crate) fn columns_at(
        &self,
        q: &[f64],
        seen: Option<(Reference, Option<u32>)>,
    ) -> (DMatrix<f64>, Vec<Vector3<f64>>) {
        let (layout, state) = (&self.inner.layout, &self.inner.state);
        let turn = self.base.rotation.transpose();
        let mut all = self.prediction_columns(q, false);
        for mut column in all.column_iter_mut() {
            let turned = turn * Vector3::new(column[0], column[1], column[2]);
            column.copy_from(&turned);
        }
        let joint = |j: usize| all.fixed_view::<3, 1>(0, layout.joint(j)).into();
        let joints = (0..layout.n).map(joint).collect();
        if let Some((reference, sphere)) = seen
            && let Some(at) = layout.references.iter().position(|r| *r == reference)
        {
            let base = &state.bases[at];
            let tcp = base.rotation * self.tcp_m(q, None);
            for axis in 0..3 {
                let e: Vector3<f64> = Vector3::ith(axis, 1.0);
                let shift = base.rotation.tr_mul(&e);
                all.fixed_view_mut::<3, 1>(0, layout.base(at) + axis).copy_from(&shift);
                let turned = base.rotation.tr_mul(&e.cross(&tcp));
                all.fixed_view_mut::<3, 1>(0, layout.base(at) + 3 + axis)
                    .copy_from(&turned);
                if let Some(s) = sphere.and_then(|id| layout.spheres.iter().position(|own| *own == id)) {
                    all.fixed_view_mut::<3, 1>(0, layout.sphere(s) + axis)
                        .copy_from(&-shift);
                }
            }
        }
        (all.select_columns(&self.inner.columns), joints)
    }

    /// The priors of links and tool with the sizes that the fit found.
    pub(crate) fn geometric_priors(&self) -> Overrides {
        let geometric = |kind: &Kind| {
            matches!(
                kind,
                Kind::Alpha(_) | Kind::A(_) | Kind::Beta(_) | Kind::D(_) | Kind::Theta(_) | Kind::Tool(_)
            )
        };
        let own = self.inner.layout.kinds().into_iter().zip(&self.parameters);
        let found = own.filter(|(kind, _)| geometric(kind)).map(|(_, p)| {
            let set = Override {
                prior_sigma: p.free.then_some(p.prior_sigma),
                free: Some(p.free),
                ..Override::default()
            };
            (p.name.clone(), set)
        });
        // A file has no instrument whose scale could be wrong.
        let scale = Override {
            free: Some(false),
            ..Override::default()
        };
        Overrides(found.chain([("scale".to_owned(), scale)]).collect())
    }

    /// Names of the free parameters, in the order of [`Self::covariance`].
    pub fn free_names(&self) -> Vec<&str> {
        self.parameters
            .iter()
            .filter(|p| p.free)
            .map(|p| p.name.as_str())
            .collect()
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
