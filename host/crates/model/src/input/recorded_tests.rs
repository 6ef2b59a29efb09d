//! Tables as people record them: each gives the rows of the plain one.

use super::*;
use crate::Target;

fn names(words: &[&str]) -> Vec<String> {
    words.iter().map(|w| (*w).to_owned()).collect()
}

fn read(text: &str, columns: &[&str], format: &TableFormat) -> Result<(Table, Recorded), String> {
    let words = |e: InputError| e.to_string();
    let mapping = ColumnMapping::parse(&names(columns), false).map_err(words)?;
    let found = recorded("t.csv", text.as_bytes(), format, &mapping).map_err(words)?;
    let csv = if found.changed { found.csv.as_str() } else { text };
    let table = read_csv("t.csv", csv.as_bytes(), format, &mut Labels::default()).map_err(words)?;
    Ok((table, found))
}

const PLAIN: &str = "q1,q2,x_mm,y_mm,z_mm\n0.5,-1.25,100.5,0,-0.25\n1.5,2,7,8,9\n";

// Fails if a table that says the same in another way gives other rows, or is changed in silence.
#[test]
fn other_names_and_separators_say_the_same() {
    let format = TableFormat {
        joint_names: names(&["shoulder_pan", "elbow"]),
        ..TableFormat::new(2)
    };
    let (plain, untouched) = read(PLAIN, &[], &format).unwrap();
    assert!(!untouched.changed && untouched.notes.is_empty(), "{untouched:?}");
    let header = |h: &str| PLAIN.replacen("q1,q2,x_mm,y_mm,z_mm", h, 1);
    let blanks = PLAIN.replace(',', "  ");
    let rows: String = PLAIN.lines().skip(1).map(|l| format!("{l}\n")).collect();
    let timed = PLAIN.replace("\n0.5", "\n17.1,0.5").replace("\n1.5", "\n17.2,1.5");
    for (text, columns, note) in [
        (
            header("q0,q1,x_mm,y_mm,z_mm"),
            &[][..],
            "joint 1 is taken from the column q0",
        ),
        (header("joint_1,joint_2,x_mm,y_mm,z_mm"), &[], "joint_1"),
        (header("actual_q_0,actual_q_1,x_mm,y_mm,z_mm"), &[], "actual_q_0"),
        (header("state.q[0],state.q[1],x_mm,y_mm,z_mm"), &[], "state.q_0"),
        (blanks.clone(), &[], ""),
        (
            format!("# q1 q2 x_mm y_mm z_mm\n{}", rows.replace(',', " ")),
            &[],
            "comment (#)",
        ),
        (
            format!("# made by me\n#q1,q2,x_mm,y_mm,z_mm\n{rows}"),
            &[],
            "comment (#)",
        ),
        (rows.clone(), &["joints=1,2", "point_mm=3,4,5"], ""),
        (header("a,b,X,Y,Z"), &["joints=a,b", "point_mm=X,Y,Z"], ""),
        (timed.replacen("q1", "time,q1", 1), &[], "not used: time"),
        (timed.replacen("q1", "temperature_c,q1", 1), &[], "temperature_c"),
        (
            format!("{PLAIN}nan,1,2,3,4\n1,2,NaN,nan,nan\n1,,3,4,5\n1,2,,,\n"),
            &[],
            "4 of 6 rows have no value",
        ),
    ] {
        let (table, found) = read(&text, columns, &format).unwrap_or_else(|e| panic!("{text}: {e}"));
        assert!(found.changed, "{text}");
        assert!(
            found.notes.iter().any(|n| n.contains(note)) || note.is_empty(),
            "{text}: {:?}",
            found.notes
        );
        assert_eq!(table.len(), plain.len(), "{text}");
        for (a, b) in table.rows().zip(plain.rows()) {
            assert_eq!((a.q, a.target()), (b.q, b.target()), "{text}");
        }
    }
    let degrees = header("shoulder_pan.pos,elbow.pos,x_mm,y_mm,z_mm");
    let (table, found) = read(&degrees, &[], &format).unwrap();
    assert_eq!(table.rows().next().unwrap().q[0], 0.5_f64.to_radians());
    assert!(found.notes[0].contains("degrees"));
}

// Fails if an orientation is read by another convention than its name says: each is the turn whose matrix is computed here
// from single turns.
#[test]
fn orientations_keep_their_conventions() {
    let format = TableFormat::new(1);
    let (a, b, c) = (0.3_f64, -0.7_f64, 1.1_f64);
    let (x, y, z) = (
        |t: f64| nalgebra::Rotation3::from_axis_angle(&nalgebra::Vector3::x_axis(), t),
        |t: f64| nalgebra::Rotation3::from_axis_angle(&nalgebra::Vector3::y_axis(), t),
        |t: f64| nalgebra::Rotation3::from_axis_angle(&nalgebra::Vector3::z_axis(), t),
    );
    let row = |header: &str, v: [f64; 3]| format!("q1,x_m,y_m,z_m,{header}\n0.1,1,2,3,{},{},{}\n", v[0], v[1], v[2]);
    let rad = [a, b, c];
    let deg = rad.map(f64::to_degrees);
    for (text, columns, expected) in [
        (row("A,B,C", deg), &[][..], z(a) * y(b) * x(c)),
        (row("a_deg,b_deg,c_deg", deg), &[], z(a) * y(b) * x(c)),
        (row("roll,pitch,yaw", rad), &[], z(c) * y(b) * x(a)),
        (row("roll [deg],pitch [deg],yaw [deg]", deg), &[], z(c) * y(b) * x(a)),
        (row("w_deg,p_deg,r_deg", deg), &[], z(c) * y(b) * x(a)),
        (
            row("rotvec_x,rotvec_y,rotvec_z", rad),
            &[],
            nalgebra::Rotation3::new(nalgebra::Vector3::new(a, b, c)),
        ),
        (
            row("rx,ry,rz", rad),
            &["rotvec=rx,ry,rz"],
            nalgebra::Rotation3::new(nalgebra::Vector3::new(a, b, c)),
        ),
        (row("rx,ry,rz", deg), &["euler_xyz_deg=rx,ry,rz"], x(a) * y(b) * z(c)),
        (row("rx,ry,rz", rad), &["euler_zyz_rad=rx,ry,rz"], z(a) * y(b) * z(c)),
        (row("rx,ry,rz", deg), &["rpy_deg=rx,ry,rz"], z(c) * y(b) * x(a)),
    ] {
        let (table, _) = read(&text, columns, &format).unwrap_or_else(|e| panic!("{text}: {e}"));
        let Target::Frame(pose) = table.rows().next().unwrap().target() else {
            panic!("{text}")
        };
        assert!(
            (pose.rotation - expected.matrix()).amax() < 1e-12,
            "{text}: {}",
            pose.rotation
        );
    }
    let swapped = "q1,x_m,y_m,z_m,i,j,k,w\n0.1,1,2,3,0,0,1,0\n";
    let (table, _) = read(swapped, &["quaternion_xyzw=i,j,k,w"], &format).unwrap();
    let Target::Frame(pose) = table.rows().next().unwrap().target() else {
        panic!()
    };
    assert!((pose.rotation - z(std::f64::consts::PI).matrix()).amax() < 1e-12);
}

// Fails if a line has another number than in the file, or what nobody knows is left out without being asked for.
#[test]
fn refusals_name_the_line_of_the_file() {
    let format = TableFormat::new(2);
    let text = "# head\n\nq0,q1,x_mm,y_mm,z_mm\nnan,0,1,2,3\n0,0,1,2,3\n0,zero,1,2,3\n";
    let refused = read(text, &[], &format).unwrap_err();
    assert!(refused.contains("line 6") && refused.contains("\"zero\""), "{refused}");
    let (text, strange) = ("q0,q1,x_mm,y_mm,z_mm,shoe\n0,0,1,2,3,4\n", "\"shoe\" is not known");
    let refused = read(text, &[], &format).unwrap_err();
    assert!(refused.contains(strange), "{refused}");
    let rest = ColumnMapping::parse(&[], true).unwrap();
    let found = recorded("t.csv", text.as_bytes(), &format, &rest).unwrap();
    assert!(
        found.notes.iter().any(|n| n.contains("not used: shoe")),
        "{:?}",
        found.notes
    );
    for (columns, words) in [
        ("point=a,b,c", "\"point=a,b,c\": write MEANING=COLUMN"),
        ("point_mm=a,b", "write MEANING=COLUMN"),
        ("euler_xxy_deg=a,b,c", "write MEANING=COLUMN"),
        ("point_mm=u,v,w", "--columns names \"u\", which is not in the table"),
    ] {
        let refused = read(PLAIN, &[columns], &format).unwrap_err();
        assert!(refused.contains(words), "{refused}");
    }
    // A hidden target of several is not a row without a value.
    let several = "q1,x1_mm,y1_mm,z1_mm,x2_mm,y2_mm,z2_mm\n0,1,2,3,nan,nan,nan\n0,nan,nan,nan,nan,nan,nan\n";
    let (table, found) = read(several, &[], &TableFormat::new(1)).unwrap();
    assert_eq!((table.len(), found.notes.len()), (1, 1), "{found:?}");
    // A contact names its sphere, whatever stands in the columns of points.
    let contacts = "q1,sphere,x_mm,y_mm,z_mm,set\n0,1,nan,nan,nan,\n0.1,2,NaN,NaN,NaN,\n";
    let (table, found) = read(contacts, &[], &TableFormat::new(1)).unwrap();
    assert_eq!(table.len(), 2, "{found:?}");
    // A line that ends early is refused, also where the table is written anew.
    let short = "q1,x_mm,y_mm,z_mm,temperature,place\n0,1,2,3,20,left\n0,1,2,3,20\n";
    let refused = read(short, &[], &TableFormat::new(1)).unwrap_err();
    assert!(refused.contains("line 3"), "{refused}");
}

// Fails if the columns of a robot's other joints are refused, taken for its own, or left out without a word; or if one that
// carries the base and moves is not named.
#[test]
fn joints_beside_the_chain_are_left_out() {
    let format = TableFormat {
        joint_names: names(&["arm_1_joint", "arm_2_joint"]),
        others: names(&["Torso_joint", "head_joint", "wheel_joint"]),
        carriers: names(&["Torso_joint", "wheel_joint"]),
        ..TableFormat::new(2)
    };
    let table = |torso: [f64; 2]| {
        let [a, b] = torso;
        format!(
            "torso_joint_deg,head_joint.pos,arm_2_joint,wheel_joint,arm_1_joint,x_mm,y_mm,z_mm\n\
             {a},3,-1.25,0.001,0.5,100.5,0,-0.25\n{b},4,2,0.002,1.5,7,8,9\n"
        )
    };
    let (plain, _) = read(PLAIN, &[], &format).unwrap();
    for (torso, moves) in [([10.0, 10.2], false), ([10.0, 12.0], true)] {
        let (found, recorded) = read(&table(torso), &[], &format).unwrap();
        assert_eq!(
            found.rows().map(|r| r.q.to_vec()).collect::<Vec<_>>(),
            [[0.5, -1.25], [1.5, 2.0]]
        );
        assert_eq!(
            found.rows().map(|r| r.target()).collect::<Vec<_>>(),
            plain.rows().map(|r| r.target()).collect::<Vec<_>>()
        );
        let notes = recorded.notes.join("; ");
        assert!(
            notes.contains("are not used: torso_joint_deg, head_joint.pos, wheel_joint"),
            "{notes}"
        );
        assert_eq!(
            notes.contains("torso_joint_deg moves in these rows and carries the base"),
            moves,
            "{notes}"
        );
        assert!(!notes.contains("wheel_joint moves"), "{notes}");
    }
    // The reader alone leaves them out, too.
    let csv = table([0.0, 0.0]);
    let alone = read_csv("t.csv", csv.as_bytes(), &format, &mut Labels::default()).unwrap();
    assert_eq!(alone.rows().count(), 2);
}
