//! Whitening: the covariance of a residual and the inverse of its Cholesky factor.

use nalgebra::{Matrix3, Vector3};
use spherecal_model::input::MOST_TARGETS;

use crate::chain::Prepared;
use crate::hierarchy::constants::TOOL_NOISE;
use crate::options::Noise;
use crate::parts::Block;
use crate::seen::RowPart;

/// Most targets besides the TCP.
const FURTHER: usize = MOST_TARGETS - 1;
/// Prior standard deviation of a measured orientation about each axis, in rad: a camera's. The data
/// give the value that is used.
const BODY_SIGMA_RAD: f64 = 1e-3;

/// Standard deviations that whiten the residuals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Whitening {
    /// Variance of the joint noise, in rad².
    pub(crate) joint: f64,
    /// Variance of seating on a sphere, in m².
    pub(crate) seating: f64,
    /// Variance of a measured point, in m²: the TCP's; across the line of sight where that is known.
    pub(crate) point: f64,
    /// Variance of measured points of targets 2.., in m².
    pub(crate) further: [f64; FURTHER],
    /// Variance of each target along the line of sight, in m².
    pub(crate) along: [f64; MOST_TARGETS],
    /// Variance of a measured orientation, in rad².
    pub(crate) body: f64,
    /// Variance of shifts of the whole tool that no joint makes, in m², and of its turns about the leading target, in rad². A row with
    /// one target has them as noise of that target.
    pub(crate) tool: [f64; 2],
}

impl Whitening {
    /// Leaves every vector as it is.
    pub(crate) const NONE: Self = Self {
        joint: 0.0,
        seating: 1.0,
        point: 1.0,
        further: [1.0; FURTHER],
        along: [1.0; MOST_TARGETS],
        body: 1.0,
        tool: [0.0; 2],
    };

    /// As the options say, all targets alike.
    pub(crate) fn new(noise: &Noise) -> Self {
        let point = noise.point_m.powi(2);
        Self {
            joint: noise.joint_rad.powi(2),
            seating: noise.seating_m.powi(2),
            point,
            further: [point; FURTHER],
            along: [point; MOST_TARGETS],
            body: BODY_SIGMA_RAD.powi(2),
            tool: if noise.estimate {
                TOOL_NOISE.map(|sigma| sigma * sigma)
            } else {
                [0.0; 2]
            },
        }
    }

    /// The columns of all that the parts of a row share, in units of the joint noise; `arm`: see [`Block::arm`](crate::parts::Block).
    pub(crate) fn shared(&self, joints: &[Vector3<f64>], arm: Option<Vector3<f64>>) -> Vec<Vector3<f64>> {
        let mut all = joints.to_vec();
        if let Some(arm) = arm.filter(|_| self.joint > 0.0) {
            let [shift, turn] = self.tool.map(|variance| (variance / self.joint).sqrt());
            for e in [Vector3::x(), Vector3::y(), Vector3::z()] {
                all.extend([e * shift, e.cross(&arm) * turn]);
            }
        }
        all
    }

    /// Every standard deviation times a factor.
    pub(crate) fn times(&self, factor: f64) -> Self {
        let square = factor * factor;
        Self {
            joint: self.joint * square,
            seating: self.seating * square,
            point: self.point * square,
            further: self.further.map(|variance| variance * square),
            along: self.along.map(|variance| variance * square),
            body: self.body * square,
            tool: self.tool.map(|variance| variance * square),
        }
    }

    /// A part's own noise, seen along `sight` (see [`Own::sight`]).
    pub(crate) fn own(&self, part: RowPart, sight: Vector3<f64>) -> Own {
        match part {
            RowPart::Target(number) => {
                let further = number.checked_sub(1).and_then(|k| self.further.get(k));
                Own {
                    across: further.copied().unwrap_or(self.point),
                    along: self.along.get(number).copied().unwrap_or(self.point),
                    sight,
                }
            }
            RowPart::Body => Own::alike(self.body),
        }
    }

    /// The same of the part that leads a row.
    #[inline]
    pub(crate) fn leading(&self, observation: &Prepared, sight: Vector3<f64>) -> Own {
        match observation.sphere {
            Some(_) => Own::alike(self.seating),
            None => self.own(observation.leading(), sight),
        }
    }

    /// `C` at a pose, in m².
    #[inline]
    pub(crate) fn covariance(&self, joints: &[Vector3<f64>], own: &Own) -> Matrix3<f64> {
        let (mut xx, mut yy, mut zz, mut xy, mut xz, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for j in joints {
            xx += j.x * j.x;
            yy += j.y * j.y;
            zz += j.z * j.z;
            xy += j.x * j.y;
            xz += j.x * j.z;
            yz += j.y * j.z;
        }
        let v = self.joint;
        let floor = own.across;
        let joints = Matrix3::new(
            v * xx + floor,
            v * xy,
            v * xz,
            v * xy,
            v * yy + floor,
            v * yz,
            v * xz,
            v * yz,
            v * zz + floor,
        );
        if own.sight == Vector3::zeros() {
            joints
        } else {
            joints + own.sight * own.sight.transpose() * (own.along - own.across)
        }
    }
}

/// The own noise of a part of a row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Own {
    /// Variance across the line of sight, in m² or rad².
    pub(crate) across: f64,
    /// Variance along it.
    pub(crate) along: f64,
    /// The line of sight in F0, of length 1; zero where the noise is alike in all directions.
    pub(crate) sight: Vector3<f64>,
}

impl Own {
    /// Noise of this variance in all directions.
    pub(crate) fn alike(variance: f64) -> Self {
        Self {
            across: variance,
            along: variance,
            sight: Vector3::zeros(),
        }
    }

    /// Mean of the variances of the three axes.
    pub(crate) fn mean(&self) -> f64 {
        self.across + (self.along - self.across) / 3.0 * self.sight.norm_squared()
    }
}

/// Whitens a part of a row given the parts before it: one step of the block Cholesky factor of the
/// row's covariance,
///
/// `w_k = L_kk⁻¹ (r_k − Σ_{j<k} L_kj w_j)`, `L_kj = σ_q² J_k J̃_jᵀ`
///
/// where `J̃_j` are the whitened columns of what the parts of a row share ([`Whitening::shared`]).
#[derive(Clone, Debug)]
pub(crate) struct Conditional {
    /// `L_kk⁻¹`.
    pub(crate) root: Root,
    /// `L_kj` by earlier part.
    pub(crate) factors: Vec<Matrix3<f64>>,
}

impl Conditional {
    /// For a part with shared columns `joints` and own noise `own`; `before` are the whitened shared columns of the earlier
    /// parts.
    pub(crate) fn new<'b>(
        whitening: &Whitening,
        own: &Own,
        joints: &[Vector3<f64>],
        before: impl Iterator<Item = &'b [Vector3<f64>]>,
    ) -> Self {
        let mut rest = whitening.covariance(joints, own);
        let factor = |before: &[Vector3<f64>]| {
            let pairs = joints.iter().zip(before);
            pairs
                .map(|(own, earlier)| own * earlier.transpose())
                .sum::<Matrix3<f64>>()
                * whitening.joint
        };
        let factors: Vec<Matrix3<f64>> = before.map(factor).collect();
        for factor in &factors {
            rest -= factor * factor.transpose();
        }
        Self {
            root: Root::new(&rest),
            factors,
        }
    }

    /// `w_k` of a column, from its own three numbers and the whitened ones of the earlier parts.
    pub(crate) fn times(&self, v: &Vector3<f64>, before: impl Iterator<Item = Vector3<f64>>) -> Vector3<f64> {
        let known: Vector3<f64> = self.factors.iter().zip(before).map(|(factor, w)| factor * w).sum();
        self.root.times(&(v - known))
    }

    /// `ln |L_kk⁻¹|`.
    pub(crate) fn log_determinant(&self) -> f64 {
        self.root.log_determinant()
    }
}

impl Whitening {
    /// Squared whitened residual of the further parts of a row, and the sum of their `ln |L⁻¹|`;
    /// `shared` and `residual` are those of the leading part, whitened.
    pub(crate) fn further_parts(
        &self,
        n: usize,
        shared: Vec<Vector3<f64>>,
        residual: Vector3<f64>,
        further: &[Block],
    ) -> (f64, f64) {
        let mut before = vec![(shared, residual)];
        let (mut d2, mut log) = (0.0, 0.0);
        for block in further {
            let own = self.own(block.part, block.sight);
            let mut shared = self.shared(&block.joints[..n], block.arm);
            let given = Conditional::new(self, &own, &shared, before.iter().map(|b| &b.0[..]));
            for (c, column) in shared.iter_mut().enumerate() {
                *column = given.times(column, before.iter().map(|b| b.0[c]));
            }
            let residual = given.times(&block.residual, before.iter().map(|b| b.1));
            d2 += residual.norm_squared();
            log += given.log_determinant();
            before.push((shared, residual));
        }
        (d2, log)
    }
}

/// `L⁻¹` of a 3 x 3 covariance, as its six numbers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Root([f64; 6]);

impl Root {
    #[inline]
    pub(crate) fn new(c: &Matrix3<f64>) -> Self {
        let a = 1.0 / c[(0, 0)].sqrt();
        let (l10, l20) = (c[(1, 0)] * a, c[(2, 0)] * a);
        let b = 1.0 / (c[(1, 1)] - l10 * l10).max(1e-30).sqrt();
        let l21 = (c[(2, 1)] - l20 * l10) * b;
        let d = 1.0 / (c[(2, 2)] - l20 * l20 - l21 * l21).max(1e-30).sqrt();
        Self([a, b, d, -l10 * a * b, (l10 * b * l21 - l20) * a * d, -l21 * b * d])
    }

    /// The same times a factor.
    #[inline]
    pub(crate) fn scaled(self, factor: f64) -> Self {
        Self(self.0.map(|x| x * factor))
    }

    /// `L`, 3 x 3 lower triangular.
    pub(crate) fn inverse(&self) -> Matrix3<f64> {
        let [a, b, d, ba, da, db] = self.0;
        let (x, y, z) = (1.0 / a, 1.0 / b, 1.0 / d);
        let yx = -ba * x * y;
        let zy = -db * y * z;
        let zx = -(da * x + db * yx) * z;
        Matrix3::new(x, 0.0, 0.0, yx, y, 0.0, zx, zy, z)
    }

    /// `ln |L⁻¹|`.
    pub(crate) fn log_determinant(&self) -> f64 {
        let [a, b, d, ..] = self.0;
        (a * b * d).ln()
    }

    #[inline]
    pub(crate) fn times(&self, v: &Vector3<f64>) -> Vector3<f64> {
        let [a, b, d, ba, da, db] = self.0;
        Vector3::new(a * v.x, ba * v.x + b * v.y, da * v.x + db * v.y + d * v.z)
    }
}
