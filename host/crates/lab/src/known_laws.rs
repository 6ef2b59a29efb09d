//! An estimator that knows the laws from which the simulated arm's errors were drawn. It never
//! knows the errors themselves. It is a reference and no bound: on one robot another estimator may
//! come nearer by chance.
//!
//! Laws without a term in the model count as white joint noise: gear, smooth and cross-joint
//! errors, scatter, lost motion, early readings. If seats may be bad, or joints far off, the
//! estimator is robust and its priors are wide.

use spherecal_identify::{Method, Model, Noise, Options, Override};
use spherecal_sim::plant::PlantConfig;

/// Degrees of freedom of the Student-t weights if seats may be bad.
const ROBUST: f64 = 4.0;

/// Options of an estimator with the plant's own laws as model, priors and noise, for an arm with
/// `joints` joints.
pub(crate) fn known_laws_options(plant: &PlantConfig, joints: usize) -> Options {
    let on = |enabled: bool, value: f64| if enabled { value } else { 0.0 };
    let encoder = &plant.encoder;
    let orders = if encoder.harmonics {
        encoder.harmonic_rad.len()
    } else {
        0
    };
    let lost = &plant.lost_motion;
    let early = &plant.reading;
    // The mean square of a number uniform between a and b is (a² + a b + b²) / 3.
    let [low, high] = lost.half_width_rad;
    let lost_rms = ((low * low + low * high + high * high) / 3.0).sqrt();
    let early_rms = early.early_share.sqrt() * 0.5 * early.deceleration_rad_s2 * early.early_s * early.early_s;
    let unmodelled = [
        encoder.scatter_rad,
        on(lost.enabled, lost_rms),
        early_rms,
        on(encoder.gear, encoder.gear_rad),
        encoder.smooth_rad,
        encoder.cross_rad,
        plant.compliance.hysteresis_rad,
        1e-6,
    ];
    let nest = &plant.nest;
    let mut options = Options {
        method: Method::Full,
        model: Model::Full,
        harmonics: orders.max(1),
        student_t: if nest.kind.bad_seats().is_some() { ROBUST } else { 0.0 },
        noise: Noise {
            joint_rad: unmodelled.iter().map(|v| v * v).sum::<f64>().sqrt(),
            seating_m: on(nest.seating_error, nest.seating_sigma_m.hypot(nest.form_sigma_m)).max(1e-7),
            point_m: plant.tracker.sigma_m.max(1e-7),
            estimate: false,
            inflation: 1.0,
        },
        ..Options::default()
    };
    let mut prior = |name: String, nominal: Option<f64>, sigma: f64| {
        let given = if sigma > 0.0 {
            Override {
                nominal,
                prior_sigma: Some(sigma),
                free: None,
                ..Override::default()
            }
        } else {
            Override {
                nominal,
                prior_sigma: None,
                free: Some(false),
                ..Override::default()
            }
        };
        options.parameters.0.insert(name, given);
    };
    let geometry = &plant.geometry;
    let length = on(geometry.enabled, geometry.length_sigma_m);
    prior("a".into(), None, length);
    prior("d".into(), None, length);
    prior("alpha".into(), None, on(geometry.enabled, geometry.alpha_sigma_rad));
    // A uniform offset of some robots; this is its standard deviation over all of them.
    let offset = geometry.offset_rad * (geometry.offset_share / 3.0).sqrt();
    let theta = geometry.theta_sigma_rad.hypot(offset);
    prior("theta".into(), None, on(geometry.enabled, theta));
    prior(
        "tool".into(),
        None,
        on(plant.tool.enabled, plant.tool.tcp_sigma_m).hypot(length).max(1e-6),
    );
    let compliance = &plant.compliance;
    let mean = on(compliance.enabled, compliance.joint_rad_per_nm);
    // Uniform within the spread about its mean.
    prior("compliance".into(), Some(mean), mean * compliance.spread / 3f64.sqrt());
    for (joint, [low, high]) in compliance.joints_rad_per_nm.iter().enumerate().take(joints) {
        let (mean, sigma) = (f64::midpoint(*low, *high), (high - low) / 12f64.sqrt());
        prior(
            format!("compliance{}", joint + 1),
            Some(on(compliance.enabled, mean)),
            on(compliance.enabled, sigma),
        );
    }
    for (name, mean, sigma) in [
        ("bending", compliance.link_rad_per_nm, compliance.link_sigma_rad_per_nm),
        ("tilt", compliance.base_rad_per_nm, compliance.base_sigma_rad_per_nm),
    ] {
        let nominal = (mean > 0.0).then_some(on(compliance.enabled, mean));
        prior(name.into(), nominal, on(compliance.enabled, sigma));
    }
    for joint in 1..=joints {
        for order in 1..=orders.max(1) {
            let sigma = encoder.harmonic_rad.get(order - 1).copied().unwrap_or_default() / 2f64.sqrt();
            for part in ["cos", "sin"] {
                prior(
                    format!("harmonic{joint}_{part}{order}"),
                    None,
                    on(encoder.harmonics, sigma),
                );
            }
        }
    }
    options
}
