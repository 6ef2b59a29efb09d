//! Corrections of tables, and tables as text.

use proptest::prelude::*;

use super::*;
use crate::Target;

fn read(text: &str, joints: usize) -> (Table, Labels) {
    let mut places = Labels::default();
    let table = read_csv("t.csv", text.as_bytes(), &TableFormat::new(joints), &mut places).unwrap();
    (table, places)
}

const TABLE: &str = "q1,q2,q3,tau1,tau2,tau3,x_m,y_m,z_m,qw,qx,qy,qz,place,set\n\
    0.1,0.2,0.3,1,2,3,0.5,0.25,0.125,0.5,0.5,0.5,0.5,\"a \"\"b\"\"\",validate\n\
    0.4,0.5,0.6,4,5,6,1.5,1.25,1.125,1,0,0,0,c,\n\
    0.7,0.8,0.9,7,8,9,2.5,2.25,2.125,0,1,0,0,,calibrate\n";

// Fails if a value, a name or a digit is lost on the way through text.
#[test]
fn a_table_goes_round_as_text() {
    for (text, joints) in [
        (TABLE, 3),
        (
            "q1_deg,x1_mm,y1_mm,z1_mm,x2_mm,y2_mm,z2_mm\n33,1,2,3.3,,,\n34.1,,,,4,5,6\n",
            1,
        ),
        ("q1,sphere,x_mm,y_mm,z_mm\n0.1,1,,,\n0.3,,1,2,3\n", 1),
    ] {
        let (table, places) = read(text, joints);
        let (again, names) = read(&table.to_csv(&places, None), joints);
        assert_eq!(table.len(), again.len());
        for (a, b) in table.rows().zip(again.rows()) {
            assert_eq!((a.q, a.tau, a.sphere, a.set), (b.q, b.tau, b.sphere, b.set));
            assert_eq!(a.target(), b.target());
            assert_eq!(places.name(a.place), names.name(b.place));
        }
    }
}

// Fails if a correction does something else than its words say, or torques do not follow the joints.
#[test]
fn corrections_do_what_they_say() {
    let joints = |adjust: &Adjustments| {
        let (mut table, _) = read(TABLE, 3);
        adjust.apply(&mut table).unwrap();
        let row = table.rows().next().unwrap();
        (row.q.to_vec(), row.tau.unwrap().to_vec())
    };
    let plain = Adjustments::default;
    let order = Adjustments {
        order: vec![1, 0, 2],
        ..plain()
    };
    assert_eq!(joints(&order), (vec![0.2, 0.1, 0.3], vec![2.0, 1.0, 3.0]));
    assert_eq!(order.options(), "--order 2,1,3");
    let flip = Adjustments {
        flips: vec![2],
        ..plain()
    };
    assert_eq!(joints(&flip), (vec![0.1, 0.2, -0.3], vec![1.0, 2.0, -3.0]));
    let couple = Adjustments {
        couples: vec![(2, vec![(2, 1.0), (1, -1.0)])],
        ..plain()
    };
    assert_eq!(joints(&couple).0, [0.1, 0.2, 0.3 - 0.2]);
    // q3' = q3 - q2: the work of the torques is the same for any small motion.
    assert_eq!(joints(&couple).1, [1.0, 2.0 + 3.0, 3.0]);
    assert_eq!(couple.options(), "--couple 3=q3-q2");
    let zero = Adjustments {
        zeros: vec![(0, std::f64::consts::FRAC_PI_2)],
        ..plain()
    };
    assert!((joints(&zero).0[0] - 0.1 - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
    assert_eq!(zero.options(), "--zero-deg 1=90");
    let unit = Adjustments {
        units: vec![1.0, 0.5, 1.0],
        ..plain()
    };
    assert_eq!(joints(&unit), (vec![0.1, 0.1, 0.3], vec![1.0, 2.0, 3.0]));
    let (mut table, _) = read(TABLE, 3);
    Adjustments { shift: 1.0, ..plain() }.apply(&mut table).unwrap();
    let row = table.rows().next().unwrap();
    assert_eq!((table.len(), row.q[0], row.point), (2, 0.1, Some([1.5, 1.25, 1.125])));
    let (mut table, _) = read(TABLE, 3);
    Adjustments { shift: -1.0, ..plain() }.apply(&mut table).unwrap();
    let row = table.rows().next().unwrap();
    assert_eq!((table.len(), row.q[0], row.point), (2, 0.4, Some([0.5, 0.25, 0.125])));
}

// Fails if a correction that does not reach every row is said to be done: points or poses that are not there.
#[test]
fn corrections_that_do_nothing_are_refused() {
    let plain = Adjustments::default;
    let points = "q1,x_mm,y_mm,z_mm\n1,2,3,4\n2,3,4,5\n";
    let contacts = "q1,sphere\n1,1\n2,2\n";
    let some = "q1,x_m,y_m,z_m,qw,qx,qy,qz\n1,2,3,4,1,0,0,0\n2,2,3,4,,,,\n";
    let invert = || Adjustments {
        invert: true,
        ..plain()
    };
    for (text, adjust, words) in [
        (
            points,
            invert(),
            "--invert-poses is for 2 rows of which 0 have an orientation",
        ),
        (
            some,
            invert(),
            "--invert-poses is for 2 rows of which 1 have an orientation",
        ),
        (
            contacts,
            Adjustments {
                point_factor: 25.4,
                ..plain()
            },
            "--point-factor is for rows of contacts",
        ),
        (
            contacts,
            Adjustments {
                mirror: true,
                ..plain()
            },
            "--mirror-points is for rows of contacts",
        ),
        (
            points,
            Adjustments { shift: -2.0, ..plain() },
            "--shift-rows is -2 for 2 rows",
        ),
    ] {
        let (mut table, _) = read(text, 1);
        let error = adjust.apply(&mut table).unwrap_err().to_string();
        assert!(error.contains(words), "{words}: {error}");
    }
}

proptest! {
    // Fails if a mirrored or inverted pose is not one that mirrors or inverts back, or is no rotation.
    #[test]
    fn mirrors_and_inverses_go_back(invert in any::<bool>(), mirror in any::<bool>()) {
        let (mut table, _) = read(TABLE, 3);
        let (plain, _) = read(TABLE, 3);
        let adjust = Adjustments { invert, mirror: mirror && !invert, ..Adjustments::default() };
        adjust.apply(&mut table).unwrap();
        for row in table.rows() {
            let Target::Frame(pose) = row.target() else { panic!() };
            prop_assert!((pose.rotation.determinant() - 1.0).abs() < 1e-12);
        }
        adjust.apply(&mut table).unwrap();
        for (a, b) in table.rows().zip(plain.rows()) {
            let (Target::Frame(a), Target::Frame(b)) = (a.target(), b.target()) else { panic!() };
            prop_assert!((a.position - b.position).amax() < 1e-12 && (a.rotation - b.rotation).amax() < 1e-12);
        }
    }
}
