//! The parts of a row: the positions of several targets on the tool, and the orientation of a
//! measured body.
//!
//! A row's *leading* part is the first target that was seen; [`State::at`](super::chain::State::at)
//! gives its position. The other parts of the row are [`Seen`]. Each part has three residuals: in m
//! for a target, in rad (a rotation vector) for the body, both in the axes of F0.

use nalgebra::{DMatrix, Matrix3, Rotation3, Vector3};

use super::chain::{Kinematics, N, Prepared, State, bend};
use super::load::HoldingMoments;
use super::parameters::Layout;
use super::seen::{RowPart, Seen};

/// One part of a row at a state: how the joints move it, and its residual, in the axes of F0.
#[derive(Clone, Debug)]
pub(crate) struct Block {
    pub(crate) part: RowPart,
    /// Columns of the joint angles.
    pub(crate) joints: [Vector3<f64>; N],
    /// Where the target is, seen from the leading one, in m; none of an orientation, and of a row with one target.
    pub(crate) arm: Option<Vector3<f64>>,
    /// Model minus measurement.
    pub(crate) residual: Vector3<f64>,
    /// Line of sight: see [`Own::sight`](crate::normal::Own::sight).
    pub(crate) sight: Vector3<f64>,
}

/// How shifts and turns of the tool about its leading target move the parts of a row (3K x 3 each); `None` of one target.
pub(crate) fn tool_columns(parts: &[Block]) -> Option<[DMatrix<f64>; 2]> {
    let columns = |of: fn(Vector3<f64>, Vector3<f64>) -> Vector3<f64>| {
        let value = |r: usize, axis| parts[r / 3].arm.map(|arm| of(Vector3::ith(axis, 1.0), arm)[r % 3]);
        DMatrix::from_fn(3 * parts.len(), 3, |r, c| value(r, c).unwrap_or_default())
    };
    let several = parts.iter().any(|part| part.arm.is_some());
    several.then(|| [columns(|e, _| e), columns(|e, arm| e.cross(&arm))])
}

impl Layout {
    /// Moves the columns of the tool to those of the target that leads a row.
    #[inline]
    pub(crate) fn lead(&self, number: usize, general: &mut [Vector3<f64>]) {
        if number > 0 {
            let tool = 3 * self.n;
            for axis in 0..3 {
                general[self.target(number - 1) + axis] = general[tool + axis];
                general[tool + axis] = Vector3::zeros();
            }
        }
    }
}

impl State {
    /// Where target `number` (from 0: the TCP) is in the flange frame, in m.
    #[inline]
    pub(crate) fn place(&self, number: usize) -> Vector3<f64> {
        match number.checked_sub(1) {
            None => self.tcp,
            Some(further) => self.targets.get(further).copied().unwrap_or(self.tcp),
        }
    }

    /// Position of target `number` in F0, in m.
    pub(crate) fn target_at(&self, q: &[f64; N], load: &HoldingMoments, number: usize) -> Vector3<f64> {
        let k = self.evaluate(q, load);
        self.moved(&k, load, number).tcp
    }

    /// The same kinematics with the position of another target.
    pub(crate) fn moved(&self, k: &Kinematics, load: &HoldingMoments, number: usize) -> Kinematics {
        let flange = self.rows.len().checked_sub(1).and_then(|last| k.frames.get(last));
        let flange = flange.copied().unwrap_or_default();
        Kinematics {
            tcp: self.tip(&k.frames, &flange, load, &self.place(number)),
            ..*k
        }
    }

    /// Orientation of the measured body in F0, with bending and tilt.
    pub(crate) fn body_at(&self, k: &Kinematics, load: &HoldingMoments) -> Matrix3<f64> {
        let flange = self.rows.len().checked_sub(1).and_then(|last| k.frames.get(last));
        let mut turn = Vector3::new(-self.tilt[0] * load.base[0], -self.tilt[1] * load.base[1], 0.0);
        for (j, [x, y]) in self.bending.iter().enumerate().take(N) {
            turn += bend(&k.frames[j], &load.joint[j], *x, *y);
        }
        Rotation3::new(turn).into_inner() * flange.copied().unwrap_or_default().rotation * self.body
    }

    /// Residual of a part in F0, and the columns of the general block and of the joints as
    /// [`State::columns`] gives them for the leading target; `k` is the row's kinematics.
    /// `general` must be zero before.
    pub(crate) fn part_columns(
        &self,
        layout: &Layout,
        observation: &Prepared,
        k: &Kinematics,
        seen: &Seen,
        general: &mut [Vector3<f64>],
        joints: &mut [Vector3<f64>],
    ) -> (Vector3<f64>, Vector3<f64>) {
        let load = &observation.load;
        match *seen {
            Seen::Target { number, at } => {
                let k = self.moved(k, load, number);
                self.columns(layout, &k, load, general, joints);
                layout.lead(number, general);
                general[layout.scale()] = self.scale_column(observation.reference, &at);
                let arm = k.tcp - self.pivot(observation.reference);
                (self.off(observation, &k, &at), arm)
            }
            Seen::Body(measured) => {
                self.body_columns(layout, k, load, general, joints);
                (self.turned_off(observation, k, &measured), Vector3::zeros())
            }
        }
    }

    fn off(&self, observation: &Prepared, k: &Kinematics, at: &Vector3<f64>) -> Vector3<f64> {
        k.tcp - self.true_place(observation.reference, at)
    }

    /// Line of sight of the instrument to a target (m, reference frame), in F0: from the origin of its frame. Zero where the
    /// rows have none.
    #[inline]
    pub(crate) fn sight(&self, observation: &Prepared, at: &Vector3<f64>) -> Vector3<f64> {
        match self.bases.get(observation.reference) {
            Some(base) if observation.sighted => base.rotation.tr_mul(&at.try_normalize(0.0).unwrap_or_default()),
            _ => Vector3::zeros(),
        }
    }

    fn turned_off(&self, observation: &Prepared, k: &Kinematics, measured: &Matrix3<f64>) -> Vector3<f64> {
        let base = self
            .bases
            .get(observation.reference)
            .map_or_else(Matrix3::identity, |base| base.rotation);
        rotation_vector(&(self.body_at(k, &observation.load) * measured.transpose() * base))
    }

    /// Rotation vectors, in F0, by which a unit of each parameter turns the measured body.
    fn body_columns(
        &self,
        layout: &Layout,
        k: &Kinematics,
        load: &HoldingMoments,
        general: &mut [Vector3<f64>],
        joints: &mut [Vector3<f64>],
    ) {
        let n = layout.n;
        let mut parent = Matrix3::identity();
        for i in 0..n {
            let frame = &k.frames[i];
            general[3 * i] = parent.column(0).into();
            if layout.hayati[i] {
                let (sine, cosine) = self.rows[i].alpha.sin_cos();
                general[3 * i + 2] = parent.column(1) * cosine + parent.column(2) * sine;
            }
            joints[i] = frame.z();
            parent = frame.rotation;
        }
        if layout.stiffness {
            for i in 0..n {
                let at = layout.bending(i);
                general[at] = bend(&k.frames[i], &load.joint[i], 1.0, 0.0);
                general[at + 1] = bend(&k.frames[i], &load.joint[i], 0.0, 1.0);
            }
            let at = layout.tilt();
            general[at] = Vector3::x() * -load.base[0];
            general[at + 1] = Vector3::y() * -load.base[1];
        }
        if let Some(at) = layout.body() {
            for axis in 0..3 {
                general[at + axis] = parent.column(axis).into();
            }
        }
    }

    /// All parts of a row but the leading one, without the columns that only the equations need.
    pub(crate) fn further(&self, n: usize, observation: &Prepared, k: &Kinematics) -> Vec<Block> {
        let block = |seen: &Seen| {
            let mut joints = [Vector3::zeros(); N];
            let (arm, residual, sight) = match *seen {
                Seen::Target { number, at } => {
                    let leading = k.tcp;
                    let k = self.moved(k, &observation.load, number);
                    for (column, frame) in joints.iter_mut().zip(&k.frames[..n]) {
                        *column = frame.z().cross(&(k.tcp - frame.position));
                    }
                    let arm = Some(k.tcp - leading);
                    (arm, self.off(observation, &k, &at), self.sight(observation, &at))
                }
                Seen::Body(measured) => {
                    for (column, frame) in joints.iter_mut().zip(&k.frames[..n]) {
                        *column = frame.z();
                    }
                    (None, self.turned_off(observation, k, &measured), Vector3::zeros())
                }
            };
            Block {
                part: seen.part(),
                joints,
                arm,
                residual,
                sight,
            }
        };
        observation.further.iter().map(block).collect()
    }

    /// All parts of a row.
    pub(crate) fn blocks(&self, n: usize, observation: &Prepared) -> Vec<Block> {
        let k = self.at(observation);
        let mut joints = [Vector3::zeros(); N];
        for (column, frame) in joints.iter_mut().zip(&k.frames[..n]) {
            *column = frame.z().cross(&(k.tcp - frame.position));
        }
        let leading = Block {
            part: observation.leading(),
            joints,
            arm: observation.has_several().then(Vector3::zeros),
            residual: self.residual(observation, &k.tcp),
            sight: self.sight(observation, &observation.target),
        };
        std::iter::once(leading)
            .chain(self.further(n, observation, &k))
            .collect()
    }
}

/// Rotation vector of a rotation matrix, in rad. Exact for small angles, where an arc cosine is not.
pub(crate) fn rotation_vector(rotation: &Matrix3<f64>) -> Vector3<f64> {
    let skew = (rotation - rotation.transpose()) * 0.5;
    let axis = Vector3::new(skew[(2, 1)], skew[(0, 2)], skew[(1, 0)]);
    let (sine, cosine) = (axis.norm(), 0.5 * (rotation.trace() - 1.0));
    let angle = sine.atan2(cosine);
    if sine > 1e-9 {
        axis * (angle / sine)
    } else if cosine > 0.0 {
        axis
    } else {
        // Half a turn: its axis does not matter where only the size is looked at.
        Vector3::x() * angle
    }
}
