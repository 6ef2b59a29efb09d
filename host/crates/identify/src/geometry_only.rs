//! The best geometry alone under a full model, for files that hold no effects.
//!
//! A table of links cannot hold compliance, bending or encoder harmonics. This is the table, tool and base that come
//! closest to the full model's TCP over the postures of a region:
//!
//! `min Σ |h_full − h(g)|² / σ² + (g − g₀)ᵀ P₀⁻¹ (g − g₀)`
//!
//! with the priors' sizes as the fit found them, about the nominal robot. So the geometry is changed only where the
//! region or the priors tell how.

use nalgebra::Vector3;
use spherecal_model::chain::Chain;
use spherecal_model::fit_pose;
use spherecal_shared::robot::{Robot, Tool};

use crate::hierarchy::constants::FILE_MISFIT_M;
use crate::{
    Calibration, ExpectedError, Experiment, IdentifyError, Method, Noise, Observation, Options, Pose, Set, Statement,
    Target,
};

/// A geometry alone, and how good it is.
#[derive(Clone, Debug)]
pub struct GeometryOnly {
    /// The robot with its table of links.
    pub robot: Robot,
    /// Its tool.
    pub tool: Tool,
    /// Its F0 seen from the full model's.
    pub base: Pose,
    /// Mean distance of its TCP from the full model's over the region, the base aligned, in mm.
    pub apart_mm: f64,
    /// Its expected error over the work region; `None` where that of the full model is unknown.
    pub expected_error_mm: Option<ExpectedError>,
    /// Probability that it is better there than the nominal robot; `None` where the statement is unknown.
    pub better: Option<f64>,
}

/// Least misfit of the projection (m), for a model without effects: far below every prior.
const LEAST_MISFIT_M: f64 = 1e-6;
/// Joint noise of the projection (rad): so small that all directions of the error count alike.
const JOINT_RAD: f64 = 1e-9;

impl GeometryOnly {
    /// Whether it is rather better than the nominal robot over the work region than worse; a file that is not is not
    /// written.
    pub fn helps(&self) -> bool {
        self.better.is_none_or(|probability| probability >= 0.5)
    }

    /// The projection of `calibration` on the geometry of `nominal` over `postures` (rad).
    ///
    /// # Errors
    /// No convergence.
    pub(crate) fn of(
        calibration: &Calibration,
        nominal: &Experiment,
        postures: &[Vec<f64>],
        statement: Option<&Statement>,
    ) -> Result<Self, IdentifyError> {
        let observations = postures.iter().map(|q| Observation {
            seat: None,
            q: q.clone(),
            tau: None,
            target: Target::Point(calibration.tcp_m(q, None).into()),
            set: Set::Calibrate,
        });
        let experiment = Experiment {
            robot: nominal.robot.clone(),
            tool: nominal.tool,
            spheres: Vec::new(),
            observations: observations.collect(),
        };
        let fit = |misfit_m: f64| {
            let options = Options {
                method: Method::Geometry,
                student_t: 0.0,
                base: Some(Pose::default()),
                noise: Noise {
                    joint_rad: JOINT_RAD,
                    point_m: misfit_m.max(LEAST_MISFIT_M),
                    estimate: false,
                    ..Noise::default()
                },
                parameters: calibration.geometric_priors(),
                ..Options::default()
            };
            crate::identify(&experiment, &options)
        };
        // What a geometry cannot follow is noise to it: first a guess, then what the first fit leaves.
        let first = fit(FILE_MISFIT_M)?;
        let found = fit(first.residual.rms_mm * 1e-3 / 3.0_f64.sqrt())?;
        let chain = Chain::unchecked(&found.robot, &found.tool);
        let tcp = |q: &[f64]| chain.pose(q).position;
        let before = Chain::unchecked(&nominal.robot, &nominal.tool);
        let own: Vec<Vector3<f64>> = postures.iter().map(|q| tcp(q)).collect();
        let full: Vec<Vector3<f64>> = postures.iter().map(|q| calibration.tcp_m(q, None)).collect();
        let base = fit_pose(&own, &full).unwrap_or_else(Pose::identity);
        let apart = own.iter().zip(&full).map(|(a, b)| (base.point(a) - b).norm());
        Ok(Self {
            apart_mm: apart.sum::<f64>() / own.len().max(1) as f64 * 1e3,
            base,
            expected_error_mm: statement.map(|s| s.expected_error_of(tcp)),
            better: statement.map(|s| s.probability_better(tcp, |q| before.pose(q).position)),
            robot: found.robot.clone(),
            tool: found.tool,
        })
    }
}

#[cfg(test)]
#[path = "geometry_only_tests.rs"]
mod tests;
