//! Arrays in and out.

use nalgebra::{DMatrix, Matrix3, Vector3};
use numpy::{PyArray2, PyArray3, PyArrayMethods as _, PyReadonlyArray2, PyUntypedArrayMethods as _};
use pyo3::prelude::*;
use spherecal_shared::robot::Pose;

use crate::error::Failure;

/// Rows of a C-contiguous array of two dimensions, and their width.
#[derive(Debug)]
pub(crate) struct Rows {
    /// All values, row by row.
    pub(crate) values: Vec<f64>,
    /// Values of a row.
    pub(crate) width: usize,
}

impl Rows {
    /// Copies an array, so that Python may change it meanwhile.
    pub(crate) fn of(field: &str, array: &PyReadonlyArray2<'_, f64>) -> PyResult<Self> {
        let width = array.shape().get(1).copied().unwrap_or_default();
        let values = array.as_slice().map_err(|_| {
            PyErr::from(Failure::input(
                field,
                "not contiguous",
                "give numpy.ascontiguousarray of it",
            ))
        })?;
        Ok(Self {
            values: values.to_vec(),
            width,
        })
    }

    /// Rows of joint angles (rad) of a robot with `joints` joints.
    pub(crate) fn joints(array: &PyReadonlyArray2<'_, f64>, joints: usize) -> PyResult<Self> {
        let rows = Self::of("q", array)?;
        if rows.width != joints {
            let shape = format!("an array of shape {:?}", array.shape());
            let remedy = format!("the robot has {joints} joints: give shape (N, {joints}), in rad");
            return Err(Failure::input("q", shape, &remedy).into());
        }
        if let Some(at) = rows.values.iter().position(|v| !v.is_finite()) {
            let field = format!("q[{}, {}]", at / joints, at % joints);
            return Err(Failure::input(&field, rows.values[at], "give finite numbers").into());
        }
        Ok(rows)
    }

    /// The rows in order.
    pub(crate) fn rows(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        self.values.chunks_exact(self.width.max(1))
    }
}

/// An array of `values`, row by row.
pub(crate) fn matrix(py: Python<'_>, width: usize, values: Vec<f64>) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let rows = values.len() / width.max(1);
    numpy::PyArray1::from_vec(py, values).reshape([rows, width])
}

/// An array of matrices, each row by row.
pub(crate) fn matrices(
    py: Python<'_>,
    [height, width]: [usize; 2],
    values: Vec<f64>,
) -> PyResult<Bound<'_, PyArray3<f64>>> {
    let count = values.len() / (height * width).max(1);
    numpy::PyArray1::from_vec(py, values).reshape([count, height, width])
}

/// A matrix as an array.
pub(crate) fn of_matrix<'py>(py: Python<'py>, m: &DMatrix<f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
    matrix(py, m.ncols(), m.transpose().as_slice().to_vec())
}

/// A pose as the sixteen values of a homogeneous matrix, row by row.
pub(crate) fn homogeneous(pose: &Pose<f64>) -> [f64; 16] {
    let (r, p) = (&pose.rotation, &pose.position);
    [
        r[(0, 0)],
        r[(0, 1)],
        r[(0, 2)],
        p.x,
        r[(1, 0)],
        r[(1, 1)],
        r[(1, 2)],
        p.y,
        r[(2, 0)],
        r[(2, 1)],
        r[(2, 2)],
        p.z,
        0.0,
        0.0,
        0.0,
        1.0,
    ]
}

/// Largest deviation of a rotation matrix from orthogonality.
const ORTHOGONAL: f64 = 1e-6;

/// The pose of a homogeneous matrix.
/// Errors: a shape, a last row or a rotation that is none.
pub(crate) fn pose(array: &PyReadonlyArray2<'_, f64>) -> PyResult<Pose<f64>> {
    let refuse = |value: &str, remedy: &str| Err(Failure::input("pose", value, remedy).into());
    let shape = array.shape();
    if shape != [4, 4] {
        return refuse(
            &format!("an array of shape {shape:?}"),
            "give a homogeneous matrix of shape (4, 4), position in m",
        );
    }
    let rows = Rows::of("pose", array)?.values;
    if rows.iter().any(|v| !v.is_finite()) {
        return refuse("not finite", "give finite numbers");
    }
    let rotation = Matrix3::from_fn(|i, j| rows[4 * i + j]);
    if rows[12..] != [0.0, 0.0, 0.0, 1.0] {
        return refuse(
            "a matrix with another last row than 0, 0, 0, 1",
            "give a homogeneous matrix",
        );
    }
    let off = (rotation.transpose() * rotation - Matrix3::identity()).amax();
    if off > ORTHOGONAL || rotation.determinant() < 0.0 {
        return refuse(
            &format!("a matrix whose rotation is {off:.1e} off"),
            "give a right-handed rotation matrix, orthogonal within 1e-6",
        );
    }
    Ok(Pose {
        rotation,
        position: Vector3::new(rows[3], rows[7], rows[11]),
    })
}
