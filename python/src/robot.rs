//! A robot: forward kinematics, Jacobian, inverse kinematics, text.

use nalgebra::{Rotation3, Vector3};
use numpy::{PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use spherecal_model::chain::{Chain, TcpPose, wrapped};
use spherecal_model::robots::frames::{compose, inverse};
use spherecal_model::robots::{self, JointPath, RobotModel, table_frames, toml_file, write_urdf};
use spherecal_shared::robot::Pose;

use crate::arrays::{Rows, homogeneous, matrices, matrix, pose};
use crate::error::{Failure, guarded};

/// A robot with its tool and the frames of its file.
#[pyclass(frozen, module = "spherecal._native")]
#[derive(Clone)]
pub(crate) struct NativeRobot {
    pub(crate) model: RobotModel,
    /// Its joints, where some of them slide or follow others.
    pub(crate) path: Option<JointPath>,
}

/// The TCP's frame in the root frame.
pub(crate) fn tcp_frame(model: &RobotModel, q: &[f64]) -> Pose<f64> {
    let flange = model.flange_at(q);
    Pose {
        position: flange.point(&model.tool.tcp()),
        rotation: flange.rotation,
    }
}

/// The chain of a model, with its tool.
/// Errors: robots that cannot take an orientation.
pub(crate) fn chain(model: &RobotModel) -> Result<Chain, Failure> {
    Chain::new(&model.robot, &model.tool_in_table())
        .map_err(|e| Failure::input("robot", &model.robot.name, &e.to_string()))
}

impl NativeRobot {
    /// A pose of the TCP in the root frame, as the chain of the table takes it.
    fn in_table(&self, at: &Pose<f64>) -> TcpPose {
        let base = inverse(&self.model.base);
        TcpPose {
            position: base.point(&at.position),
            rotation: Rotation3::from_matrix_unchecked(
                base.rotation * at.rotation * self.model.flange.rotation.transpose(),
            ),
            elbow: None,
        }
    }

    /// A robot of any chain.
    pub(crate) fn of(model: RobotModel) -> Result<Self, Failure> {
        let path = model.joint_path()?;
        let path = path.odd_joint().is_some().then_some(path);
        Ok(Self { model, path })
    }

    /// Number of the joints that are measured.
    pub(crate) fn dof(&self) -> usize {
        self.path
            .as_ref()
            .map_or(self.model.robot.dof(), |path| path.columns.len())
    }

    /// Refuses a chain with joints that slide or follow others, which inverse kinematics and compensation do not know.
    pub(crate) fn hinges_alone(&self) -> Result<(), Failure> {
        match self.path {
            Some(_) => Ok(self.model.clone().plain().map(|_| ())?),
            None => Ok(()),
        }
    }

    /// The TCP's frame in the root frame.
    fn tcp_frame(&self, q: &[f64]) -> Pose<f64> {
        let Some(path) = &self.path else {
            return tcp_frame(&self.model, q);
        };
        let flange = path.frames(&path.positions(q)).tip;
        Pose {
            position: flange.point(&self.model.tool.tcp()),
            rotation: flange.rotation,
        }
    }

    /// The Jacobian of the TCP in the root frame, row by row.
    fn jacobian_at(&self, q: &[f64]) -> Vec<f64> {
        let n = self.dof();
        let tcp = self.tcp_frame(q).position;
        let mut jacobian = vec![0.0; 6 * n];
        let mut add = |column: usize, linear: &Vector3<f64>, angular: &Vector3<f64>| {
            for k in 0..3 {
                jacobian[k * n + column] += linear[k];
                jacobian[(k + 3) * n + column] += angular[k];
            }
        };
        if let Some(path) = &self.path {
            let frames = path.frames(&path.positions(q));
            for (k, joint) in path.joints.iter().enumerate() {
                let twist = path.joint_column(&frames, k, &tcp);
                for &(column, factor) in &joint.terms {
                    add(column, &(twist.linear * factor), &(twist.angular * factor));
                }
            }
        } else {
            for (i, frame) in table_frames(&self.model.rows(), q).iter().enumerate() {
                let frame = compose(&self.model.base, frame);
                let z = frame.z();
                add(i, &z.cross(&(tcp - frame.position)), &z);
            }
        }
        jacobian
    }
}

#[pymethods]
impl NativeRobot {
    /// A built-in name, or a file.
    #[staticmethod]
    fn load(py: Python<'_>, spec: String) -> PyResult<Self> {
        guarded(py, || Self::of(robots::load_path(&spec)?))
    }

    /// TOML text.
    #[staticmethod]
    fn from_toml(py: Python<'_>, text: String) -> PyResult<Self> {
        guarded(py, || Self::of(toml_file::load("toml text", &text)?))
    }

    /// URDF text; `tip` is the last link, or the end of the longest chain.
    #[staticmethod]
    fn from_urdf(py: Python<'_>, text: String, tip: Option<String>) -> PyResult<Self> {
        guarded(py, || {
            Self::of(robots::load_urdf_text_path("urdf text", &text, tip.as_deref())?)
        })
    }

    #[getter]
    fn name(&self) -> String {
        self.model.robot.name.to_string()
    }

    #[getter]
    fn joints(&self) -> usize {
        self.dof()
    }

    #[getter]
    fn joint_names(&self) -> Vec<String> {
        let columns = self.path.as_ref().map(|path| path.columns.clone());
        columns.unwrap_or_else(|| self.model.joint_names.clone())
    }

    #[getter]
    fn frame_names(&self) -> (String, String) {
        self.model.frame_names.clone()
    }

    /// TCP in the flange frame, in m.
    #[getter]
    fn tool(&self) -> [f64; 3] {
        self.model.tool.tcp_m
    }

    /// Joint limits: least and greatest position, in rad or m.
    #[getter]
    fn limits<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        if let Some(path) = &self.path {
            let ranges = self.model.column_ranges(path);
            return matrix(py, 2, ranges.into_iter().flat_map(|(low, high)| [low, high]).collect());
        }
        let joints = &self.model.robot.joints;
        matrix(
            py,
            2,
            joints
                .iter()
                .flat_map(|j| [j.limits.min_rad, j.limits.max_rad])
                .collect(),
        )
    }

    /// Rows of the modified DH table: alpha, a, beta, theta, d (rad, m).
    #[getter]
    fn mdh<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let rows = self.model.rows();
        matrix(
            py,
            5,
            rows.iter().flat_map(|r| [r.alpha, r.a, r.beta, r.theta, r.d]).collect(),
        )
    }

    /// The same robot with another TCP (m, flange frame).
    fn with_tool(&self, tcp_m: [f64; 3]) -> PyResult<Self> {
        let mut model = self.model.clone();
        model.tool.tcp_m = tcp_m;
        model
            .tool
            .check()
            .map_err(|e| Failure::input("tool", format!("{tcp_m:?}"), &e.to_string()))?;
        let path = self.path.clone();
        Ok(Self { model, path })
    }

    /// TCP frames in the root frame: N x 4 x 4.
    fn fk<'py>(&self, py: Python<'py>, q: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let rows = Rows::joints(&q, self.dof())?;
        let frames = guarded(py, || {
            Ok(rows.rows().flat_map(|q| homogeneous(&self.tcp_frame(q))).collect())
        })?;
        matrices(py, [4, 4], frames)
    }

    /// Jacobians of the TCP in the root frame: N x 6 x joints.
    fn jacobian<'py>(&self, py: Python<'py>, q: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let rows = Rows::joints(&q, self.dof())?;
        let n = self.dof();
        let values = guarded(py, || {
            let mut values = Vec::with_capacity(rows.values.len() * 6);
            for q in rows.rows() {
                values.extend(self.jacobian_at(q));
            }
            Ok(values)
        })?;
        matrices(py, [6, n], values)
    }

    /// Joint angles for a pose of the TCP: nearest to `near`, or to the middle of the limits.
    fn ik(
        &self,
        py: Python<'_>,
        target: PyReadonlyArray2<'_, f64>,
        near: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<Vec<f64>> {
        let at = self.in_table(&pose(&target)?);
        let near = match near {
            Some(near) => {
                let near = near.as_array().to_vec();
                if near.len() != self.dof() || near.iter().any(|v| !v.is_finite()) {
                    let remedy = format!("give {} finite angles in rad", self.dof());
                    return Err(Failure::input("near", format!("{near:?}"), &remedy).into());
                }
                Some(near)
            }
            None => None,
        };
        guarded(py, || {
            self.hinges_alone()?;
            let chain = chain(&self.model)?;
            if let Some(q) = near.as_ref().and_then(|near| chain.solve_from(&at, near)) {
                return Ok(q);
            }
            let middle = || chain.limits().iter().map(|l| 0.5 * (l.min_rad + l.max_rad)).collect();
            let wish = near.unwrap_or_else(middle);
            let far = |q: &[f64]| q.iter().zip(&wish).map(|(a, b)| wrapped(a - b).powi(2)).sum::<f64>();
            let all = chain.solve(&at);
            all.into_iter().min_by(|a, b| far(a).total_cmp(&far(b))).ok_or_else(|| {
                Failure::unreachable(format!(
                    "the TCP cannot be at ({:.4}, {:.4}, {:.4}) m in this orientation within the joint limits: move \
                     the pose into the workspace, or check tool and units (m)",
                    at.position.x, at.position.y, at.position.z
                ))
            })
        })
    }

    /// All solutions that were found, one a row.
    fn ik_all<'py>(&self, py: Python<'py>, target: PyReadonlyArray2<'_, f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let at = self.in_table(&pose(&target)?);
        let all = guarded(py, || {
            self.hinges_alone()?;
            Ok(chain(&self.model)?.solve(&at))
        })?;
        matrix(py, self.dof(), all.concat())
    }

    /// The robot as TOML.
    fn to_toml(&self) -> String {
        toml_file::write(&self.model, &[])
    }

    /// The robot as URDF.
    fn to_urdf(&self) -> String {
        write_urdf(&self.model, &self.model.rows(), &[])
    }
}
