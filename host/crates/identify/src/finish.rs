//! From a fit to its result.

use super::calibration::{Calibration, FramePose, Inner, NoiseFound, ParameterEstimate};
use super::chain::Prepared;
use super::hierarchy::{self, Fit};
use super::options::{Model, Options};
use super::residuals::residuals;
use super::target_fit::target_fits;
use spherecal_model::Experiment;

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
    let joint_noise = fit.whitening.joint;
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
        noise: NoiseFound {
            joint_rad: fit.whitening.joint.sqrt(),
            seating_m: fit.whitening.seating.sqrt(),
            point_m: fit.target_noise(0).mean().sqrt(),
            student_t: fit.nu,
        },
        effective_parameters: fit.effective,
        log_evidence: fit.log_evidence,
        assumed_masses: nominal.assumed(),
        strangeness: fit.strangeness,
        open: fit.open.clone(),
        cross: fit.cross.clone(),
        displaced: fit.displaced.clone(),
        left_out: fit.left_out.clone(),
        inner: Inner {
            layout: layout.clone(),
            state: state.clone(),
            nominal: nominal.clone(),
            columns: fit.unknowns.columns.clone(),
            joint_variance: joint_noise,
            shift_variance: if fit.prepared.iter().any(Prepared::has_several) {
                fit.whitening.tool[0]
            } else {
                0.0
            },
            ends: fit.ends.clone(),
            measured_torque: hierarchy::measured(experiment, nominal, options.torque),
        },
        covariance: fit.covariance,
    }
}
