//! Several targets and poses as a user gives them to `identify`.

use std::fmt::Write as _;

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use serde_json::Value;
use spherecal::model::chain::Chain;
use spherecal::model::robots;

use crate::support::{spherecal, text};

/// Rows of an iiwa 7 whose third link is 1 mm longer: two targets (the second with four times the noise), or poses.
fn table(poses: bool) -> String {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(8);
    let mut model = robots::load("iiwa7").expect("built in");
    model.robot.joints[2].mdh.d += 1e-3;
    let chain = Chain::unchecked(&model.robot, &model.tool_in_table());
    let places = [model.tool_in_table().tcp(), Vector3::new(-0.1, 0.06, 0.05)];
    let mut table = (1..=7).fold(String::new(), |all, j| format!("{all}q{j},"));
    table += if poses {
        "x_mm,y_mm,z_mm,qw,qx,qy,qz\n"
    } else {
        "x1_mm,y1_mm,z1_mm,x2_mm,y2_mm,z2_mm\n"
    };
    for _ in 0..60 {
        let q: Vec<f64> = (0..7).map(|_| random.random_range(-1.5..1.5)).collect();
        let flange = chain.frames(&q)[6];
        let mut numbers = q;
        for (place, noise) in places.iter().zip([0.05, 0.2]).take(if poses { 1 } else { 2 }) {
            let off = Vector3::from_fn(|_, _| 1.7 * noise * random.random_range(-1.0..1.0));
            numbers.extend((flange.point(place) * 1e3 + off).iter());
        }
        if poses {
            let off = Rotation3::new(Vector3::from_fn(|_, _| random.random_range(-8e-4..8e-4)));
            let q = UnitQuaternion::from_rotation_matrix(&(off * Rotation3::from_matrix_unchecked(flange.rotation)));
            numbers.extend([q.w, q.i, q.j, q.k]);
        }
        let cells: Vec<String> = numbers.iter().map(|x| format!("{x:.7}")).collect();
        writeln!(table, "{}", cells.join(",")).expect("a text");
    }
    table
}

// Fails if summary, report or terminal does not name each target and the orientation with noise and error, if a noise is
// off by half, if a table of single points has them, or if
// a measured point is not part of the hash of the recordings.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_each_target_is_named_with_noise_and_error() {
    let folder = tempfile::tempdir().expect("a folder");
    for poses in [false, true] {
        std::fs::write(folder.path().join("table.csv"), table(poses)).expect("written");
        let arguments = ["identify", "--robot", "iiwa7", "--data", "table.csv"];
        let output = spherecal(folder.path(), &[&arguments[..], &["--json", "--out", "json"]].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let found: Value = serde_json::from_slice(&output.stdout).expect("one document");
        let targets = found["targets"].as_array().expect("targets");
        let noise = |value: &Value, unit: &str| value[format!("noise_{unit}")].as_f64().expect("a noise");
        assert_eq!(targets.len(), if poses { 1 } else { 2 });
        assert!((noise(&targets[0], "mm") / 0.05).ln().abs() < 0.4, "{targets:?}");
        assert_eq!(targets[0]["rows"], 60);
        assert!(
            targets
                .iter()
                .all(|t| t["validation"]["mean_mm"].as_f64().expect("an error") < 0.6)
        );
        let output = spherecal(folder.path(), &[&arguments[..], &["--out", "words"]].concat());
        let said = text(&output.stdout);
        let page = std::fs::read_to_string(folder.path().join("words/report.html")).expect("the report");
        assert!(page.contains("Targets on the tool"));
        if poses {
            let noise = noise(&found["orientation"], "mrad");
            assert!((noise / 0.46).ln().abs() < 0.4, "{noise}");
            assert!(said.contains("1 target on the tool, with its orientation"), "{said}");
            assert!(said.contains("orientation: 60 rows, noise 0."), "{said}");
        } else {
            assert!((noise(&targets[1], "mm") / 0.2).ln().abs() < 0.4, "{targets:?}");
            assert!(found["orientation"].is_null());
            assert!(said.contains("2 targets on the tool"), "{said}");
            assert!(said.contains("target 2: 60 rows, at ("), "{said}");
        }
    }
    // The certificate is that of these measurements: the same poses with another point are other recordings.
    let hash = |name: &str| {
        let arguments = ["identify", "--robot", "iiwa7", "--data", name, "--json"];
        let output = spherecal(folder.path(), &arguments);
        let found: Value = serde_json::from_slice(&output.stdout).expect("one document");
        found["certificate"]["recordings_sha256"]
            .as_str()
            .expect("a hash")
            .to_owned()
    };
    let poses = table(true);
    let (head, last) = poses.trim_end().rsplit_once('\n').expect("rows");
    let mut cells: Vec<String> = last.split(',').map(str::to_owned).collect();
    cells[7] = format!("{:.7}", cells[7].parse::<f64>().expect("x_mm") + 1e-3);
    std::fs::write(
        folder.path().join("other.csv"),
        format!("{head}\n{}\n", cells.join(",")),
    )
    .expect("written");
    assert_ne!(hash("table.csv"), hash("other.csv"));
    // The positions of the poses alone.
    let points = [
        "identify",
        "--robot",
        "iiwa7",
        "--data",
        "table.csv",
        "--ignore-columns",
    ];
    let output = spherecal(folder.path(), &[&points[..], &["qw,qx,qy,qz", "--json"]].concat());
    let found: Value = serde_json::from_slice(&output.stdout).expect("one document");
    assert!(found["targets"].is_null() && found["orientation"].is_null(), "{found}");
    let page = std::fs::read_to_string(folder.path().join("spherecal-out/report.html")).expect("the report");
    assert!(!page.contains("Targets on the tool"));
}
