//! Standard Denavit-Hartenberg tables, and the calibration of a controller of Universal Robots.

use std::fmt::Write as _;

use nalgebra::Matrix4;

use super::super::*;
use super::{compose, distance};

/// The transform of a row, written out: independent of the code.
fn dh(theta: f64, d: f64, a: f64, alpha: f64) -> Matrix4<f64> {
    let ((st, ct), (sa, ca)) = (theta.sin_cos(), alpha.sin_cos());
    #[rustfmt::skip]
    let rows = Matrix4::new(
        ct, -st * ca, st * sa, a * ct,
        st, ct * ca, -ct * sa, a * st,
        0.0, sa, ca, d,
        0.0, 0.0, 0.0, 1.0,
    );
    rows
}

fn matrix(pose: &Pose<f64>) -> Matrix4<f64> {
    let mut out = pose.rotation.to_homogeneous();
    out.fixed_view_mut::<3, 1>(0, 3).copy_from(&pose.position);
    out
}

const Q: [f64; 8] = [0.3, -1.2, 0.8, 2.0, -0.4, 1.1, -2.2, 0.6];

/// The built-in arms, each also with small errors: then axes that were parallel are not.
fn arms() -> Vec<RobotModel> {
    let mut out = Vec::new();
    for name in BUILT_IN {
        let model = built_in(name).unwrap();
        let mut off = model.clone();
        for (k, joint) in off.robot.joints.iter_mut().enumerate() {
            let e = 1e-3 * (k as f64 + 1.3).sin();
            joint.mdh.alpha += e;
            joint.mdh.beta += 0.7 * e;
            joint.mdh.theta -= 2.0 * e;
            joint.mdh.a += e;
        }
        out.extend([model, off]);
    }
    out
}

// Fails if a standard table gives another flange than the robot's own, or loses a mass, on the way out and in again.
#[test]
fn a_standard_table_is_the_same_robot() {
    for model in arms() {
        let n = model.robot.dof();
        let chain = model.standard();
        for q in [vec![0.0; n], Q[..n].to_vec()] {
            let table = chain.rows.iter().zip(&q);
            let product = table.fold(matrix(&chain.base), |at, (r, q)| {
                at * dh(r.theta + q, r.d, r.a, r.alpha)
            });
            let off = (product * matrix(&chain.flange) - matrix(&model.flange_at(&q))).amax();
            assert!(off < 1e-9, "{}: {off:e}", model.robot.name);
            let text = toml_file::write_standard(&model, &[]);
            assert!(text.contains("dh = { theta = ") && !text.contains("mdh"), "{text}");
            let back = toml_file::load("r.toml", &text).unwrap();
            assert!(
                distance(&back.flange_at(&q), &model.flange_at(&q)) < 1e-9,
                "{}",
                model.robot.name
            );
            // The centres of mass stand where they stood.
            let centres = |model: &RobotModel| -> Vec<nalgebra::Vector3<f64>> {
                let frames = table_frames(&model.rows(), &q);
                let joints = model.robot.joints.iter().zip(&frames);
                joints
                    .map(|(j, f)| compose(&model.base, f).point(&j.link.com()))
                    .collect()
            };
            for (a, b) in centres(&model).iter().zip(&centres(&back)) {
                assert!((a - b).norm() < 1e-9, "{}", model.robot.name);
            }
        }
        // Parallel axes of a nominal arm have no far normal, and the wrist of a maker is a maker's.
        assert!(chain.rows.iter().all(|r| r.d.abs() < 1e4 && r.a.abs() < 1e4));
    }
}

// Fails if a textbook's table of an arm (Puma 560, as Corke prints it) is read as modified, or a mixture is read at all.
#[test]
fn a_textbook_table_is_read() {
    let rows = [
        (0.0, 0.6718, 0.0, 90.0),
        (0.0, 0.0, 0.4318, 0.0),
        (0.0, 0.15005, 0.0203, -90.0),
        (0.0, 0.4318, 0.0, 90.0),
        (0.0, 0.0, 0.0, -90.0),
        (0.0, 0.0, 0.0, 0.0),
    ];
    let mut text = "name = \"puma\"\n".to_owned();
    for (theta, d, a, alpha) in rows {
        let _ = writeln!(
            text,
            "[[joint]]\ndh = {{ theta_deg = {theta}, d = {d}, a_mm = {}, alpha_deg = {alpha} }}",
            a * 1e3
        );
    }
    let model = toml_file::load("puma.toml", &text).unwrap();
    let product = rows
        .iter()
        .zip(&Q)
        .fold(Matrix4::identity(), |at, (&(theta, d, a, alpha), q)| {
            at * dh(f64::to_radians(theta) + q, d, a, f64::to_radians(alpha))
        });
    assert!((product - matrix(&model.flange_at(&Q[..6]))).amax() < 1e-12);
    for (from, to) in [
        ("dh = { theta_deg = 0, d = 0.4318", "mdh = { theta_deg = 0, d = 0.4318"),
        ("theta_deg = 0, d = 0.15005", "beta = 0.1, d = 0.15005"),
    ] {
        assert!(text.contains(from), "{text}");
        let error = toml_file::load("puma.toml", &text.replacen(from, to, 1))
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("joint") && error.contains("mdh = {..} (modified)"),
            "{error}"
        );
    }
}

/// What a controller writes for an arm whose standard table has these rows.
fn conf(rows: &[[f64; 4]]) -> String {
    let mut text = "# written by the factory\n[mounting]\n".to_owned();
    for (k, name) in ["delta_theta", "delta_d", "delta_a", "delta_alpha"].iter().enumerate() {
        let values: Vec<String> = rows.iter().map(|row| format!("{:e}", row[k])).collect();
        let _ = writeln!(text, "{name} = [ {}]", values.join(", "));
    }
    text + "calibration_status = 2 # 0 == notInitialized\n"
}

// Fails if the calibration of a controller is not added to the maker's table, in the maker's base frame turned by 180 degrees;
// if far normals (d of 100 m) cost accuracy; or if the file of another arm, or a damaged one, is read.
#[test]
fn the_calibration_of_a_ur_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("calibration.conf");
    let load = |text: &str, arm: &str| {
        std::fs::write(&file, text).unwrap();
        load(&format!("{}{arm}", file.display())).map_err(|e| e.to_string())
    };
    let plain = built_in("ur5e").unwrap();
    let zero = load(&conf(&[[0.0; 4]; 6]), "#ur5e").unwrap();
    for q in [[0.0; 6], [0.3, -1.2, 0.8, 2.0, -0.4, 1.1]] {
        assert!(distance(&zero.flange_at(&q), &plain.flange_at(&q)) < 1e-12);
    }
    // Axis 3 leans by 1 mrad against axis 2, so that their common normal is 100 m away. At the arm it stands where it stood.
    let (lean, far) = (1e-3_f64, 100.0);
    let aside = far * lean.tan();
    let a2 = -(0.425_f64.powi(2) - aside.powi(2)).sqrt();
    let turn = std::f64::consts::PI - aside.atan2(a2);
    let maker = [
        [0.0, 0.1625, 0.0, std::f64::consts::FRAC_PI_2],
        [0.0, 0.0, -0.425, 0.0],
        [0.0, 0.0, -0.3922, 0.0],
        [0.0, 0.1333, 0.0, std::f64::consts::FRAC_PI_2],
        [0.0, 0.0997, 0.0, -std::f64::consts::FRAC_PI_2],
        [0.0, 0.0996, 0.0, 0.0],
    ];
    let delta = [
        [1e-4, 2e-4, 1e-4, -2e-4],
        [turn, far, a2 + 0.425, lean],
        [-turn, -far / lean.cos(), 2e-4, -lean],
        [-1e-3, 1e-4, -1e-4, 3e-4],
        [1e-4, -2e-4, 2e-5, 1e-4],
        [0.0, 1e-4, 0.0, 0.0],
    ];
    let model = load(&conf(&delta), "#ur5e").unwrap();
    assert!(distance(&model.base, &Pose::identity()) < 1e-9 && model.rows().iter().all(|r| r.d.abs() < 1.0));
    let q = [0.3, -1.2, 0.8, 2.0, -0.4, 1.1];
    let mut expected = Matrix4::from_diagonal(&[-1.0, -1.0, 1.0, 1.0].into());
    for ((m, e), q) in maker.iter().zip(&delta).zip(&q) {
        expected *= dh(m[0] + e[0] + q, m[1] + e[1], m[2] + e[2], m[3] + e[3]);
    }
    assert!((expected - matrix(&model.flange_at(&q))).amax() < 1e-9);
    let mut other = delta;
    other[2][1] += 1.0;
    for (text, arm, words) in [
        (
            conf(&delta),
            "",
            "arm is \"not named\": name the arm that it corrects as",
        ),
        (conf(&delta), "#panda", "with one of ur5e, ur10e"),
        (
            conf(&delta).replace("delta_d ", "delta_x "),
            "#ur5e",
            "delta_d is \"missing\"",
        ),
        (
            conf(&delta[..5]),
            "#ur5e",
            "lists delta_theta, delta_a, delta_d and delta_alpha of six numbers",
        ),
        (conf(&delta).replace("1e2", "nan"), "#ur5e", "six numbers"),
        (conf(&other), "#ur5e", "is it the calibration of another arm than ur5e?"),
    ] {
        let error = load(&text, arm).unwrap_err();
        assert!(error.contains(words), "{words}: {error}");
    }
}

/// A real arm: the file of a UR10e that its owner published (<https://forum.universal-robots.com/t/calibrated-kinamatics-info/18921>).
const OF_A_UR10E: &str = "[mounting]
delta_theta = [ -8.20642406610186392e-05, -0.103609197138685979, 0.673631891251821102, -0.57016974724960845, -4.59636351675856217e-05, 9.74999561134540574e-07]
delta_a = [ -0.000161187342296687116, 0.00304003843792177708, 0.0916468555721788314, -9.62964975953143595e-05, -2.97595340762196176e-05, 0]
delta_d = [ 0.000505390894843998906, 11.1984514757821039, -92.5270326908668181, 81.3282683520703529, -0.000212852818740727479, -0.000126145560998547346]
delta_alpha = [ -0.00032142399895862539, -0.00565024518540147101, -0.00378922621833689211, -0.00106533274011644252, 0.000999586303470856308, 0]
calibration_status = 2 # 0 == notInitialized / 1 == notLinearised / 2 == Linearised
";

// Fails if the calibration of a real arm does not correct its lengths by some mm, or passes for that of another type.
#[test]
fn a_published_calibration_is_that_of_its_arm() {
    let model = ur_parameters::load("c.conf", OF_A_UR10E, Some("ur10e")).unwrap();
    let nominal = built_in("ur10e").unwrap();
    let (a, b): (Vec<f64>, Vec<f64>) = (
        model.rows().iter().map(|r| r.a).collect(),
        nominal.rows().iter().map(|r| r.a).collect(),
    );
    let most = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!((1e-4..3e-3).contains(&most), "{most}");
    let error = ur_parameters::load("c.conf", OF_A_UR10E, Some("ur5e"))
        .unwrap_err()
        .to_string();
    assert!(error.contains("another arm than ur5e"), "{error}");
}
