//! How good any estimator could be on the same recordings: one that is told the
//! laws that the simulated arm's errors were drawn from (never the errors).

use spherecal_identify::{Method, Model, Noise, Options, Override};
use spherecal_sim::plant::PlantConfig;

/// Options of an estimator whose model, priors and noise are the plant's own
/// laws, for an arm with `joints` joints.
pub(super) fn bound_options(plant: &PlantConfig, joints: usize) -> Options {
    let on = |enabled: bool, value: f64| if enabled { value } else { 0.0 };
    let encoder = &plant.encoder;
    let orders = if encoder.harmonics {
        encoder.harmonic_rad.len()
    } else {
        0
    };
    let unmodelled = [
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
        student_t: 0.0,
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
            }
        } else {
            Override {
                nominal,
                prior_sigma: None,
                free: Some(false),
            }
        };
        options.parameters.0.insert(name, given);
    };
    let geometry = &plant.geometry;
    let length = on(geometry.enabled, geometry.length_sigma_m);
    prior("a".into(), None, length);
    prior("d".into(), None, length);
    prior("alpha".into(), None, on(geometry.enabled, geometry.alpha_sigma_rad));
    prior("theta".into(), None, on(geometry.enabled, geometry.theta_sigma_rad));
    prior(
        "tool".into(),
        None,
        on(plant.tool.enabled, plant.tool.tcp_sigma_m).hypot(length).max(1e-6),
    );
    let compliance = &plant.compliance;
    let mean = on(compliance.enabled, compliance.joint_rad_per_nm);
    // Uniform within the spread about its mean.
    prior("compliance".into(), Some(mean), mean * compliance.spread / 3f64.sqrt());
    prior(
        "bending".into(),
        None,
        on(compliance.enabled, compliance.link_rad_per_nm),
    );
    prior("tilt".into(), None, on(compliance.enabled, compliance.base_rad_per_nm));
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
