//! The whole evaluation of several targets and poses: folds, errors by target, gross errors, orientations of another body.

use super::drawn::{Drawn, Noise};
use spherecal_identify::evaluate::JudgedModel;
use spherecal_identify::{EvaluateError, EvaluateOptions, Evaluation, Experiment, Recordings, Target, evaluate};

fn evaluated(experiment: Experiment) -> Result<Evaluation, EvaluateError> {
    evaluate(&Recordings::new(experiment), &EvaluateOptions::default(), &mut |_| {})
}

// Fails if a row counts more than once, if the error of a target is missing or is that of another one, or if one target
// of two rows that is plainly wrong stays in the fit.
#[test]
fn each_target_has_its_error() {
    let mut drawn = Drawn::new(51);
    let mut noise = [Noise::of(0.05); 3];
    noise[2] = Noise::of(0.3);
    let mut experiment = drawn.points(60, &noise);
    for row in [7, 30] {
        if let Target::Points(points) = &mut experiment.observations[row].target
            && let Some(point) = &mut points[1]
        {
            point[0] += 0.2;
        }
    }
    if let Target::Points(points) = &mut experiment.observations[11].target {
        points[0] = None;
    }
    let found = evaluated(experiment).expect("sound data");
    let rejected: Vec<usize> = found.rejected.iter().map(|r| r.0).collect();
    assert_eq!(rejected, [7, 30]);
    assert_eq!((found.used.len(), found.calibration.residual.rows.len()), (58, 58));
    let judged = found.judged.as_ref().expect("cross-validated");
    let calibrated = judged.model("calibrated").expect("judged");
    // The row that did not see the TCP has no error of it.
    let rows: Vec<usize> = (1..=3).map(|number| calibrated.target_errors(number).n).collect();
    assert_eq!(rows, [57, 58, 58]);
    let rms = |number| calibrated.target_errors(number).rms_mm;
    assert!(rms(1) < 0.5 && rms(2) < 0.5, "{} {}", rms(1), rms(2));
    assert!(rms(3) > 1.1 * rms(1) && rms(3) < 1.0, "{}", rms(3));
    let nominal = judged.model("nominal").expect("judged");
    assert!((1..=3).all(|number| nominal.target_errors(number).rms_mm > 2.0 * rms(number)));
    assert!(found.verdict.may_be_used, "{:?}", found.verdict.reasons);
    let expected = found.verdict.expected_error_mm.expect("diagnosed");
    println!("expected {expected:?}");
    let error = super::drawn::tcp_error_mm(&drawn, &found.calibration);
    assert!(error < 1.5 * expected.interval[1], "{error} {expected:?}");
}

// Fails if poses are not judged by position and orientation, or if orientations that do not turn with the flange are used.
#[test]
fn poses_have_two_errors_and_must_turn_with_the_flange() {
    let mut drawn = Drawn::new(52);
    let experiment = drawn.poses(60, 0.2, 1.0);
    let found = evaluated(experiment.clone()).expect("sound data");
    let judged = found.judged.as_ref().expect("cross-validated");
    let turns = judged
        .model("calibrated")
        .and_then(JudgedModel::turns)
        .expect("has orientations");
    assert_eq!(turns.n, 60);
    assert!((1.0..4.0).contains(&turns.rms_mrad), "{turns:?}");
    let mut inverse = experiment;
    for o in &mut inverse.observations {
        if let Target::Frame(pose) = &mut o.target {
            pose.rotation = pose.rotation.transpose();
        }
    }
    let refused = evaluated(inverse).unwrap_err();
    assert!(
        matches!(refused, EvaluateError::NotThisOrientation { .. }) && refused.to_string().contains("w first"),
        "{refused}"
    );
}
