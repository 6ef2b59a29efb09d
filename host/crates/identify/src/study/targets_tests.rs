//! Tables with several targets and with poses, from the file to the result and to the table for sharing.

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use rand::{RngExt as _, SeedableRng as _};

use super::*;

/// Targets in the flange frame, in m; the first is the TCP of the iiwa 7.
const PLACES: [[f64; 3]; 3] = [[0.05, 0.0, 0.1], [-0.1, 0.06, 0.05], [0.02, -0.12, 0.13]];

/// Rows of an iiwa 7 whose third link is 1 mm longer: three targets, or poses; noise of 0.05 mm and 0.5 mrad.
fn table(seed: u64, rows: usize, poses: bool) -> String {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut robot = spherecal_model::robots::load("iiwa7").unwrap();
    robot.robot.joints[2].mdh.d += 1e-3;
    let base = Rotation3::from_euler_angles(0.3, -0.2, 2.0);
    let body = Rotation3::from_euler_angles(1.0, 0.5, -0.4);
    let mut text = (1..=7).map(|j| format!("q{j},")).collect::<String>();
    text += if poses {
        "x_mm,y_mm,z_mm,qw,qx,qy,qz,operator\n"
    } else {
        "x1_mm,y1_mm,z1_mm,x2_mm,y2_mm,z2_mm,x3_mm,y3_mm,z3_mm,operator\n"
    };
    for k in 0..rows {
        let q: Vec<f64> = (0..7).map(|_| random.random_range(-1.5..1.5)).collect();
        let flange = crate::flange::Flange::new(&robot.robot).at(&q);
        let mut cells: Vec<String> = q.iter().map(|q| format!("{q:.9}")).collect();
        for (number, place) in PLACES.iter().enumerate().take(if poses { 1 } else { 3 }) {
            let off = Vector3::from_fn(|_, _| random.random_range(-0.08..0.08));
            let at = (base * flange.point(&Vector3::from(*place)) + Vector3::new(3.0, 1.0, -0.5)) * 1e3 + off;
            let hidden = (k + number) % 7 == 0 && !poses;
            cells.extend(
                at.iter()
                    .map(|x| if hidden { String::new() } else { format!("{x:.4}") }),
            );
        }
        if poses {
            let off = Rotation3::new(Vector3::from_fn(|_, _| random.random_range(-8e-4..8e-4)));
            let turned = off * base * Rotation3::from_matrix_unchecked(flange.rotation) * body;
            let q = UnitQuaternion::from_rotation_matrix(&turned);
            cells.extend([q.w, q.i, q.j, q.k].map(|x| format!("{x:.7}")));
        }
        text += &format!("{},Ms Smith\n", cells.join(","));
    }
    text
}

fn request(folder: &std::path::Path, data: &str, validate: Option<&str>) -> StudyRequest {
    let path = folder.join("data.csv");
    std::fs::write(&path, data).unwrap();
    let check = folder.join("check.csv");
    if let Some(text) = validate {
        std::fs::write(&check, text).unwrap();
    }
    StudyRequest {
        robot: "iiwa7".to_owned(),
        data: path,
        validate: validate.map(|_| check),
        ignore_columns: vec!["operator".to_owned()],
        ..StudyRequest::default()
    }
}

// Fails if a table of targets or poses with a validation file of the same columns does not find the longer link, if a
// target or the orientation has no error by that file, if the table for sharing gives another robot, or if that table
// names the operator or tells where the instrument stood.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_targets_and_poses_go_from_file_to_file() {
    let folder = tempfile::tempdir().unwrap();
    for poses in [false, true] {
        let (data, check) = (table(1, 60, poses), table(2, 20, poses));
        let found = study(&request(folder.path(), &data, Some(&check)), &mut |_| {}).unwrap();
        let of = |study: &Study, name: &str| {
            let parameters = &study.evaluation.calibration.parameters;
            parameters.iter().find(|p| p.name == name).unwrap().clone()
        };
        let d3 = of(&found, "d3");
        assert!(
            (d3.estimate - d3.nominal - 1e-3).abs() < 4.0 * d3.sigma + 5e-5,
            "{d3:?}"
        );
        let judged = found.evaluation.judged.as_ref().unwrap().model("calibrated").unwrap();
        assert!(judged.errors().mean_mm < 0.25, "{:?}", judged.errors());
        if poses {
            let turns = judged.turns().unwrap();
            assert!(turns.n == 20 && turns.mean_mrad < 2.0, "{turns:?}");
        } else {
            let errors = [2, 3].map(|number| judged.target_errors(number));
            assert!(errors.iter().all(|e| e.n > 15 && e.mean_mm < 0.25), "{errors:?}");
        }

        let text = anonymous_csv(&found.recordings);
        assert!(!text.contains("Smith") && text.contains(if poses { ",qw," } else { ",x3_m," }));
        let again = study(&request(folder.path(), &text, None), &mut |_| {}).unwrap();
        for parameter in &found.evaluation.calibration.parameters {
            let other = of(&again, &parameter.name);
            let base = parameter.name.starts_with("base");
            let off = (parameter.estimate - other.estimate).abs();
            // The table does not say where the instrument stood, so poses have another line of sight.
            let sigmas = if poses { 0.1 } else { 0.01 };
            assert!(base || off <= sigmas * parameter.sigma, "{parameter:?} {other:?}");
        }
        let far = again.recordings.experiment.observations.iter();
        let far = far
            .filter_map(|o| crate::targets::measured_tcp(&o.target))
            .map(|p| p.norm());
        assert!(far.fold(0.0, f64::max) < 2.0, "the points are about their mean");
    }
}

// Fails if a validation file may name a target or orientations that no calibration row has.
#[test]
fn validation_rows_have_no_targets_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let (three, poses) = (table(3, 30, false), table(4, 30, true));
    let one: String = three
        .lines()
        .enumerate()
        .filter_map(|(k, line)| {
            let cells: Vec<&str> = line.split(',').collect();
            (k == 0 || !cells[7].is_empty()).then(|| format!("{}\n", cells[..10].join(",")))
        })
        .collect();
    for (data, check, words) in [
        (&one, &three, ["has target 3", "--ignore-columns x3_mm"]),
        (&one, &poses, ["has orientations", "--ignore-columns qw"]),
    ] {
        let error = study(&request(folder.path(), data, Some(check)), &mut |_| {}).unwrap_err();
        let said = error.to_string();
        assert!(error.is_input() && words.iter().all(|w| said.contains(w)), "{said}");
    }
}
