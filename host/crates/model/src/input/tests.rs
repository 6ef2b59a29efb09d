//! What a user's table may hold, and what it may not.

use proptest::prelude::*;

use super::*;
use crate::Set;

fn read(text: &str, joints: usize) -> Result<Table, InputError> {
    read_csv("t.csv", text.as_bytes(), joints, None, &mut Labels::default())
}

fn refusal(text: &str, joints: usize) -> String {
    read(text, joints).map(|t| t.rows.len()).unwrap_err().to_string()
}

#[test]
fn degrees_millimetres_names_and_sets_become_si() {
    let mut places = Labels::default();
    let text = "\u{feff}# a comment\nQ1_deg, q2_deg,x_mm,y_mm,z_mm,sphere,place,set\n\
                180,-90,1000,0,-5,,front,validate\n90,0,,,,2,back,\n90,0,,,,2,front,calibrate\n";
    let table = read_csv("t.csv", text.as_bytes(), 2, None, &mut places).unwrap();
    let first = &table.rows[0];
    assert!((first.q[0] - std::f64::consts::PI).abs() < 1e-15);
    assert_eq!(first.point, Some([1.0, 0.0, -0.005]));
    assert_eq!((first.sphere, first.set, first.place), (None, Some(Set::Validate), 0));
    assert_eq!((table.rows[1].sphere, table.rows[1].place), (Some(2), 1));
    assert_eq!(table.rows[2].place, 0);
    assert_eq!(places.names(), ["front", "back"]);
}

#[test]
fn semicolons_and_tabs_separate_too() {
    assert_eq!(read("q1;sphere\n0.5;3\n", 1).unwrap().rows[0].sphere, Some(3));
    assert_eq!(read("q1\tsphere\n0.5\t3\n", 1).unwrap().rows[0].q, [0.5]);
}

#[test]
fn refusals_name_the_field_its_value_and_the_remedy() {
    for (text, joints, parts) in [
        (
            "q1,q2,spere\n0,0,1\n",
            2,
            &["column \"spere\"", "sphere, place, set"][..],
        ),
        (
            "q1,q2,sphere\n0,nan,1\n",
            2,
            &["row 1 (line 2)", "column q2", "\"nan\"", "finite"],
        ),
        ("q1,q2,sphere\r\n0,nan,1\r\n", 2, &["row 1 (line 2)"]),
        ("q1,q2,sphere\n0,0,1\n0,,1\n", 2, &["row 2 (line 3)", "column q2"]),
        ("q1,q2,sphere\n0,0,1\n", 3, &["q3 is missing", "3 joints"]),
        ("q1,q2,sphere\n0,0,1\n", 1, &["q2", "1 joints"]),
        ("q1,q1_deg,sphere\n0,0,1\n", 1, &["\"q1\" and \"q1_deg\""]),
        ("q1,sphere\n95.0,1\n", 1, &["column q1", "95.0", "_deg"]),
        ("q1,x_mm,y_mm\n0,1,2\n", 1, &["x, y and z"]),
        ("q1,x_m,y_m,z_m\n0,512.3,0,0\n", 1, &["x_m", "512.3", "unit"]),
        ("q1,sphere,set\n0,1,test\n", 1, &["column set", "calibrate or validate"]),
        ("q1,sphere\n", 1, &["holds no rows"]),
        ("q1\n0\n", 1, &["where the TCP was"]),
        ("q1,sphere\n0,front\n", 1, &["column sphere", "integer id"]),
        ("q1,sphere\n0,1,2\n", 1, &["not a CSV table"]),
    ] {
        let message = refusal(text, joints);
        for part in parts {
            assert!(message.contains(part), "{message:?} lacks {part:?}");
        }
    }
}

#[test]
fn a_plate_is_read_in_metres_and_checked() {
    let plate = read_plate(
        "p.toml",
        "[[sphere]]\nid = 4\nx_mm = 50\ny_mm = 0.5\nz_mm = 0\nsigma_mm = 0.01\n",
    )
    .unwrap();
    assert_eq!(
        (plate[0].id, plate[0].position_m, plate[0].sigma_m),
        (4, [0.05, 0.0005, 0.0], 1e-5)
    );
    for (text, part) in [
        ("", "at least one sphere"),
        ("[[sphere]]\nid = 1\nx_mm = nan\ny_mm = 0\nz_mm = 0\n", "x_mm is NaN"),
        (
            "[[sphere]]\nid = 1\nx_mm = 0\ny_mm = 0\nz_mm = 0\nsigma_mm = -1\n",
            "sigma_mm is -1",
        ),
        ("[[sphere]]\nid = 1\nx = 0\ny_mm = 0\nz_mm = 0\n", "x_mm"),
        (
            "[[sphere]]\nid=1\nx_mm=0\ny_mm=0\nz_mm=0\n[[sphere]]\nid=1\nx_mm=1\ny_mm=0\nz_mm=0\n",
            "twice",
        ),
    ] {
        let message = read_plate("p.toml", text).unwrap_err().to_string();
        assert!(message.contains(part), "{message:?} lacks {part:?}");
    }
}

#[test]
fn a_label_column_is_allowed_when_asked_for() {
    let text = "q1,sphere,shift\n0,1,night\n";
    let table = read_csv("t.csv", text.as_bytes(), 1, Some("shift"), &mut Labels::default()).unwrap();
    assert_eq!(table.rows[0].label.as_deref(), Some("night"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    /// Any bytes are a table or a refusal; what is accepted is finite and of the right shape.
    #[test]
    fn no_bytes_break_the_table(bytes in proptest::collection::vec(any::<u8>(), 0..300), joints in 0..9_usize) {
        let _ = read_csv("t.csv", bytes.as_slice(), joints, None, &mut Labels::default());
    }

    /// The same with something like a table in it.
    #[test]
    fn no_near_table_breaks_the_table(
        header in proptest::sample::subsequence(vec!["q1", "q2", "q1_deg", "x_mm", "y_mm", "z_m", "tau1", "tau2", "sphere", "place", "set", "q99", "tau0", "q"], 0..14),
        cells in proptest::collection::vec("[-0-9.eEnainf\", ;]{0,6}", 0..60),
        joints in 0..4_usize,
    ) {
        let width = header.len().max(1);
        let mut text = header.join(",");
        for row in cells.chunks(width) {
            text += "\n";
            text += &row.join(",");
        }
        if let Ok(table) = read(&text, joints) {
            for row in &table.rows {
                prop_assert_eq!(row.q.len(), joints);
                prop_assert!(row.q.iter().all(|v| v.is_finite()));
                prop_assert!(row.point.is_some() || row.sphere.is_some());
            }
        }
        let _ = triple("--tool-mm", &text, 1.0);
        let _ = read_plate("p.toml", &text);
    }
}
