//! What a user's table may hold, and what it may not.

use proptest::prelude::*;

use super::*;
use crate::encoding::tests::utf16;
use crate::{Set, Target};

fn read_with(bytes: &[u8], format: &TableFormat) -> Result<Table, InputError> {
    read_csv("t.csv", bytes, format, &mut Labels::default())
}

fn read(text: &str, joints: usize) -> Result<Table, InputError> {
    read_with(text.as_bytes(), &TableFormat::new(joints))
}

fn refusal(text: &str, joints: usize) -> String {
    read(text, joints).map(|t| t.len()).unwrap_err().to_string()
}

fn row(table: &Table, k: usize) -> TableRow<'_> {
    table.rows().nth(k).unwrap()
}

#[test]
fn degrees_millimetres_names_and_sets_become_si() {
    let mut places = Labels::default();
    let text = "\u{feff}# a comment\nQ1_deg, q2 [°],x_mm,Y [mm],z_mm,sphere,place,set\n\
                180,-90,1000,0,-5,,front,validate\n90,0,,,,2,back,\n90,0,,,,2.0,front,calibrate\n";
    let table = read_csv("t.csv", text.as_bytes(), &TableFormat::new(2), &mut places).unwrap();
    let first = row(&table, 0);
    assert!((first.q[0] - std::f64::consts::PI).abs() < 1e-15);
    assert_eq!(first.point, Some([1.0, 0.0, -0.005]));
    assert_eq!((first.sphere, first.set, first.place), (None, Some(Set::Validate), 0));
    assert_eq!((row(&table, 1).sphere, row(&table, 1).place), (Some(2), 1));
    assert_eq!((row(&table, 2).sphere, row(&table, 2).place), (Some(2), 0));
    assert_eq!(places.names().collect::<Vec<_>>(), ["front", "back"]);
    assert_eq!((table.len(), first.line), (3, 3));
}

/// One small table as spreadsheets of the world write it: fails if any of them
/// gives other numbers.
#[test]
fn spreadsheets_habits_change_nothing() {
    let plain = "q1,q2,x_mm,y_mm,z_mm,place\n0.5,-1.25,100.5,0,-3e-1,a\n1.5,2,7,8,9,b\n";
    let expected = read(plain, 2).unwrap();
    let semicolons = plain.replace(',', ";");
    let commas = semicolons.replace('.', ",");
    let tabs = plain.replace(',', "\t");
    let quoted = plain.replace(",a", ",\"a\"").replace("\n0.5,", "\n\" 0.5 \",");
    let windows = plain.replace('\n', "\r\n");
    let mac = plain.replace('\n', "\r");
    let padded = plain.replace('\n', ",,,\n");
    let blank = format!("{plain}{}", ",,,,,\n".repeat(5000));
    let empty = plain.replace('\n', "\n\n");
    let upper = plain.replacen("q1,q2,x_mm", " Q1 ,\"Q2\",X_MM", 1);
    let said = format!("sep=;\n{commas}");
    let no_end = plain.trim_end().to_owned();
    for (name, text) in [
        ("semicolons", &semicolons),
        ("decimal commas", &commas),
        ("decimal commas and tabs", &tabs.replace('.', ",")),
        ("tabs", &tabs),
        ("quotes", &quoted),
        ("CR LF", &windows),
        ("CR", &mac),
        ("blank columns", &padded),
        ("blank rows", &blank),
        ("blank lines", &empty),
        ("capitals", &upper),
        ("sep=", &said),
        ("no line end", &no_end),
    ] {
        let utf8_mark = [b"\xef\xbb\xbf".as_slice(), text.as_bytes()].concat();
        for bytes in [
            text.as_bytes().to_vec(),
            utf8_mark,
            utf16(text, false),
            utf16(text, true),
        ] {
            let found = read_with(&bytes, &TableFormat::new(2)).unwrap_or_else(|e| panic!("{name}: {e}"));
            for (a, b) in found.rows().zip(expected.rows()) {
                assert_eq!((a.q, a.point, a.place), (b.q, b.point, b.place), "{name}");
            }
            assert_eq!(found.len(), 2, "{name}");
        }
    }
}

#[test]
fn refusals_name_the_field_its_value_and_the_remedy() {
    for (text, joints, parts) in [
        (
            "q1,q2,spere,operator\n0,0,1,Kim\n",
            2,
            &[
                "columns \"spere\", \"operator\" are not known",
                "did you mean \"sphere\"?",
                "--ignore-columns",
                "place, set",
            ][..],
        ),
        ("q1,x,y,z\n0,1,2,3\n", 1, &["\"x\" has no unit", "x_mm or x_m"]),
        (
            "q1,q2,sphere\n0,nan,1\n",
            2,
            &["row 1 (line 2)", "column q2", "\"nan\"", "finite"],
        ),
        ("q1,q2,sphere\r\n0,nan,1\r\n", 2, &["row 1 (line 2)"]),
        ("q1,q2,sphere\n0,inf,1\n", 2, &["\"inf\"", "finite"]),
        ("q1,q2,sphere\n0,0,1\n0,,1\n", 2, &["row 2 (line 3)", "column q2"]),
        ("q1,q2,sphere\n0,#DIV/0!,1\n", 2, &["#DIV/0!", "formula"]),
        ("q1,q2,sphere\n0,0,1\n", 3, &["q3 is missing", "3 joints"]),
        ("q1,q2,sphere\n0,0,1\n", 1, &["q2", "1 joints"]),
        ("q1,q1_deg,sphere\n0,0,1\n", 1, &["\"q1\" and \"q1_deg\""]),
        ("q1,sphere,Sphere\n0,1,1\n", 1, &["\"sphere\" and \"Sphere\""]),
        ("q1,sphere\n95.0,1\n", 1, &["column q1", "95.0", "_deg"]),
        ("q1,x_mm,y_mm\n0,1,2\n", 1, &["x, y and z", "z_mm is missing"]),
        ("q1,x_m,y_m,z_m\n0,512.3,0,0\n", 1, &["x_m", "512.3", "unit"]),
        ("q1,x_m,y_m,z_m\n0,5,0,\n", 1, &["column x, y, z", "all three"]),
        ("q1,x_m,y_m,z_m\n0,,,\n", 1, &["say where the TCP was"]),
        ("q1,sphere,set\n0,1,test\n", 1, &["column set", "calibrate or validate"]),
        ("q1,sphere\n", 1, &["holds no rows"]),
        ("", 1, &["holds no header line", "q1,x_mm"]),
        ("q1\n0\n", 1, &["where the TCP was"]),
        ("0.1,0.2\n0,1\n", 1, &["holds numbers, not names", "header line"]),
        ("q1,sphere\n0,front\n", 1, &["column sphere", "integer id"]),
        (
            "q1,sphere\n0,1,2\n",
            1,
            &["row 1", "3 (without a name)", "the header has 2 columns"],
        ),
        (
            "q1,sphere,place\n0,1\n",
            1,
            &["line 2", "row 1 has 2 cells, the header has 3"],
        ),
        ("q1,,sphere\n0,7,1\n", 1, &["\"7\"", "give the column a name"]),
        ("q1,sphere,place\n0,1,\"a\n0,1,b\n", 1, &["line 2", "quote", "partner"]),
        ("q1;sphere\n0,5;1\n0.5;1\n", 1, &["row 2", "mixed", "row 1, column q1"]),
        ("q1,sphere\n\"1,234\",1\n", 1, &["1,234", "decimal point"]),
        ("q1;sphere\n1.234,5;1\n", 1, &["1.234,5", "decimal point"]),
        (
            "q1,x1_mm,y1_mm,z1_mm,x3_mm,y3_mm,z3_mm\n",
            1,
            &["x2_mm is missing", "without gaps"],
        ),
        ("q1,x_mm,y_mm,z_mm,x1_mm,y1_mm,z1_mm\n", 1, &["both x_mm and x1_mm"]),
        ("q1,x_mm,y_mm,z_mm,qw,qx,qy\n", 1, &["four columns"]),
        ("q1,sphere,qw,qx,qy,qz\n", 1, &["one position"]),
        (
            "q1,x1_mm,y1_mm,z1_mm,x2_mm,z2_mm\n",
            1,
            &["y2_mm is missing", "give x2_mm, y2_mm and z2_mm"],
        ),
        (
            "q1,sphere,x1_mm,y1_mm,z1_mm\n",
            1,
            &["a column sphere", "a table of their own"],
        ),
        (
            "q1,sphere,x_mm,y_mm,z_mm,qw,qx,qy,qz\n",
            1,
            &["a column sphere", "a table of their own"],
        ),
        (
            "q1,x1_mm,y1_mm,z1_mm,x7_mm,y7_mm,z7_mm\n",
            1,
            &["\"x7_mm\"", "not known"],
        ),
        (
            "q1,x_mm,y_mm,z_mm,qw,qx,qy,qz\n0,900,0,0,0.998,0,0,0\n",
            1,
            &["row 1", "length 0.9980", "length 1"],
        ),
        (
            "q1,x_mm,y_mm,z_mm,qw,qx,qy,qz\n0,900,0,0,nan,0,0,0\n",
            1,
            &["row 1", "qw", "finite"],
        ),
        (
            "q1,x_mm,y_mm,z_mm,qw,qx,qy,qz\n0,900,0,0,0,0,0,0.5\n",
            1,
            &["row 1", "length 0.5", "length 1"],
        ),
        (
            "q1,x_m,y_m,z_m,r11,r12,r13,r21,r22,r23,r31,r32,r33\n0,1,0,0,1,0,0,0,1,0,0,0,-1\n",
            1,
            &["row 1", "determinant -1", "right-handed"],
        ),
        ("q1,sphere,tau1\n0,1,\n", 2, &["q2"]),
        (
            "q1,q2,tau1,tau2,sphere\n0,0,1,,1\n",
            2,
            &["column tau", "all joints or of none"],
        ),
    ] {
        let message = refusal(text, joints);
        for part in parts {
            assert!(message.contains(part), "{message:?} lacks {part:?}");
        }
    }
}

#[test]
fn units_that_the_numbers_contradict_are_named() {
    let table = |header: &str, row: &dyn Fn(f64) -> String| {
        let rows: Vec<String> = (1..=6).map(|k| row(f64::from(k))).collect();
        format!("{header}\n{}\n", rows.join("\n"))
    };
    let degrees = table("q1,q2,sphere", &|k| format!("{},{},1", 3.0 * k, -4.0 * k));
    let message = refusal(&degrees, 2);
    assert!(
        message.contains("row 2 (line 3)") && message.contains("q2") && message.contains("q1_deg.."),
        "{message}"
    );
    let radians = table("q1_deg,q2_deg,sphere", &|k| format!("{},{},1", 0.3 * k, -0.5 * k));
    let message = refusal(&radians, 2);
    assert!(
        message.contains("column q2_deg is \"-3\"") && message.contains("row 6"),
        "{message}"
    );
    let metres = table("q1,x_mm,y_mm,z_mm", &|k| format!("{k},{},0.2,0.9", 0.1 * k));
    let message = refusal(&metres, 1);
    assert!(message.contains("name the columns x_m.."), "{message}");
    // Each of them in the right unit is read, and so is what is too little to tell.
    for (good, joints) in [
        (degrees.replace("q1,q2", "q1_deg,q2_deg"), 2),
        (radians.replace("_deg", ""), 2),
        (metres.replace("_mm", "_m"), 1),
        (table("q1,x_mm,y_mm,z_mm", &|k| format!("{k},0,0,0")), 1),
        ("q1_deg,sphere\n1,1\n2,1\n".to_owned(), 1),
    ] {
        assert!(read(&good, joints).is_ok(), "{good}");
    }
}

#[test]
fn joints_are_found_by_their_names() {
    let mut format = TableFormat::new(2);
    format.joint_names = vec!["Shoulder_Pan".to_owned(), "elbow".to_owned()];
    let by_name = read_with(b"elbow_deg,sphere,shoulder_pan\n90,1,0.5\n", &format).unwrap();
    assert_eq!(row(&by_name, 0).q, [0.5, std::f64::consts::FRAC_PI_2]);
    // The usual names serve too.
    assert_eq!(
        row(&read_with(b"q2,q1,sphere\n2,1,1\n", &format).unwrap(), 0).q,
        [1.0, 2.0]
    );
    let message = read_with(b"elbo,q1,sphere\n90,1,0\n", &format).unwrap_err().to_string();
    assert!(message.contains("did you mean \"elbow\"?"), "{message}");

    // Columns that the caller names go before all others.
    format.joint_columns = vec!["a".to_owned(), "b_deg".to_owned()];
    let by_caller = read_with(b"b_deg,sphere,a\n180,1,0.5\n", &format).unwrap();
    assert_eq!(row(&by_caller, 0).q, [0.5, std::f64::consts::PI]);
    let refused = |text: &str, format: &TableFormat| read_with(text.as_bytes(), format).unwrap_err().to_string();
    assert!(refused("b_deg,sphere\n180,1\n", &format).contains("column a is missing"));
    assert!(refused("q1,b_deg,a,sphere\n0,180,0,1\n", &format).contains("\"q1\" is not known"));
    format.joint_columns.pop();
    assert!(refused("a,sphere\n180,1\n", &format).contains("--joint-columns is 1 names"));
    format.joint_columns.push("A".to_owned());
    assert!(refused("a,sphere\n180,1\n", &format).contains("stands twice"));
}

#[test]
fn columns_are_ignored_when_asked_and_only_then() {
    let mut format = TableFormat::new(1);
    let text = b"q1,tau1,Note [kg],sphere,note [kg]\n0.5,nonsense,x,1,y\n";
    assert!(read_with(text, &format).unwrap_err().to_string().contains("note_kg"));
    format.ignore = vec!["NOTE [kg]".to_owned(), "tau1".to_owned()];
    let table = read_with(text, &format).unwrap();
    assert_eq!((row(&table, 0).q, row(&table, 0).tau), ([0.5].as_slice(), None));
}

#[test]
fn a_label_column_is_allowed_when_asked_for() {
    let mut format = TableFormat::new(1);
    format.label = Some("Shift".to_owned());
    let table = read_with(b"q1,sphere,shift\n0,1,night\n0,1,\n0,1,night\n", &format).unwrap();
    let names: Vec<_> = table.rows().map(|r| r.label.map(|l| table.labels.name(l))).collect();
    assert_eq!(names, [Some("night"), None, Some("night")]);
}

#[test]
fn several_points_and_frames_are_targets() {
    let table = read("q1,x1_mm,y1_mm,z1_mm,x2_mm,y2_mm,z2_mm\n0,1000,2,3,,,\n0,,,,4,5,6\n", 1).unwrap();
    let points = [Some([1.0, 0.002, 0.003]), None];
    assert_eq!(row(&table, 0).target(), Target::Points(points.into()));
    assert_eq!(
        row(&table, 1).target(),
        Target::Points([None, Some([0.004, 0.005, 0.006])].into())
    );
    assert!(refusal("q1,x1_mm,y1_mm,z1_mm\n0,,,\n", 1).contains("say where the TCP was"));
    assert!(refusal("q1,x1_mm,y1_mm,z1_mm,x2_mm,y2_mm,z2_mm\n0,1,2,3,4,,\n", 1).contains("x2, y2, z2"));

    // A turn by 90 degrees about z, both ways of writing it.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let quaternion = format!("q1,x_m,y_m,z_m,qw,qx,qy,qz\n0,1,2,3,{half},0,0,{half}\n0,1,2,3,,,,\n");
    let matrix = "q1,x_m,y_m,z_m,r11,r12,r13,r21,r22,r23,r31,r32,r33\n0,1,2,3,0,-1,0,1,0,0,0,0,1\n0,1,2,3,,,,,,,,,\n";
    for text in [quaternion.as_str(), matrix] {
        let table = read(text, 1).unwrap();
        let Target::Frame(pose) = row(&table, 0).target() else {
            panic!("{text}")
        };
        let turned = pose.rotation * nalgebra::Vector3::x();
        assert!((turned - nalgebra::Vector3::y()).amax() < 1e-13, "{turned}");
        assert_eq!(pose.position, nalgebra::Vector3::new(1.0, 2.0, 3.0));
        // A row without its orientation is a point.
        assert_eq!(row(&table, 1).target(), Target::Point([1.0, 2.0, 3.0]));
    }
    assert!(refusal(&quaternion.replace("3,,,,", "3,1,0,0,"), 1).contains("whole orientation"));
}

// Fails if numbering the names of places or labels takes more than linear time:
// 200,000 names took 104 s.
#[test]
fn many_names_are_numbered_in_linear_time() {
    let mut format = TableFormat::new(1);
    format.label = Some("note".to_owned());
    let mut places = Labels::default();
    let mut text = "q1,sphere,place,note\n".to_owned();
    for k in 0..200_000 {
        text += &format!("0.{k},1,p{k},n{}\n", k % 100_000);
    }
    let table = read_csv("t.csv", text.as_bytes(), &format, &mut places).unwrap();
    assert_eq!((places.len(), table.labels.len()), (200_000, 100_000));
    assert_eq!(
        table.rows().last().map(|r| (r.place, r.label)),
        Some((199_999, Some(99_999)))
    );
}

#[test]
fn terminal_escapes_in_a_file_are_shown_as_text() {
    for text in [
        "q1,sp\u{1b}[2Jhere\n0,1\n",
        "q1,sphere\n\u{1b}]0;x\u{7},1\n",
        "q1,sphere,set\n0,1,\u{9b}31m\n",
    ] {
        let message = refusal(text, 1);
        assert!(
            !message.contains(char::is_control) && message.contains("\\u00"),
            "{message}"
        );
    }
}

#[test]
fn progress_is_reported_to_the_last_row() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.csv");
    let rows = 20_000;
    let text = "q1,sphere\n".to_owned() + &"0.25,1\n".repeat(rows);
    std::fs::write(&path, &text).unwrap();
    let mut seen = Vec::new();
    let mut places = Labels::default();
    let table = read_csv_file(&path, &TableFormat::new(1), &mut places, &mut |p| seen.push(p)).unwrap();
    assert_eq!(table.len(), rows);
    assert!(
        seen.len() >= 3
            && seen
                .windows(2)
                .all(|w| w[0].rows < w[1].rows && w[0].bytes <= w[1].bytes)
    );
    let last = seen.last().unwrap();
    let length = text.len() as u64;
    assert_eq!((last.rows, last.bytes, last.total_bytes), (rows, length, length));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    /// Any bytes are a table or a refusal.
    #[test]
    fn no_bytes_break_the_table(bytes in proptest::collection::vec(any::<u8>(), 0..300), joints in 0..9_usize) {
        let _ = read_with(&bytes, &TableFormat::new(joints));
    }

    /// The same with something like a table in it; what is accepted is finite and of the right shape.
    #[test]
    fn no_near_table_breaks_the_table(
        header in proptest::sample::subsequence(vec![
            "q1", "q2", "q1_deg", "x_mm", "y_mm", "z_m", "x1_mm", "y1_mm", "z1_mm", "qw", "qx", "qy", "qz", "tau1",
            "tau2", "sphere", "place", "set", "q99", "tau0", "q", "", "j [deg]", "r11",
        ], 0..24),
        cells in proptest::collection::vec("[-0-9.eEnainf\", ;]{0,6}", 0..60),
        separator in proptest::sample::select(vec![",", ";", "\t"]),
        joints in 0..4_usize,
        own in any::<bool>(),
    ) {
        let width = header.len().max(1);
        let mut text = header.join(separator);
        for row in cells.chunks(width) {
            text += "\n";
            text += &row.join(separator);
        }
        let format = TableFormat {
            joint_columns: if own { vec!["j".to_owned(), "q2".to_owned()] } else { Vec::new() },
            label: Some("q".to_owned()),
            ignore: vec!["q99".to_owned()],
            ..TableFormat::new(joints)
        };
        if let Ok(table) = read_with(text.as_bytes(), &format) {
            for row in table.rows() {
                prop_assert_eq!(row.q.len(), joints);
                prop_assert!(row.q.iter().all(|v| v.is_finite()));
                match row.target() {
                    Target::Point(p) => prop_assert!(p.iter().all(|v| v.is_finite())),
                    Target::Points(p) => prop_assert!(p.iter().flatten().flatten().all(|v| v.is_finite())),
                    Target::Frame(f) => prop_assert!(f.rotation.iter().all(|v| v.is_finite())),
                    Target::Sphere { .. } => prop_assert!(row.sphere.is_some()),
                }
            }
        }
        let _ = triple("--tool-mm", &text, 1.0);
        let _ = read_plate("p.toml", &text);
    }

    /// Any plate is read or refused; what is read can be used.
    #[test]
    fn no_plate_breaks_the_reader(
        rows in proptest::collection::vec((0..5_u32, -1e5..1e5_f64, proptest::option::of(-1.0..200.0_f64)), 0..6),
        junk in "\\PC{0,20}",
    ) {
        let mut text = String::new();
        for (id, x, sigma) in rows {
            text += &format!("[[sphere]]\nid = {id}\nx_mm = {x:?}\ny_mm = {:?}\nz_mm = 0\n", -x / 3.0);
            if let Some(sigma) = sigma {
                text += &format!("sigma_mm = {sigma:?}\n");
            }
        }
        if let Ok(plate) = read_plate("p.toml", &text) {
            prop_assert!(plate.spheres.iter().all(|s| s.sigma_m > 0.0 && s.position_m.iter().all(|x| x.abs() <= 20.0)));
        }
        let _ = read_plate("p.toml", &(text + &junk));
    }
}
