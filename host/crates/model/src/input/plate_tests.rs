//! What a plate's file may hold, and what it may not.

use super::*;

#[test]
fn a_plate_is_read_in_metres_and_checked() {
    let sphere =
        |id: u32, x: &str, sigma: &str| format!("[[sphere]]\nid = {id}\nx_mm = {x}\ny_mm = 0.5\nz_mm = 0\n{sigma}\n");
    let plate = read_plate("p.toml", &sphere(4, "50", "sigma_mm = 0.01"))
        .unwrap()
        .spheres;
    assert_eq!(
        (plate[0].id, plate[0].position_m, plate[0].sigma_m),
        (4, [0.05, 0.0005, 0.0], 1e-5)
    );
    let metres = "[[sphere]]\nid = 4\nx_m = 0.05\ny_m = 0.0005\nz_m = 0\nsigma_um = 10\n";
    assert_eq!(
        read_plate("p.toml", metres).unwrap().spheres[0].position_m,
        plate[0].position_m
    );
    let sigma = read_plate("p.toml", metres).unwrap().spheres[0].sigma_m;
    assert!((sigma - 1e-5).abs() < 1e-18);
    let two = |a: &str, b: &str| sphere(1, a, "") + &sphere(2, b, "");
    for (text, parts) in [
        (String::new(), &["0 spheres", "between 1 and"][..]),
        (sphere(1, "nan", ""), &["sphere 1: x_mm is NaN"]),
        (sphere(1, "30000", ""), &["x_mm is 30000", "within 20 m"]),
        (
            sphere(1, "0", "sigma_mm = -1"),
            &["sphere 1: sigma_mm is -1", "1 sigma"],
        ),
        (sphere(1, "0", "sigma_mm = 0"), &["sigma_mm is 0", "above 0"]),
        (sphere(1, "0", "sigma_mm = nan"), &["sigma_mm is NaN"]),
        (sphere(1, "0", "sigma_mm = 1\nsigma_um = 1"), &["given twice"]),
        (sphere(1, "0", "x_m = 1"), &["x_m is 1: is given twice"]),
        (
            "[[sphere]]\nid = 1\ny_mm = 0\nz_mm = 0\n".to_owned(),
            &["x_mm is missing"],
        ),
        (
            "[[sphere]]\nid = 1\nx = 0\n".to_owned(),
            &["line 3", "`x` is not known", "`x_mm`"],
        ),
        (sphere(1, "0", "") + &sphere(1, "9", ""), &["sphere id is 1", "twice"]),
        (two("100", "100.0001"), &["spheres 1 and 2", "0.0001 mm", "same place"]),
        (two("0", "0.3"), &["spheres 1 and 2", "0.3000 mm", "x_m"]),
        (
            "sphere = 1\n".to_owned(),
            &["line 1", "a plate lists [[sphere]] tables"],
        ),
        (
            (0..101).map(|k| sphere(k, &(10 * k).to_string(), "")).collect(),
            &["101 spheres"],
        ),
    ] {
        let message = read_plate("p.toml", &text).unwrap_err().to_string();
        for part in parts {
            assert!(message.contains(part), "{message:?} lacks {part:?}");
        }
    }
}

#[test]
fn spheres_on_one_line_are_named() {
    let sphere = |id: u32, x: u32, y: u32| format!("[[sphere]]\nid = {id}\nx_mm = {x}\ny_mm = {y}\nz_mm = 0\n");
    let three = |y: u32| {
        read_plate("p", &(sphere(1, 0, 0) + &sphere(2, 100, 0) + &sphere(3, 300, y)))
            .unwrap()
            .notes
    };
    assert!(three(1)[0].contains("3 spheres lie on one line"));
    assert!(three(80).is_empty());
    // Two spheres always do; that is no news.
    assert!(
        read_plate("p", &(sphere(1, 0, 0) + &sphere(2, 100, 0)))
            .unwrap()
            .notes
            .is_empty()
    );
}
