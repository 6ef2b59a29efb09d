//! Every source of docs/sources.md with a small file, and tables with the mistakes that people make.

use std::path::Path;

use rand::{RngExt as _, SeedableRng as _};
use serde_json::Value;
use spherecal::model::Pose;
use spherecal::model::robots::frames::{compose, from_rpy};
use spherecal::model::robots::{self, RobotModel};

use crate::support::{spherecal, text};

const TOOL_M: [f64; 3] = [0.02, 0.01, 0.12];

/// Rows of an arm whose joints' zeros are off by some mrad: joint columns, and the measured pose.
pub(crate) fn rows(model: &RobotModel, count: usize) -> Vec<(Vec<f64>, Pose<f64>)> {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(11);
    let mut path = model.joint_path().expect("a path");
    for joint in &mut path.joints {
        joint.offset += random.random_range(-3e-3..3e-3);
    }
    let base = Pose {
        rotation: from_rpy([0.02, -0.01, 2.1]),
        position: [2.0, -1.0, 0.5].into(),
    };
    let tool = Pose {
        rotation: from_rpy([0.3, 0.2, 0.1]),
        position: TOOL_M.into(),
    };
    (0..count)
        .map(|_| {
            let q: Vec<f64> = path.columns.iter().map(|_| random.random_range(-1.3..1.3)).collect();
            let mut at = compose(&compose(&base, &path.frames(&path.positions(&q)).tip), &tool);
            for k in 0..3 {
                at.position[k] += random.random_range(-5e-5..5e-5);
            }
            (q, at)
        })
        .collect()
}

/// A table of cells: the joints times `angle`, then what `measured` writes.
pub(crate) fn table(
    header: &str,
    rows: &[(Vec<f64>, Pose<f64>)],
    separator: &str,
    angle: f64,
    measured: impl Fn(&Pose<f64>) -> Vec<f64>,
) -> String {
    let mut out = format!("{header}\n");
    for (q, at) in rows {
        let cells: Vec<String> = q
            .iter()
            .map(|q| q * angle)
            .chain(measured(at))
            .map(|v| v.to_string())
            .collect();
        out += &(cells.join(separator) + "\n");
    }
    out
}

pub(crate) fn mm(at: &Pose<f64>) -> Vec<f64> {
    at.position.iter().map(|x| x * 1e3).collect()
}

/// Runs `identify`: its exit code, what it printed, and its error.
pub(crate) fn identify(folder: &Path, data: &str, robot: &str, more: &[&str]) -> (Option<i32>, String, String) {
    std::fs::write(folder.join("t.csv"), data).expect("written");
    let given = [
        "identify",
        "--robot",
        robot,
        "--data",
        "t.csv",
        "--tool-mm",
        "20,10,120",
        "--out",
        "out",
    ];
    let output = spherecal(folder, &[&given, more].concat());
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

/// A message in CDR: its header, then what `rest` writes; numbers are aligned to their size.
fn cdr(time_ns: i64, frame: &str, rest: impl Fn(&mut Vec<u8>)) -> Vec<u8> {
    let mut body = Vec::new();
    whole(&mut body, (time_ns / 1_000_000_000) as u32);
    whole(&mut body, (time_ns % 1_000_000_000) as u32);
    word(&mut body, frame);
    rest(&mut body);
    [vec![0, 1, 0, 0], body].concat()
}

fn whole(body: &mut Vec<u8>, value: u32) {
    body.resize(body.len().next_multiple_of(4), 0);
    body.extend(value.to_le_bytes());
}

fn word(body: &mut Vec<u8>, text: &str) {
    whole(body, text.len() as u32 + 1);
    body.extend(text.as_bytes());
    body.push(0);
}

fn number(body: &mut Vec<u8>, value: f64) {
    body.resize(body.len().next_multiple_of(8), 0);
    body.extend(value.to_le_bytes());
}

/// A bag in SQLite: at each row the arm rests for half a second, with a measured point in the middle.
fn write_bag(file: &Path, joints: &[&str], rows: &[(Vec<f64>, Pose<f64>)]) {
    use sqlx::ConnectOptions as _;
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let options = sqlx::sqlite::SqliteConnectOptions::new()
        .filename(file)
        .create_if_missing(true);
    let mut bag = runtime.block_on(options.connect()).expect("a bag");
    for statement in [
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, offered_qos_profiles TEXT)",
        "INSERT INTO topics VALUES (1, '/joint_states', 'sensor_msgs/msg/JointState', 'cdr', ''), \
         (2, '/point', 'geometry_msgs/msg/PointStamped', 'cdr', '')",
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)",
        "BEGIN",
    ] {
        runtime
            .block_on(sqlx::query(statement).execute(&mut bag))
            .expect("made");
    }
    let mut put = |topic: i64, time_ns: i64, data: Vec<u8>| {
        let insert = sqlx::query("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)");
        let insert = insert.bind(topic).bind(time_ns).bind(data);
        runtime.block_on(insert.execute(&mut bag)).expect("inserted");
    };
    for (k, (q, at)) in (0_i64..).zip(rows) {
        for step in 0..6 {
            let time_ns = 1_000_000_000 * (1 + k) + 100_000_000 * step;
            let state = cdr(time_ns, "", |body| {
                whole(body, joints.len() as u32);
                for name in joints {
                    word(body, name);
                }
                whole(body, q.len() as u32);
                for q in q {
                    number(body, *q);
                }
                whole(body, 0);
                whole(body, 0);
            });
            put(1, time_ns, state);
            if step == 3 {
                let point = cdr(time_ns, "tracker", |body| {
                    for x in &at.position {
                        number(body, *x);
                    }
                });
                put(2, time_ns, point);
            }
        }
    }
    runtime
        .block_on(sqlx::query("COMMIT").execute(&mut bag))
        .expect("written");
    runtime.block_on(sqlx::Connection::close(bag)).expect("closed");
}

/// The estimates of a result.
fn parameters(folder: &Path) -> Vec<(String, f64)> {
    let summary = std::fs::read_to_string(folder.join("out/summary.json")).expect("a summary");
    let summary: Value = serde_json::from_str(&summary).expect("JSON");
    let all = summary["parameters"].as_array().expect("parameters");
    let one = |p: &Value| {
        (
            p["name"].as_str().unwrap_or_default().to_owned(),
            p["estimate"].as_f64().unwrap_or_default(),
        )
    };
    all.iter().map(one).collect()
}

// Fails if a table that says the same in other words gives another robot, or is refused. Each is a source of docs/sources.md.
#[test]
fn tables_of_any_kind_give_the_same_robot() {
    let folder = tempfile::tempdir().expect("a folder");
    let model = robots::built_in("ur5e").expect("built in");
    let rows = rows(&model, 40);
    let plain = table("q1,q2,q3,q4,q5,q6,x_mm,y_mm,z_mm", &rows, ",", 1.0, mm);
    let (code, _, error) = identify(folder.path(), &plain, "ur5e", &[]);
    assert!(matches!(code, Some(0 | 3)), "{error}");
    let expected = parameters(folder.path());
    let header = |words: &str| plain.replacen("q1,q2,q3,q4,q5,q6,x_mm,y_mm,z_mm", words, 1);
    let bare: String = plain.lines().skip(1).map(|l| format!("{l}\n")).collect();
    let with_nan = plain.replacen('\n', "\n0,0,0,0,0,0,nan,nan,nan\n", 1);
    let rtde = header("q1,q2,q3,q4,q5,q6,x_mm,y_mm,z_mm")
        .replace(
            "q1,q2,q3,q4,q5,q6",
            "actual_q_0,actual_q_1,actual_q_2,actual_q_3,actual_q_4,actual_q_5",
        )
        .replace(',', " ");
    for (data, more) in [
        (header("q0,q1,q2,q3,q4,q5,x_mm,y_mm,z_mm"), &[][..]),
        (
            format!("# q1 q2 q3 q4 q5 q6 x_mm y_mm z_mm\n{}", bare.replace(',', " ")),
            &[],
        ),
        (bare.clone(), &["--columns", "joints=1,2,3,4,5,6", "point_mm=7,8,9"]),
        (
            header("a,b,c,d,e,f,X,Y,Z"),
            &["--columns", "joints=a,b,c,d,e,f", "point_mm=X,Y,Z"],
        ),
        (with_nan, &[]),
        (rtde, &[]),
        (header("q2,q1,q3,q4,q5,q6,x_mm,y_mm,z_mm"), &["--order", "2,1,3,4,5,6"]),
    ] {
        let (code, _, error) = identify(folder.path(), &data, "ur5e", more);
        assert!(matches!(code, Some(0 | 3)), "{more:?}: {error}");
        let found = parameters(folder.path());
        assert_eq!(found.len(), expected.len());
        for (a, b) in found.iter().zip(&expected) {
            assert!(a.0 == b.0 && (a.1 - b.1).abs() < 1e-12, "{more:?}: {a:?} {b:?}");
        }
    }
}

// Fails if a mistake is not named where the table does not fit, or the option that is named does not put it right.
#[test]
fn mistakes_are_named_with_the_option_that_corrects_them() {
    let folder = tempfile::tempdir().expect("a folder");
    let model = robots::built_in("ur5e").expect("built in");
    let sound = rows(&model, 40);
    let header = "q1,q2,q3,q4,q5,q6,x_mm,y_mm,z_mm";
    let changed = |change: &dyn Fn(&mut Vec<f64>)| {
        let mut rows = sound.clone();
        for row in &mut rows {
            change(&mut row.0);
        }
        table(header, &rows, ",", 1.0, mm)
    };
    for (data, options) in [
        (changed(&|q| q[3] = -q[3]), &["--flip", "4"][..]),
        (changed(&|q| q.swap(1, 2)), &["--order", "1,3,2,4,5,6"]),
        (changed(&|q| q[2] -= q[1]), &["--couple", "3=q3+q2"]),
        (
            changed(&|q| q[1] -= std::f64::consts::FRAC_PI_2),
            &["--zero-deg", "2=90"],
        ),
        (
            table(header, &sound, ",", 1.0, |at| mm(at).iter().map(|x| x / 25.4).collect()),
            &["--point-factor", "25.4"],
        ),
    ] {
        let (code, said, error) = identify(folder.path(), &data, "ur5e", &[]);
        assert_eq!(code, Some(2), "{options:?}: {said}{error}");
        assert!(error.contains(&options.join(" ")), "{options:?}: {error}");
        let (code, out, error) = identify(folder.path(), &data, "ur5e", options);
        assert!(matches!(code, Some(0 | 3)), "{options:?}: {error}");
        assert!(out.contains("corrected as asked"), "{out}");
    }
    let (code, out, error) = identify(folder.path(), &changed(&|_| {}), "ur5e", &["--explain"]);
    assert_eq!(code, Some(0), "{error}");
    assert!(out.contains("as they are"), "{out}");
    for (options, words) in [
        (&["--flip", "7"][..], "the robot has 6 joint columns"),
        (&["--order", "1,2"], "name each of the 6 joint columns once"),
        (&["--couple", "3=x"], "write JOINT=qA+qB"),
        (&["--zero-deg", "3"], "write JOINT=VALUE"),
        (&["--joint-unit", "3=inch"], "JOINT=deg or JOINT=rad"),
    ] {
        let (code, _, error) = identify(folder.path(), &changed(&|_| {}), "ur5e", options);
        assert!(code == Some(2) && error.contains(words), "{options:?}: {error}");
    }
}

// Fails if a table of a moving arm, measured 30 ms late, is identified as it is, if the delay is not named with its option, or if
// the option does not put the table right.
#[test]
fn the_delay_of_a_moving_arm_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let model = robots::built_in("ur5e").expect("built in");
    let path = model.joint_path().expect("a path");
    let at = |time: f64| -> Vec<f64> {
        (0..6)
            .map(|k| f64::from(k) * 0.3 - 0.8 + 0.7 * ((0.2 + 0.05 * f64::from(k)) * time).sin())
            .collect()
    };
    let row = |k: i32| {
        let time = 0.05 * f64::from(k);
        let mut flange = path.frames(&at(time - 0.03)).tip;
        // No controller's own numbers: the hand shakes by up to 0.15 mm.
        flange.position[0] += 5e-5 * f64::from(k * k % 7 - 3);
        flange.position = flange.point(&[0.02, 0.01, 0.12].into());
        (at(time), flange)
    };
    let rows: Vec<_> = (0..600).map(row).collect();
    let data = table("q1,q2,q3,q4,q5,q6,x_mm,y_mm,z_mm", &rows, ",", 1.0, mm);
    let (code, said, error) = identify(folder.path(), &data, "ur5e", &[]);
    assert_eq!(code, Some(2), "{said}{error}");
    assert!(error.contains("rows late"), "{error}");
    let option = error
        .split_once("`--shift-rows ")
        .and_then(|(_, rest)| rest.split_once('`'));
    let rows = option.expect("an option").0;
    assert!((rows.parse::<f64>().expect("rows") - 0.6).abs() < 0.05, "{error}");
    let (code, said, error) = identify(folder.path(), &data, "ur5e", &["--shift-rows", rows, "--explain"]);
    assert_eq!(code, Some(0), "{said}{error}");
    assert!(!said.contains("--shift-rows") && said.contains("as they are"), "{said}");
}

// Fails if an arm on a torso, a rail or a SCARA with its slide is cut or refused, if its hinges are not calibrated, or if the
// file that is written loses anything.
#[test]
fn an_arm_with_a_slide_is_identified() {
    let folder = tempfile::tempdir().expect("a folder");
    let joint = |name: &str, kind: &str, k: usize, axis: &str| {
        format!(
            "<link name=\"l{}\"/>\n<joint name=\"{name}\" type=\"{kind}\"><origin xyz=\"0.05 0.02 0.25\"/><parent link=\"l{k}\"/><child \
             link=\"l{}\"/><axis xyz=\"{axis}\"/><limit lower=\"-2\" upper=\"2\" velocity=\"1\" effort=\"10\"/></joint>\n",
            k + 1,
            k + 1
        )
    };
    let kinds = [
        ("lift", "prismatic", "0 0 1"),
        ("j1", "revolute", "0 0 1"),
        ("j2", "revolute", "0 1 0"),
        ("j3", "revolute", "0 1 0"),
        ("j4", "revolute", "1 0 0"),
        ("j5", "revolute", "0 1 0"),
        ("j6", "revolute", "1 0 0"),
    ];
    let mut urdf = "<robot name=\"torso\">\n<link name=\"l0\"/>\n".to_owned();
    for (k, (name, kind, axis)) in kinds.into_iter().enumerate() {
        urdf += &joint(name, kind, k, axis);
    }
    urdf += "<link name=\"head\"/><joint name=\"head_pan\" type=\"revolute\"><parent link=\"l1\"/><child link=\"head\"/><axis xyz=\"0 0 1\"/></joint>\n</robot>\n";
    std::fs::write(folder.path().join("torso.urdf"), &urdf).expect("written");
    let show = text(&spherecal(folder.path(), &["robot", "show", "torso.urdf"]).stdout);
    for words in [
        "lift (slides), j1",
        "slides along (0.0000, 0.0000, 1.0000)",
        "not on the chain: head_pan (revolute, on l1)",
    ] {
        assert!(show.contains(words), "{words}: {show}");
    }
    let run = spherecal(folder.path(), &["run", "--robot", "torso.urdf"]);
    let refused = text(&run.stderr);
    assert!(
        run.status.code() == Some(2) && refused.contains("joint \"lift\": type is \"prismatic\""),
        "{refused}"
    );
    let model = robots::load_path(&folder.path().join("torso.urdf").display().to_string()).expect("a robot");
    let recorded = rows(&model, 80);
    let data = table("lift,j1,j2,j3,j4,j5,j6,x_mm,y_mm,z_mm", &recorded, ",", 1.0, mm);
    let (code, _, error) = identify(folder.path(), &data, "torso.urdf", &[]);
    assert!(matches!(code, Some(0 | 3)), "{error}");
    assert!(error.contains("the arm is l0 - lift (slides), j1"), "{error}");
    let offset = parameters(folder.path());
    assert!(
        offset.iter().any(|p| p.0.contains("theta") || p.0.contains("offset")),
        "{offset:?}"
    );
    let out = std::fs::read_to_string(folder.path().join("out/calibrated.urdf")).expect("a URDF");
    assert!(out.contains("head_pan") && out.contains("type=\"prismatic\""), "{out}");
    // A bag of the same rests says the same. It has no columns to name.
    let joints = ["j6", "lift", "j1", "j2", "j3", "j4", "j5"];
    let turned: Vec<_> = recorded
        .iter()
        .map(|(q, at)| ([&q[6..], &q[..6]].concat(), *at))
        .collect();
    write_bag(&folder.path().join("rests.db3"), &joints, &turned);
    let bag = [
        "identify",
        "--robot",
        "torso.urdf",
        "--data",
        "rests.db3",
        "--tool-mm",
        "20,10,120",
        "--out",
        "out",
    ];
    let said = spherecal(folder.path(), &bag);
    assert!(matches!(said.status.code(), Some(0 | 3)), "{}", text(&said.stderr));
    let of_bag = parameters(folder.path());
    assert_eq!(of_bag.len(), offset.len());
    for (a, b) in of_bag.iter().zip(&offset) {
        assert!(a.0 == b.0 && (a.1 - b.1).abs() < 1e-9, "{a:?} {b:?}");
    }
    for option in [
        ["--columns", "joints=a,b"].as_slice(),
        &["--ignore-rest"],
        &["--ignore-columns", "time"],
    ] {
        let said = spherecal(folder.path(), &[&bag, option].concat());
        let error = text(&said.stderr);
        assert!(
            said.status.code() == Some(2) && error.contains("a bag has no columns"),
            "{option:?}: {error}"
        );
    }
    // The chain behind the slide is a plain arm, named by its base.
    let shown = spherecal(folder.path(), &["robot", "show", "torso.urdf#l1:l7", "--json"]);
    let shown: Value = serde_json::from_slice(&shown.stdout).expect("JSON");
    assert_eq!(shown["chain"].as_array().map(Vec::len), Some(6));
    assert_eq!(shown["root"], "l1");
}
