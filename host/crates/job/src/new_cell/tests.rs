//! What a new cell's files hold, and what is refused before they are made.

use super::*;

fn cell() -> NewCell {
    NewCell {
        robot: "fr3".to_owned(),
        serial: "FR3-0042".to_owned(),
        plate: StatedPlate::Distances([300.0091, 300.2437, 300.1173]),
        plate_certificate: "PC \"7\"".to_owned(),
        plate_u_mm: Some(0.0027),
        sphere_diameter_mm: 50.8,
        tool_mass_kg: 0.8,
        tool_mm: Some([50.0, 0.0, 100.0]),
        tool_com_mm: None,
        plate_at_mm: None,
        plate_yaw_deg: None,
        instrument: Instrument::None,
        degrees: false,
    }
}

// Fails if the configuration is not the stated cell, if a distance of the certificate is changed by
// more than it is certain, or if a number has more digits than an instrument resolves.
#[test]
fn the_files_say_what_was_stated() {
    let files = cell().files().expect("possible");
    let config = Config::parse("cell.toml", &files.cell_toml).expect("a configuration");
    assert_eq!((config.robot.as_str(), config.arm.as_str()), ("fr3", "FR3-0042"));
    assert_eq!(config.cell.tool.tcp_mm, Some([50.0, 0.0, 100.0]));
    assert_eq!(
        (config.cell.tool.mass_kg, config.cell.tool.com_mm),
        (Some(0.8), Some([25.0, 0.0, 50.0]))
    );
    assert_eq!(config.cell.plate.certificate_sigma_m, 1.35e-6);
    assert_eq!(config.certificate.plate_certificate.as_deref(), Some("PC \"7\""));
    let at = |k: usize| nalgebra::Vector3::from(config.cell.plate.spheres_m[k]);
    for (i, j, mm) in [(0, 1, 300.0091), (0, 2, 300.2437), (1, 2, 300.1173)] {
        assert!(((at(i) - at(j)).norm() * 1e3 - mm).abs() < 1e-4, "{i} {j}");
    }
    let digits = |line: &str| line.chars().filter(char::is_ascii_digit).count();
    for text in [&files.cell_toml, &files.plate_toml] {
        let words = text
            .lines()
            .filter(|l| !l.starts_with('#'))
            .flat_map(|l| l.split([' ', ',', '[', ']']));
        for word in words.filter(|w| w.parse::<f64>().is_ok()) {
            assert!(digits(word) <= 9, "{word}");
        }
    }
    assert_eq!(files.poses_csv, "q1,q2,q3,q4,q5,q6,q7,sphere\n");
    assert!(files.plate_toml.contains("name = 'PC \"7\"'"), "{}", files.plate_toml);
    assert_eq!(
        files.identify_options,
        "--tool-mm 50,0,100 --payload-kg 0.8 --payload-com-mm 25,0,50"
    );
    let points = NewCell {
        robot: "ur5e".to_owned(),
        instrument: Instrument::Tracker,
        degrees: true,
        ..cell()
    };
    assert_eq!(
        points.files().expect("possible").poses_csv,
        "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\n"
    );
}

// Fails if the block of the certificate is missing without a number, if a line of it is no line of
// the configuration once its # is taken away, or if a number that the page cannot hold is taken.
#[test]
fn the_certificate_waits_to_be_filled_in() {
    let unnamed = NewCell {
        plate_certificate: String::new(),
        ..cell()
    };
    let text = unnamed.files().expect("possible").cell_toml;
    let (before, block) = text.split_once("[certificate]").expect("a block");
    let filled: String = block
        .lines()
        .map(|line| match line.strip_prefix("# ") {
            Some(field) if field.contains(" = ") => format!("{field}\n"),
            _ => format!("{line}\n"),
        })
        .collect();
    let config = Config::parse("cell.toml", &format!("{before}[certificate]{filled}")).expect("a configuration");
    config.check().expect("possible");
    assert_eq!(config.certificate.validity_months, Some(12));
    assert_eq!(config.certificate.plate_certificate.as_deref(), Some(""));

    let long = NewCell {
        plate_certificate: "x".repeat(61),
        ..cell()
    };
    let refusal = long.files().expect_err("too long").to_string();
    assert!(refusal.starts_with("certificate.plate_certificate is xxx"), "{refusal}");
}

// Fails if a placement that the program proposes is out of reach of a large or a small arm.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_an_arm_gets_a_placement_within_its_reach() {
    for robot in &["ur10e", "irb120"] {
        let stated = NewCell {
            robot: (*robot).to_owned(),
            tool_mm: None,
            ..cell()
        };
        let files = stated.files().unwrap_or_else(|e| panic!("{robot}: {e}"));
        assert!(
            files.assumed.iter().any(|words| words.starts_with("sphere 1 is at")),
            "{robot}"
        );
    }
}

// Fails if an impossible value is taken, or if its refusal does not name the option, the value and
// the remedy.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_impossible_cells_are_refused_by_option() {
    let cases: &[(&str, fn(&mut NewCell))] = &[
        ("robot \"fr4\" is neither built in nor a file: did you mean fr3?", |c| {
            c.robot = "fr4".into();
        }),
        ("--serial is \"  \": give the serial number", |c| c.serial = "  ".into()),
        ("--tool-mass-kg is 0: ", |c| c.tool_mass_kg = 0.0),
        ("--tool-mass-kg is NaN: ", |c| c.tool_mass_kg = f64::NAN),
        (
            "--tool-mass-kg is 3.5: give the mass of everything at the flange in kg, above 0 and at most fr3's payload of 3 kg",
            |c| {
                c.tool_mass_kg = 3.5;
            },
        ),
        ("--tool-mm is 0,0,0: ", |c| c.tool_mm = Some([0.0; 3])),
        ("--tool-mm is 0,0,5000: ", |c| c.tool_mm = Some([0.0, 0.0, 5000.0])),
        ("--plate is 100,100,250: no triangle has these sides: 250", |c| {
            c.plate = StatedPlate::Distances([100.0, 100.0, 250.0]);
        }),
        ("--plate is 300,-1,300: -1 is no distance", |c| {
            c.plate = StatedPlate::Distances([300.0, -1.0, 300.0]);
        }),
        ("--plate is 0.3 mm from sphere 1 to sphere 2: ", |c| {
            c.plate = StatedPlate::Distances([0.3, 0.3, 0.3]);
        }),
        ("--plate is 3 spheres within 0.5 mm of one line", |c| {
            c.plate = StatedPlate::Centres(vec![[0.0; 3], [100.0, 0.0, 0.0], [200.0, 1.0, 0.0]]);
        }),
        ("--plate is 2 spheres: a plate has three", |c| {
            c.plate = StatedPlate::Centres(vec![[0.0; 3], [100.0, 0.0, 0.0]]);
        }),
        ("no-such.toml: there is no such file", |c| {
            c.plate = StatedPlate::File("no-such.toml".into());
        }),
        ("--plate-u-mm is 0: ", |c| c.plate_u_mm = Some(0.0)),
        ("--sphere-diameter-mm is 0: ", |c| c.sphere_diameter_mm = 0.0),
        ("--plate-yaw-deg is 400: ", |c| c.plate_yaw_deg = Some(400.0)),
        ("--plate-at-mm is 3000,0,300: sphere ", |c| {
            c.plate_at_mm = Some([3000.0, 0.0, 300.0]);
        }),
    ];
    for (words, change) in cases {
        let mut stated = cell();
        change(&mut stated);
        let refusal = stated.files().expect_err(words).to_string();
        assert!(refusal.starts_with(words), "{words}\n{refusal}");
    }
    for text in ["300,300", "300,300,x;", "1,2;3,4", "300,300,300,300", ""] {
        let stated = text.parse::<StatedPlate>();
        if let Ok(StatedPlate::File(file)) = &stated {
            assert_eq!(text, "300,300,x;", "{}", file.display());
        } else {
            let refusal = stated.expect_err(text).to_string();
            assert!(refusal.contains("give the distances of the centres"), "{refusal}");
        }
    }
    assert!("tracke".parse::<Instrument>().is_err());
}
