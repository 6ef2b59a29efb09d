//! What goes wrong with users' files: every mistake ends with exit code 2, before
//! anything is computed, and says which file, field and value, and what to do.

use std::path::Path;

use spherecal::model::robots;

use crate::field::table;
use crate::support::{spherecal, text};

/// One mistake: what it is, how the file is written, and what the message says.
struct Mistake {
    what: &'static str,
    /// Name and content of the file that is wrong.
    file: (&'static str, Vec<u8>),
    /// Arguments after `identify --out o`.
    arguments: &'static [&'static str],
    parts: &'static [&'static str],
}

const TABLE: &[&str] = &["--robot", "ur5e", "--data", "bad.csv"];
const PLATE: &[&str] = &["--robot", "ur5e", "--data", "contacts.csv", "--plate", "bad.toml"];
const ROBOT_TOML: &[&str] = &["--robot", "bad.toml", "--data", "good.csv"];
const ROBOT_URDF: &[&str] = &["--robot", "bad.urdf", "--data", "good.csv"];
const ROBOT_YAML: &[&str] = &["--robot", "bad.yaml", "--data", "good.csv"];

fn of_table(what: &'static str, content: impl Into<Vec<u8>>, parts: &'static [&'static str]) -> Mistake {
    Mistake {
        what,
        file: ("bad.csv", content.into()),
        arguments: TABLE,
        parts,
    }
}

fn with(
    arguments: &'static [&'static str],
    what: &'static str,
    file: &'static str,
    content: impl Into<Vec<u8>>,
    parts: &'static [&'static str],
) -> Mistake {
    Mistake {
        what,
        file: (file, content.into()),
        arguments,
        parts,
    }
}

/// The table of mistakes; `good` is a table that is read.
fn mistakes(good: &str) -> Vec<Mistake> {
    let edit = |from: &str, to: &str| {
        assert!(good.contains(from), "{from}");
        good.replacen(from, to, 1)
    };
    let first = good.lines().nth(1).expect("a row");
    let cell = first.split(',').next().expect("a cell");
    let row = |to: &str| good.replacen(first, to, 1);
    let column = |k: usize, f: &dyn Fn(f64) -> String| {
        let lines = good.lines().enumerate().map(|(n, line)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if n > 0 {
                cells[k] = f(cells[k].parse().expect("a number"));
            }
            cells.join(",")
        });
        lines.collect::<Vec<_>>().join("\n")
    };
    let all = |name: &str, columns: std::ops::Range<usize>, scale: f64| {
        let lines = good.lines().enumerate().map(|(n, line)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            for cell in &mut cells[columns.clone()] {
                *cell = match n {
                    0 => cell.replace(name, ""),
                    _ => (cell.parse::<f64>().expect("a number") * scale).to_string(),
                };
            }
            cells.join(",")
        });
        lines.collect::<Vec<_>>().join("\n")
    };
    let sphere =
        |id: u32, x: &str, more: &str| format!("[[sphere]]\nid = {id}\nx_mm = {x}\ny_mm = 0\nz_mm = 0\n{more}\n");
    let toml = robots::toml_file::write(&robots::load("ur5e").expect("built in"), &[]);
    let model = robots::load("ur5e").expect("built in");
    let yaml = robots::write_kinematics_yaml(&model, &model.rows(), &[]);
    let urdf = robots::write_urdf(&model, &model.rows(), &[]);
    let attributes: String = (0..100_000).map(|k| format!(" a{k}=\"\"")).collect();
    let utf16: Vec<u8> = good.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let mut binary = good.as_bytes().to_vec();
    binary[good.len() / 2] = 0xff;
    vec![
        of_table("an empty file", "", &["no header line", "q1,q2"]),
        of_table(
            "a header alone",
            good.lines().next().expect("a header"),
            &["no rows", "one row per pose"],
        ),
        of_table(
            "no header",
            good.split_once('\n').expect("lines").1,
            &["holds numbers, not names", "q1..q6"],
        ),
        of_table(
            "a misspelt column",
            edit("x_mm", "x_nm"),
            &["\"x_nm\" is not known", "did you mean \"x_mm\"?", "--ignore-columns"],
        ),
        of_table(
            "a column without its unit",
            edit("x_mm,y_mm,z_mm", "x,y,z"),
            &["\"x\", \"y\", \"z\" are not known", "no unit", "x_mm or x_m"],
        ),
        of_table("a column twice", edit("q2", "Q1"), &["\"q1\" and \"Q1\" say the same"]),
        of_table("a joint is missing", edit("q3", "tau1"), &["q3 is missing", "6 joints"]),
        of_table(
            "a joint too many",
            edit("x_mm,y_mm,z_mm", "q7,sphere,place"),
            &["q7", "6 joints"],
        ),
        of_table("an axis is missing", edit("z_mm", "sphere"), &["z_mm is missing"]),
        of_table(
            "nothing is measured",
            edit("x_mm,y_mm,z_mm", "tau1,tau2,tau3"),
            &["tau4 is missing"],
        ),
        of_table(
            "a cell is empty",
            edit(cell, ""),
            &["row 1 (line 2)", "column q1 is \"\"", "write a number"],
        ),
        of_table(
            "a cell is text",
            edit(cell, "home"),
            &["row 1 (line 2)", "\"home\"", "write a number"],
        ),
        of_table(
            "not a number",
            edit(cell, "NaN"),
            &["row 1 (line 2)", "\"NaN\"", "finite"],
        ),
        of_table("infinite", edit(cell, "-inf"), &["\"-inf\"", "finite"]),
        of_table("a formula that failed", edit(cell, "#DIV/0!"), &["#DIV/0!", "formula"]),
        of_table(
            "a thousands separator",
            edit(cell, "\"1,234\""),
            &["\"1,234\"", "decimal point"],
        ),
        of_table(
            "decimal commas and points mixed",
            row(&first.replace(',', ";").replacen('.', ",", 1))
                .replace("q1,q2,q3,q4,q5,q6,x_mm,y_mm,z_mm", "q1;q2;q3;q4;q5;q6;x_mm;y_mm;z_mm"),
            &["row 1 (line 2)", "mixed"],
        ),
        of_table(
            "a row too short",
            row(&first[..first.rfind(',').expect("cells")]),
            &["row 1 has 8 cells, the header has 9"],
        ),
        of_table(
            "a row too long",
            row(&format!("{first},7")),
            &["row 1 (line 2)", "\"7\"", "the header has 9 columns"],
        ),
        of_table(
            "a quote left open",
            edit(cell, &format!("\"{cell}")),
            &["line 2", "quote", "partner"],
        ),
        of_table("degrees as radians", all("_deg", 0..6, 57.3), &["column q", "_deg"]),
        of_table(
            "radians as degrees",
            all("", 0..6, 1.0).replacen("q1,q2,q3,q4,q5,q6", "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg", 1),
            &["no angle of the table is beyond", "radians"],
        ),
        of_table(
            "metres as millimetres",
            all("", 6..9, 1e-3),
            &["no coordinate of the table is beyond", "x_m"],
        ),
        of_table(
            "metres as millimetres, far from the tracker",
            column(6, &|x| (3000.0 + x * 1e-3).to_string())
                .lines()
                .map(std::borrow::ToOwned::to_owned)
                .enumerate()
                .map(|(n, l)| {
                    let mut c: Vec<String> = l.split(',').map(str::to_owned).collect();
                    if n > 0 {
                        for cell in &mut c[7..9] {
                            *cell = (cell.parse::<f64>().expect("a number") * 1e-3).to_string();
                        }
                    }
                    c.join(",")
                })
                .collect::<Vec<_>>()
                .join("\n"),
            &["spread of the measured points", "are metres"],
        ),
        of_table(
            "a point in kilometres",
            edit(&format!(",{}", first.rsplit(',').next().expect("z")), ",512345678"),
            &["z_mm", "more than 100 m", "unit"],
        ),
        of_table(
            "an unknown set",
            row(first)
                .replacen("z_mm", "z_mm,set", 1)
                .replacen(first, &format!("{first},test"), 1),
            &["calibrate or validate"],
        ),
        of_table(
            "a sphere by name",
            "q1,q2,q3,q4,q5,q6,sphere\n0,0,0,0,0,0,front\n",
            &["column sphere is \"front\"", "integer id"],
        ),
        of_table(
            "a placement per row",
            "q1,q2,q3,q4,q5,q6,sphere,place\n".to_owned()
                + &(0..300)
                    .map(|k| format!("0,0,0,0,0,0.{k},1,p{k}\n"))
                    .collect::<String>(),
            &[
                "300 values in the column place",
                "at most 200",
                "--ignore-columns place",
            ],
        ),
        of_table(
            "a second target that one row saw",
            "q1,q2,q3,q4,q5,q6,x1_mm,y1_mm,z1_mm,x2_mm,y2_mm,z2_mm\n".to_owned()
                + "0,0,0,0,0,0.9,100,2,3,1,2,30\n"
                + &(0..5)
                    .map(|k| format!("0,0,0,0,0,0.{k},10{k},2,3,,,\n"))
                    .collect::<String>(),
            &["target 2 is in 1 rows", "at least 3", "--ignore-columns"],
        ),
        of_table(
            "several targets beside spheres",
            "q1,q2,q3,q4,q5,q6,x1_mm,y1_mm,z1_mm,sphere\n".to_owned() + &"0,0,0,0,0,0,100,2,3,\n".repeat(5),
            &["a column sphere", "a table of their own"],
        ),
        of_table(
            "a quaternion that is none",
            "q1,q2,q3,q4,q5,q6,x_mm,y_mm,z_mm,qw,qx,qy,qz\n0,0,0,0,0,0,1,2,3,1,1,0,0\n",
            &["row 1", "length 1.4142", "length 1"],
        ),
        of_table(
            "a spreadsheet's own file",
            b"PK\x03\x04xl/worksheets".to_vec(),
            &["spreadsheet", "CSV UTF-8"],
        ),
        of_table(
            "a compressed file",
            b"\x1f\x8b\x08rest".to_vec(),
            &["compressed", "unpack"],
        ),
        of_table("UTF-16 without its mark", utf16, &["UTF-16", "UTF-8"]),
        of_table("bytes that are no text", binary, &["is not UTF-8", "line"]),
        of_table(
            "one endless line",
            "7".repeat(100_000),
            &["line 1", "longer than 65536 bytes"],
        ),
        of_table("escape sequences", edit("x_mm", "\u{1b}[2Jx_mm"), &["\\u001b[2jx_mm"]),
        with(
            &["--robot", "ur5e", "--data", "good.csv", "--joint-columns", "a,b"],
            "too few joint columns",
            "x",
            "",
            &["--joint-columns is 2 names", "6 joints"],
        ),
        with(
            &["--robot", "ur5e", "--data", "good.csv", "--method", "map"],
            "the old name of a method",
            "x",
            "",
            &["map", "give `full`"],
        ),
        with(
            &["--robot", "ur5e", "--data", "contacts.csv"],
            "contacts without a plate",
            "x",
            "",
            &["--plate", "no scale", "--plate paper"],
        ),
        with(
            &["--robot", "ur5e", "--data", "good.csv", "--holdout", "shift"],
            "an unknown hold-out",
            "x",
            "",
            &["column \"shift\"", "not in the table"],
        ),
        with(
            &["--robot", "ur5e", "--data", "good.csv", "--tool-mm", "1,2"],
            "half a tool",
            "x",
            "",
            &["--tool-mm is \"1,2\"", "three numbers"],
        ),
        with(
            &["--robot", "ur5e", "--data", "none.csv"],
            "no such table",
            "x",
            "",
            &["none.csv: there is no such file"],
        ),
        with(
            &["--robot", "ur5e", "--data", "."],
            "a directory",
            "x",
            "",
            &["is a folder without an MCAP file"],
        ),
        with(
            &["--robot", "ur5e", "--data", "/dev/zero"],
            "a device as a table",
            "x",
            "",
            &["/dev/zero: is a device"],
        ),
        with(
            &["--robot", "link.toml", "--data", "good.csv"],
            "a link to a device as a robot",
            "x",
            "",
            &["link.toml: is a device"],
        ),
        with(
            &["--robot", "ur6", "--data", "good.csv"],
            "an unknown robot",
            "x",
            "",
            &["\"ur6\" is neither built in nor a file", "did you mean ur5e?", "iiwa7"],
        ),
        with(
            &["--robot", "good.csv", "--data", "good.csv"],
            "a table as a robot",
            "x",
            "",
            &["good.csv: its name does not say what it is"],
        ),
        with(
            &["--robot", "ur5e", "--data", "good.csv", "--config", "bad.toml"],
            "unknown options",
            "bad.toml",
            "nois = 1\n",
            &["bad.toml: line 1: `nois` is not known here"],
        ),
        with(
            PLATE,
            "a plate without spheres",
            "bad.toml",
            "name = \"mine\"\n",
            &["0 spheres", "[[sphere]]"],
        ),
        with(
            PLATE,
            "a sphere twice",
            "bad.toml",
            sphere(1, "0", "") + &sphere(1, "9", ""),
            &["sphere id is 1", "twice"],
        ),
        with(
            PLATE,
            "a negative uncertainty",
            "bad.toml",
            sphere(1, "0", "sigma_mm = -0.002"),
            &["sphere 1: sigma_mm is -0.002", "1 sigma"],
        ),
        with(
            PLATE,
            "no uncertainty",
            "bad.toml",
            sphere(1, "0", "sigma_mm = 0"),
            &["sphere 1: sigma_mm is 0", "above 0"],
        ),
        with(
            PLATE,
            "spheres in one place",
            "bad.toml",
            sphere(1, "100", "") + &sphere(2, "100", ""),
            &["spheres 1 and 2 is 0.0000 mm", "same place"],
        ),
        with(
            PLATE,
            "a plate in metres",
            "bad.toml",
            sphere(1, "0", "") + &sphere(2, "0.3", ""),
            &["spheres 1 and 2 is 0.3000 mm", "x_m"],
        ),
        with(
            PLATE,
            "a coordinate in quotes",
            "bad.toml",
            sphere(1, "\"0\"", ""),
            &["line 3: found the text \"0\", expected a number"],
        ),
        with(
            PLATE,
            "a coordinate without its unit",
            "bad.toml",
            sphere(1, "0", "").replace("x_mm", "x"),
            &["line 3: `x` is not known here", "`x_mm`"],
        ),
        with(
            PLATE,
            "broken TOML",
            "bad.toml",
            "[[sphere]\n",
            &["bad.toml: line 1", "[[sphere]]"],
        ),
        with(
            ROBOT_TOML,
            "a robot's field misspelt",
            "bad.toml",
            toml.replacen("alpha =", "alfa =", 1),
            &["`alfa` is not known here", "`alpha`"],
        ),
        with(
            ROBOT_TOML,
            "limits the wrong way round",
            "bad.toml",
            toml.replacen("min_rad = -6", "min_rad = 9", 1),
            &["bad.toml: joint 1: max_rad"],
        ),
        with(
            ROBOT_URDF,
            "broken XML",
            "bad.urdf",
            urdf.replacen("</joint>", "", 1),
            &["bad.urdf: line", "not well-formed XML"],
        ),
        with(
            ROBOT_URDF,
            "a URDF in millimetres",
            "bad.urdf",
            urdf.replacen("0.1625", "162.5", 1),
            &["origin xyz", "162.5", "lengths are in m"],
        ),
        with(
            ROBOT_URDF,
            "an unexpanded xacro",
            "bad.urdf",
            urdf.replacen("0.1625", "${d1}", 1),
            &["${d1}", "xacro"],
        ),
        with(
            ROBOT_URDF,
            "a URDF with a document type",
            "bad.urdf",
            format!(
                "<!DOCTYPE robot [<!ENTITY a \"b\">]>{}",
                urdf.split_once("?>").expect("a declaration").1
            ),
            &["<!DOCTYPE", "remove"],
        ),
        with(
            ROBOT_URDF,
            "a URDF of attributes",
            "bad.urdf",
            format!("<robot{attributes}/>"),
            &["more than 64 attributes"],
        ),
        with(
            ROBOT_YAML,
            "a joint origin without z",
            "bad.yaml",
            yaml.replacen("    z: 0.1625\n", "", 1),
            &["shoulder: z is \"\"", "all six numbers"],
        ),
        with(
            ROBOT_YAML,
            "a joint origin in text",
            "bad.yaml",
            yaml.replacen("z: 0.1625", "z: tall", 1),
            &["shoulder: z is \"tall\"", "finite number"],
        ),
    ]
}

/// Files that are as they should be, beside those that are not.
fn prepare(folder: &Path) -> String {
    let good = table(&robots::load("ur5e").expect("built in"));
    std::fs::write(folder.join("good.csv"), &good).expect("written");
    let contacts = "q1,q2,q3,q4,q5,q6,sphere\n".to_owned() + &"0.1,-1,1,0,0,0,1\n".repeat(6);
    std::fs::write(folder.join("contacts.csv"), contacts).expect("written");
    #[cfg(unix)]
    std::os::unix::fs::symlink("/dev/zero", folder.join("link.toml")).expect("linked");
    good
}

// Fails if a mistake in a file is not refused with exit code 2, if the message
// does not name what is wrong and what to do, holds a control character or the
// words of a parser, or if anything is written to the output directory.
#[test]
fn every_mistake_in_a_file_is_named_with_its_remedy() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let good = prepare(folder);
    let mut wrong = Vec::new();
    for mistake in mistakes(&good) {
        std::fs::write(folder.join(mistake.file.0), &mistake.file.1).expect("written");
        let output = spherecal(folder, &[&["identify", "--out", "o"], mistake.arguments].concat());
        let said = text(&output.stderr);
        let code = output.status.code();
        let missing: Vec<_> = mistake.parts.iter().filter(|part| !said.contains(**part)).collect();
        let jargon = [
            "os error",
            "TOML parse error",
            "invalid type",
            "stream did not contain",
            "csv",
            "CSV error",
        ]
        .iter()
        .find(|words| said.replace(".csv", "").contains(**words) && **words != "csv");
        if code != Some(2)
            || !missing.is_empty()
            || jargon.is_some()
            || said.contains(|c: char| c.is_control() && c != '\n')
        {
            wrong.push(format!(
                "{}: exit {code:?}, lacks {missing:?}, jargon {jargon:?}: {said}",
                mistake.what
            ));
        }
        assert!(output.stdout.is_empty(), "{}: {}", mistake.what, text(&output.stdout));
        assert!(!folder.join("o").exists(), "{}", mistake.what);
    }
    assert!(wrong.is_empty(), "{} mistakes:\n{}", wrong.len(), wrong.join("\n"));
}

// Fails if a table that a spreadsheet would write gives another result than the
// plain one: the same numbers with decimal commas and semicolons in UTF-16, with
// the robot's own joint names in another order, with columns of the user's own.
#[test]
fn a_spreadsheet_s_table_gives_the_same_result() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let good = prepare(folder);
    let european = good.replace(',', ";").replace('.', ",");
    let utf16: Vec<u8> = std::iter::once(0xfeff)
        .chain(european.replace('\n', ";;\r\n").encode_utf16())
        .flat_map(u16::to_le_bytes)
        .collect();
    std::fs::write(folder.join("excel.csv"), utf16).expect("written");
    let named: String = good
        .lines()
        .enumerate()
        .map(|(n, line)| {
            let mut cells: Vec<&str> = line.split(',').collect();
            if n == 0 {
                let names = [
                    "shoulder_pan_joint",
                    "shoulder_lift_joint",
                    "Elbow_Joint",
                    "wrist_1_joint",
                    "wrist_2_joint",
                    "wrist_3_joint",
                ];
                cells[..6].copy_from_slice(&names);
            }
            cells.rotate_left(2);
            format!("{},{}\n", cells.join(","), if n == 0 { "operator" } else { "Kim" })
        })
        .collect();
    std::fs::write(folder.join("named.csv"), named).expect("written");
    let numbers = |arguments: &[&str]| {
        let common = ["identify", "--json", "--out", "o", "--robot", "ur5e", "--data"];
        let output = spherecal(folder, &[&common[..], arguments].concat());
        let summary: serde_json::Value =
            serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {}", text(&output.stderr)));
        (summary["recordings_sha256"].clone(), summary["parameters"].clone())
    };
    let plain = numbers(&["good.csv"]);
    assert_eq!(numbers(&["excel.csv"]), plain);
    assert_eq!(numbers(&["named.csv", "--ignore-columns", "operator"]), plain);
    let own = good.replacen("q1,q2,q3,q4,q5,q6", "a,b,c,d,e,f", 1);
    std::fs::write(folder.join("own.csv"), own).expect("written");
    assert_eq!(numbers(&["own.csv", "--joint-columns", "a,b,c,d,e,f"]), plain);
}

// Fails if an escape sequence in a name that a file holds reaches the terminal.
#[test]
fn names_of_files_reach_the_terminal_as_text() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let good = prepare(folder);
    let rows = good.lines().enumerate().map(|(n, line)| {
        let label = if n == 0 {
            "shift"
        } else if n % 2 == 0 {
            "day\u{1b}[31m"
        } else {
            "night\u{9b}2J"
        };
        format!("{line},{label}\n")
    });
    std::fs::write(folder.join("labels.csv"), rows.collect::<String>()).expect("written");
    for json in [&[][..], &["--json"]] {
        let arguments = [
            "identify",
            "--out",
            "o",
            "--robot",
            "ur5e",
            "--data",
            "labels.csv",
            "--holdout",
            "shift",
        ];
        let output = spherecal(folder, &[&arguments[..], json].concat());
        let said = text(&output.stdout) + &text(&output.stderr);
        assert!(matches!(output.status.code(), Some(0 | 3)), "{said}");
        assert!(!said.contains(|c: char| c.is_control() && c != '\n'), "{said:?}");
    }
}
