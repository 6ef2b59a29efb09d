//! The budget of the expected error, by source.

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use spherecal_identify::{ErrorBudget, Experiment, Options, Source, identify, workspace};
use spherecal_model::fit_pose;

use super::{Trial, WHITE_RAD, diagnosed, measured, normal, sound};

/// The budget of the full model.
fn budget(trial: &Trial) -> ErrorBudget {
    diagnosed(trial).error_budget().expect("sound data")
}

fn term(budget: &ErrorBudget, source: Source) -> f64 {
    let found = budget.terms.iter().find(|t| t.source == source);
    found.unwrap_or_else(|| panic!("{source:?} in {budget:?}")).rms_mm
}

// Fails if the terms of the budget do not add up to its total (in squares), or if a source that grows (the
// certificate's uncertainty, the noise of the joints) does not show in its own term, or shows in that of the plate.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_the_budget_adds_up_and_each_source_shows_in_its_own_term() {
    let seed = 5;
    let plain = sound(seed);
    let mut vague = sound(seed);
    for sphere in &mut vague.experiment.spheres {
        sphere.sigma_m = 50e-6;
    }
    let noisy = measured(seed, &|time, _, visit, _, encoders| {
        let mut rng = ChaCha8Rng::seed_from_u64((time * 1e6) as u64 + visit as u64);
        for angle in encoders {
            *angle += normal(&mut rng, 4.0 * WHITE_RAD);
        }
    });
    let budgets = [plain, vague, noisy].map(|trial| {
        let budget = budget(&trial);
        let squares: f64 = budget.terms.iter().map(|t| t.rms_mm.powi(2)).sum();
        assert!((squares.sqrt() / budget.total_mm - 1.0).abs() < 1e-9, "{budget:?}");
        budget
    });
    let [plain, vague, noisy] = &budgets;
    let grows = |of: &ErrorBudget, source| term(of, source) / term(plain, source);
    assert!(grows(vague, Source::Plate) > 10.0, "{vague:?} {plain:?}");
    assert!(
        (0.7..1.4).contains(&grows(vague, Source::EncoderNoise)),
        "{vague:?} {plain:?}"
    );
    let noise = grows(noisy, Source::EncoderNoise);
    assert!((2.5..5.0).contains(&noise), "{noisy:?} {plain:?}");
    assert!(grows(noisy, Source::Plate) < 2.0, "{noisy:?} {plain:?}");
}

// Fails if the term of the plate is not what wrong certificates of the stated uncertainty do
// to the calibration: certificates are drawn, the robot is identified with each, and the
// displacement of its TCP over the workspace is compared.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_the_term_of_the_plate_is_what_drawn_certificates_do() {
    let mut trial = sound(6);
    for sphere in &mut trial.experiment.spheres {
        sphere.sigma_m = 40e-6;
    }
    let stated = term(&budget(&trial), Source::Plate);
    let over = workspace(&trial.experiment.robot, &trial.experiment.tool);
    let tcp = |experiment: &Experiment| -> Vec<Vector3<f64>> {
        let calibration = identify(experiment, &Options::default()).expect("sound data");
        over.iter().map(|q| calibration.tcp_m(q, None)).collect()
    };
    let found = tcp(&trial.experiment);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let draws = 12;
    let mut square = 0.0;
    for _ in 0..draws {
        let mut drawn = trial.experiment.clone();
        for sphere in &mut drawn.spheres {
            sphere.position_m = sphere.position_m.map(|x| x + normal(&mut rng, sphere.sigma_m));
        }
        let other = tcp(&drawn);
        let frame = fit_pose(&other, &found).expect("points in space");
        let squares = other
            .iter()
            .zip(&found)
            .map(|(a, b)| (frame.point(a) - b).norm_squared());
        square += squares.sum::<f64>() / over.len() as f64;
    }
    let measured = (square / f64::from(draws)).sqrt() * 1e3;
    // Twelve draws of nine numbers, of which the plate's own motion takes six.
    assert!(
        (0.6..1.6).contains(&(stated / measured)),
        "stated {stated} mm, by drawn certificates {measured} mm"
    );
}
