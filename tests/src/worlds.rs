//! The stored experiments `world_*.json`, as plain data for the identification.

use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;
use spherecal::identify::{Experiment, Observation, Pose, Set, Sphere, Target, fit_pose};
use spherecal_shared::robot::{Tool, iiwa7, iiwa7_tool};

/// Result of one stored estimator.
#[derive(Debug, Deserialize)]
pub struct Expected {
    /// Modified DH table, mm and rad.
    #[serde(default)]
    pub p: Vec<f64>,
    /// Mean, std, min, max of V1, V2 and V3, in mm.
    #[serde(rename = "V", default)]
    pub v: Vec<f64>,
    /// Parameters of the simplex, where it is one.
    #[serde(default)]
    pub x: Vec<f64>,
    /// Objective of the simplex.
    #[serde(default)]
    pub f: f64,
}

/// The robot that made the data: mm and rad.
#[derive(Debug, Deserialize)]
pub struct Truth {
    /// The table: alpha, a, theta, d of each row.
    pub p: Vec<f64>,
    /// The tool.
    pub tool: [f64; 3],
}

/// One file; lengths in mm.
#[derive(Debug, Deserialize)]
pub struct World {
    /// Sphere centres in the plate's frame.
    pub spheres_mm: Vec<[f64; 3]>,
    /// Tool as measured for the paper's protocol.
    pub tool_measured: [f64; 3],
    /// Base as measured from arcs, in the tracker's frame.
    #[serde(rename = "base_R_measured")]
    pub base_rotation: [[f64; 3]; 3],
    /// Its origin.
    #[serde(rename = "base_t_measured")]
    pub base_origin: [f64; 3],
    /// Plate from tracker: takes the tracker's axes to the plate's.
    #[serde(rename = "plate_R_from_tracker")]
    pub plate_rotation: [[f64; 3]; 3],
    /// Its origin.
    pub plate_t: [f64; 3],
    /// Configurations of the laser calibration.
    pub laser_q: Vec<Vec<f64>>,
    /// Measured points.
    pub laser_p: Vec<[f64; 3]>,
    /// Configurations of the validation.
    pub valid_q: Vec<Vec<f64>>,
    /// Measured points.
    pub valid_p: Vec<[f64; 3]>,
    /// Configurations on the spheres.
    pub sphere_q: Vec<Vec<f64>>,
    /// Sphere of each, from 0.
    pub sphere_id: Vec<u32>,
    /// 100 poses a sphere.
    pub subset300: Vec<usize>,
    /// Base rotation in the plate's frame, of the nominal model.
    #[serde(rename = "R_world_base_nominal")]
    pub nominal_rotation: [[f64; 3]; 3],
    /// The robot that made the data.
    pub truth: Truth,
    /// Stored results.
    pub expected: std::collections::BTreeMap<String, Expected>,
}

/// Mean, standard deviation, smallest and largest, in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Statistics {
    /// Mean.
    pub mean: f64,
    /// Standard deviation over all.
    pub std: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
}

impl Statistics {
    /// Of distances in mm.
    pub fn of(errors: &[f64]) -> Self {
        let n = errors.len().max(1) as f64;
        let mean = errors.iter().sum::<f64>() / n;
        Self {
            mean,
            std: (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / n).sqrt(),
            min: errors.iter().copied().fold(f64::INFINITY, f64::min),
            max: errors.iter().copied().fold(0.0, f64::max),
        }
    }

    /// As the stored files write them.
    pub fn array(&self) -> [f64; 4] {
        [self.mean, self.std, self.min, self.max]
    }
}

/// A rotation from rows.
pub fn rotation(rows: &[[f64; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|r, c| rows[r][c])
}

fn metres(p: &[f64; 3]) -> [f64; 3] {
    p.map(|x| x / 1000.0)
}

impl World {
    /// One of the stored files, by name without ending.
    pub fn load(name: &str) -> Self {
        crate::data(&format!("{name}.json"))
    }

    /// The measured base, in the tracker's frame.
    pub fn base(&self) -> Pose {
        Pose {
            rotation: rotation(&self.base_rotation),
            position: Vector3::from(self.base_origin) / 1000.0,
        }
    }

    /// The contacts, with the tool as drawn.
    pub fn spheres(&self) -> Experiment {
        let spheres = self.spheres_mm.iter().zip(0..).map(|(p, id)| Sphere {
            id,
            position_m: metres(p),
            sigma_m: 2.7e-6 / 1.96,
        });
        let observations = self
            .sphere_q
            .iter()
            .zip(&self.sphere_id)
            .map(|(q, &sphere)| Observation {
                seat: None,
                q: q.clone(),
                tau: None,
                target: Target::Sphere { sphere, place: 0 },
                set: Set::Calibrate,
            });
        Experiment {
            robot: iiwa7(),
            tool: iiwa7_tool(),
            spheres: spheres.collect(),
            observations: observations.collect(),
        }
    }

    /// The tracker's points.
    pub fn laser(&self) -> Experiment {
        let observations = self.laser_q.iter().zip(&self.laser_p).map(|(q, p)| Observation {
            seat: None,
            q: q.clone(),
            tau: None,
            target: Target::Point(metres(p)),
            set: Set::Calibrate,
        });
        Experiment {
            robot: iiwa7(),
            tool: iiwa7_tool(),
            spheres: Vec::new(),
            observations: observations.collect(),
        }
    }

    /// The tool as measured.
    pub fn measured_tool(&self) -> Tool {
        Tool {
            tcp_m: metres(&self.tool_measured),
            ..iiwa7_tool()
        }
    }

    /// Validation errors with the base aligned in least squares (V2), and with
    /// the measured base (V1); `tcp_m` predicts in F0.
    pub fn validate(&self, tcp_m: impl Fn(&[f64]) -> Vector3<f64>) -> [Statistics; 2] {
        let predicted: Vec<_> = self.valid_q.iter().map(|q| tcp_m(q)).collect();
        let measured: Vec<_> = self.valid_p.iter().map(|p| Vector3::from(metres(p))).collect();
        let errors = |pose: &Pose| {
            let e: Vec<_> = predicted
                .iter()
                .zip(&measured)
                .map(|(p, m)| (pose.point(p) - m).norm() * 1000.0)
                .collect();
            Statistics::of(&e)
        };
        let aligned = fit_pose(&predicted, &measured).unwrap_or_default();
        [errors(&self.base()), errors(&aligned)]
    }
}
