//! Several tips in one identification: two arms on a torso, or also the head, with a table of each.

use std::path::Path;

use nalgebra::Vector3;
use spherecal::model::fit_pose;
use spherecal::model::robots::{JointPath, load_path};

use crate::chain_urdfs::{humanoid, two_arms};
use crate::chains::{NOISE_M, Real, Rows, TOOL_M, by_yourdfpy, error_m, plain_fit, point};
use crate::support::{spherecal, text};

/// The chain from the base to a link of a file.
fn chain(file: &Path, base: &str, tip: &str) -> JointPath {
    let model = load_path(&format!("{}#{base}:{tip}", file.display())).expect("a chain");
    model.joint_path().expect("a path")
}

fn write(folder: &Path, name: &str, path: &JointPath, rows: &Rows) {
    let mut table = path.columns.join(",") + ",x_mm,y_mm,z_mm\n";
    for (q, at) in rows {
        for q in q {
            table += &format!("{q},");
        }
        table += &format!("{},{},{}\n", at.x * 1e3, at.y * 1e3, at.z * 1e3);
    }
    std::fs::write(folder.join(name), table).expect("written");
}

/// Mean distance (m) of each tip from its rows, after one rigid fit of the base for all.
fn errors_m(rows: &[Rows], at: impl Fn(usize, &[f64]) -> Vector3<f64>) -> Vec<f64> {
    let own = |(limb, rows): (usize, &Rows)| rows.iter().map(|(q, _)| at(limb, q)).collect::<Vec<_>>();
    let own: Vec<_> = rows.iter().enumerate().map(own).collect();
    let real: Vec<_> = rows.iter().flatten().map(|(_, at)| *at).collect();
    let base = fit_pose(&own.concat(), &real).expect("points");
    let mean = |(own, rows): (&Vec<Vector3<f64>>, &Rows)| {
        let far = own
            .iter()
            .zip(rows)
            .map(|(own, (_, real))| (base.point(own) - real).norm());
        far.sum::<f64>() / rows.len() as f64
    };
    own.iter().zip(rows).map(mean).collect()
}

fn identify(folder: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let output = spherecal(folder, &[&["identify", "--tool-mm", "20,10,80"], arguments].concat());
    (output.status.code(), text(&output.stdout) + &text(&output.stderr))
}

/// A robot with errors of its own, and the chains of its file.
struct Robot<'a> {
    folder: &'a Path,
    base: &'a str,
    tips: &'a [&'a str],
    /// How many joints all chains share.
    trunk: usize,
    real: Vec<Real>,
    nominal: Vec<JointPath>,
}

impl<'a> Robot<'a> {
    fn new(folder: &'a Path, urdf: &str, base: &'a str, tips: &'a [&'a str], trunk: usize) -> Self {
        let file = folder.join("robot.urdf");
        std::fs::write(&file, urdf).expect("written");
        let real = |(tip, seed): (&&str, u64)| Real::new(&format!("{}#{base}:{tip}", file.display()), seed);
        let mut real: Vec<Real> = tips.iter().zip(7..).map(real).collect();
        let shared = real[0].path.joints[..trunk].to_vec();
        for real in &mut real {
            real.path.joints[..trunk].clone_from_slice(&shared);
        }
        let nominal = tips.iter().map(|tip| chain(&file, base, tip)).collect();
        Self {
            folder,
            base,
            tips,
            trunk,
            real,
            nominal,
        }
    }

    /// The options that name all tips and their tables, `TIP.csv`.
    fn arguments(&self) -> Vec<String> {
        let mut all = vec![
            "--robot".to_owned(),
            format!("robot.urdf#{}:{}", self.base, self.tips.join(",")),
        ];
        for tip in self.tips {
            all.extend(["--data".to_owned(), format!("{tip}.csv")]);
        }
        all
    }

    fn written(&self, out: &str, tips: &[String]) -> Vec<JointPath> {
        let file = self.folder.join(out).join("calibrated.urdf");
        tips.iter().map(|tip| chain(&file, self.base, tip)).collect()
    }

    /// Identifies all tips from 150 rows of each. Fails if a tip of calibrated.urdf is further from new rows, in one frame of all
    /// tips, than 1.1 times what plain least squares over all rows finds, or if yourdfpy finds a tip elsewhere. Returns the
    /// rows, the new rows and the chains that were written.
    fn together(&mut self) -> (Vec<Rows>, Vec<Rows>, Vec<JointPath>) {
        let rows: Vec<Rows> = self.real.iter_mut().map(|real| real.measured(150)).collect();
        let new: Vec<Rows> = self.real.iter_mut().map(|real| real.rows(200)).collect();
        for (k, tip) in self.tips.iter().enumerate() {
            write(self.folder, &format!("{tip}.csv"), &self.nominal[k], &rows[k]);
        }
        let arguments = self.arguments();
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let (code, said) = identify(self.folder, &[&arguments[..], &["--out", "out"]].concat());
        // A head alone may be as good with its nominal geometry, and its verdict says so.
        assert!(code == Some(0) || code == Some(3) && self.tips.len() > 2, "{said}");
        let tcps: Vec<String> = self.tips.iter().map(|tip| format!("{tip}_tcp")).collect();
        let written = self.written("out", &tcps);
        for other in &written {
            assert_eq!(other.joints[..self.trunk], written[0].joints[..self.trunk]);
        }
        let found = errors_m(&new, |limb, q| point(&written[limb], q, &Vector3::zeros()));
        let fitted = plain_fit(&self.nominal, self.trunk, &rows);
        let plain = errors_m(&new, |limb, q| point(&fitted[limb].0, q, &fitted[limb].1));
        let before = errors_m(&new, |limb, q| point(&self.nominal[limb], q, &TOOL_M.into()));
        for (k, tip) in self.tips.iter().enumerate() {
            println!(
                "{tip}: {:.4} mm, plain least squares {:.4} mm, nominal {:.2} mm",
                found[k] * 1e3,
                plain[k] * 1e3,
                before[k] * 1e3
            );
            by_yourdfpy(self.folder, &written[k], (self.base, &tcps[k]), &new[k]);
            let summary = std::fs::read_to_string(self.folder.join("out").join(tip).join("summary.json"));
            assert!(
                summary.is_ok_and(|text| text.contains(&format!("talos {tip}: "))),
                "{tip}"
            );
        }
        for (found, plain) in found.iter().zip(&plain) {
            assert!(*found < 1.1 * plain, "{found:?} {plain:?}");
        }
        (rows, new, written)
    }
}

// Fails as `Robot::together` says, or if a tip is further from new rows than after calibrating the torso with one arm and then
// the other arm.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_two_arms_on_a_torso_are_identified_together() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let mut robot = Robot::new(folder, &two_arms(), "base_link", &["left_tool", "right_tool"], 1);
    let (rows, new, written) = robot.together();
    // The torso with one arm, then the other arm in rows in which the torso rests.
    let mut resting = rows[1].clone();
    for (q, at) in &mut resting {
        *at += robot.real[1].at(&[&[0.0], &q[1..]].concat()) - robot.real[1].at(q);
        q[0] = 0.0;
    }
    write(folder, "resting.csv", &robot.nominal[1], &resting);
    for [robot, data, out] in [
        ["robot.urdf#base_link:left_tool", "left_tool.csv", "first"],
        ["first/calibrated.urdf#torso_link:right_tool", "resting.csv", "second"],
    ] {
        let (code, said) = identify(folder, &["--robot", robot, "--data", data, "--out", out]);
        assert_eq!(code, Some(0), "{said}");
    }
    let steps = robot.written("second", &["talos_tcp", "calibrated_talos_tcp"].map(str::to_owned));
    let errors = |tips: &[JointPath]| errors_m(&new, |limb, q| point(&tips[limb], q, &Vector3::zeros()));
    let (found, stepped) = (errors(&written), errors(&steps));
    // Each tip in a frame of its own, too.
    let own = |tips: &[JointPath]| [0, 1].map(|k| error_m(&new[k], |q| point(&tips[k], q, &Vector3::zeros())));
    println!(
        "together {found:?} m, in two steps {stepped:?} m; each in its own frame {:?} m, in two steps {:?} m",
        own(&written),
        own(&steps)
    );
    assert!(found[0] < stepped[0] && found[1] < stepped[1], "{found:?} {stepped:?}");
}

// Fails as `Robot::together` says, for two arms and a camera in the head, on a torso of two joints on a rail.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_two_arms_and_a_head_are_identified_together() {
    let folder = tempfile::tempdir().expect("a folder");
    let tips = ["wrist_left_tool_link", "wrist_right_tool_link", "camera_link"];
    Robot::new(folder.path(), &humanoid(true), "world", &tips, 3).together();
}

// Fails if tables that are not in one frame are fitted together, or if a number of tips, an option or a chain that cannot be
// meant is taken, or refused without what to do.
#[test]
fn tips_that_do_not_belong_together_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let mut robot = Robot::new(folder, &two_arms(), "base_link", &["left_tool", "right_tool"], 1);
    let left = robot.real[0].measured(60);
    let mut right = robot.real[1].measured(60);
    write(folder, "left_tool.csv", &robot.nominal[0], &left);
    // The instrument stood elsewhere.
    for (_, at) in &mut right {
        at.x += 300.0 * NOISE_M;
    }
    write(folder, "right_tool.csv", &robot.nominal[1], &right);
    let both = robot.arguments();
    let both: Vec<&str> = both.iter().map(String::as_str).collect();
    let refused = |arguments: &[&str], words: &[&str]| {
        let (code, said) = identify(folder, arguments);
        assert_eq!(code, Some(2), "{said}");
        assert!(words.iter().all(|word| said.contains(word)), "{said}");
        assert!(!folder.join("spherecal-out").exists());
    };
    refused(&both, &["together", "measure all tips in one frame of the instrument"]);
    refused(&[&both[..], &["--json"]].concat(), &["--json: is for one table"]);
    refused(
        &[&both[..], &["--data", "left_tool.csv"]].concat(),
        &["the tips are 2 and the tables of --data 3"],
    );
    let other = |robot: &'static str| [&["--robot", robot], &both[2..]].concat();
    refused(
        &other("robot.urdf#base_link:left_tool"),
        &["the tips are 1 and the tables of --data 2"],
    );
    refused(
        &both[..4],
        &["the tips are 2 and the tables of --data 1", "a tip for each table"],
    );
    refused(&other("robot.urdf#base_link:left_tool,torso_link"), &["torso_link"]);
    refused(&other("ur5e#left_tool,right_tool"), &["ur5e"]);
    refused(&other("robot.urdf#left_tool:right_tool,base_link"), &["base link"]);
}
