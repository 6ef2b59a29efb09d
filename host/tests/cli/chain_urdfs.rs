//! Descriptions of robots whose chains are no plain arm.

/// `name type parent child x,y,z axis lower upper` in lines, as a URDF; behind them the joint that this one follows, the other
/// way round.
fn urdf(joints: &str) -> String {
    let mut links: Vec<&str> = Vec::new();
    let mut out = String::from("<robot name=\"talos\">\n");
    for line in joints.lines().filter(|line| !line.trim().is_empty()) {
        let words: Vec<&str> = line.split_whitespace().collect();
        let &[name, kind, parent, child, at, axis, lower, upper, ref leader @ ..] = words.as_slice() else {
            panic!("{line}")
        };
        let mimic = leader.first().map_or(String::new(), |leader| {
            format!("<mimic joint=\"{leader}\" multiplier=\"-1\"/>")
        });
        for link in [parent, child] {
            if !links.contains(&link) {
                links.push(link);
                out += &format!(
                    "<link name=\"{link}\"><inertial><origin xyz=\"0.01 0 0.02\"/><mass value=\"1.5\"/>\
                     <inertia ixx=\"0.01\" ixy=\"0\" ixz=\"0\" iyy=\"0.01\" iyz=\"0\" izz=\"0.01\"/></inertial></link>\n"
                );
            }
        }
        let axis = ["x", "y", "z"].map(|a| if a == axis { "1" } else { "0" }).join(" ");
        out += &format!(
            "<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"{child}\"/>\
             <origin xyz=\"{}\"/><axis xyz=\"{axis}\"/>{mimic}<limit lower=\"{lower}\" upper=\"{upper}\" effort=\"100\" \
             velocity=\"2\"/></joint>\n",
            at.replace(',', " ")
        );
    }
    out + "</robot>\n"
}

/// A humanoid with the names and measures of TALOS: a torso of two joints, a head, two arms with grippers; on a rail if
/// asked for.
pub(crate) fn humanoid(rail: bool) -> String {
    let mut out = String::new();
    if rail {
        out += "rail_joint prismatic world base_link 0,0,0.1 x 0 2\n";
    }
    out += "torso_1_joint revolute base_link torso_1_link 0,0,0.0722 z -1.26 1.26
        torso_2_joint revolute torso_1_link torso_2_link 0,0,0 y -0.23 0.73
        head_1_joint revolute torso_2_link head_1_link 0.02,0,0.321 y -0.2 0.78
        head_2_joint revolute head_1_link head_2_link 0,0,0 z -1.3 1.3
        camera_joint fixed head_2_link camera_link 0.07,0.02,0.11 z 0 0\n";
    for (side, y) in [("left", 1.0), ("right", -1.0)] {
        let arm = [
            (format!("0,{},0.232", 0.1575 * y), "z", -1.57, 0.52),
            (format!("0.00493378,{},0.04673", 0.1365 * y), "x", 0.0, 2.8),
            ("0,0,0".to_owned(), "z", -2.43, 2.43),
            ("0.02,0,-0.273".to_owned(), "y", -2.23, 0.0),
            ("-0.02,0,-0.2643".to_owned(), "z", -2.51, 2.51),
            ("0,0,0".to_owned(), "x", -1.37, 1.37),
            ("0,0,0".to_owned(), "y", -0.68, 0.68),
        ];
        let mut parent = "torso_2_link".to_owned();
        for (k, (at, axis, lower, upper)) in (1..).zip(arm) {
            let child = format!("arm_{side}_{k}_link");
            out += &format!("arm_{side}_{k}_joint revolute {parent} {child} {at} {axis} {lower} {upper}\n");
            parent = child;
        }
        out += &format!(
            "wrist_{side}_tool_joint fixed {parent} wrist_{side}_tool_link 0,0,-0.071 z 0 0
             gripper_{side}_base_joint fixed wrist_{side}_tool_link gripper_{side}_base_link 0,0,0.02 z 0 0
             gripper_{side}_joint revolute gripper_{side}_base_link gripper_{side}_motor_link 0,0.02,0.03 x -1 0\n"
        );
    }
    urdf(&out)
}

/// Two arms of six joints on a torso that turns, each on a mount that is fixed to the torso.
pub(crate) fn two_arms() -> String {
    let mut out = "torso_joint revolute base_link torso_link 0.01,0,0.4 z -1.5 1.5\n".to_owned();
    for (side, y) in [("left", 1.0), ("right", -1.0)] {
        let at = [
            (format!("0,{},0", 0.1 * y), "y", -1.8, 1.8),
            (format!("0.03,{},0", 0.1 * y), "z", -1.5, 1.5),
            ("0.3,0,0".to_owned(), "y", -2.0, 0.2),
            ("0.15,0,0.02".to_owned(), "x", -2.5, 2.5),
            ("0.12,0,0".to_owned(), "y", -1.6, 1.6),
            ("0.05,0.03,0".to_owned(), "x", -2.5, 2.5),
        ];
        out += &format!(
            "{side}_mount fixed torso_link {side}_base 0.05,{},0.3 z 0 0\n",
            0.15 * y
        );
        let mut parent = format!("{side}_base");
        for (k, (at, axis, lower, upper)) in (1..).zip(at) {
            let child = format!("{side}_{k}_link");
            out += &format!("{side}_{k}_joint revolute {parent} {child} {at} {axis} {lower} {upper}\n");
            parent = child;
        }
        out += &format!("{side}_tool_joint fixed {parent} {side}_tool 0.05,0,0 z 0 0\n");
    }
    urdf(&out)
}

/// A lift that carries a head and an arm of seven joints.
pub(crate) fn lift() -> String {
    let mut out = "lift_joint prismatic base_link torso 0,0,0.3 z 0 0.4
        head_joint revolute torso head 0,0,0.6 z -1 1\n"
        .to_owned();
    let mut parent = "torso".to_owned();
    for k in 1..=7 {
        let (axis, at) = [("z", "0.02,0.01,0.14"), ("y", "0.03,-0.02,0.12")][(k + 1) % 2];
        out += &format!("arm_{k}_joint revolute {parent} arm_{k} {at} {axis} -1.8 1.8\n");
        parent = format!("arm_{k}");
    }
    urdf(&(out + &format!("tool_joint fixed {parent} tool0 0,0,0.05 z 0 0\n")))
}

/// An arm of six joints on a rail.
pub(crate) fn rail() -> String {
    urdf(
        "rail_joint prismatic world base_link 0,0,0.1 x 0 2
         j1 revolute base_link l1 0,0,0.3 z -2.5 2.5
         j2 revolute l1 l2 0.05,0.1,0.1 y -1.5 1.5
         j3 revolute l2 l3 0,0,0.4 y -2 0.5
         j4 revolute l3 l4 0.15,0,0.03 x -2.5 2.5
         j5 revolute l4 l5 0.25,0,0 y -1.8 1.8
         j6 revolute l5 l6 0.08,0.02,0 x -2.5 2.5
         tool_joint fixed l6 tool0 0.03,0,0 z 0 0",
    )
}

/// A SCARA.
pub(crate) fn scara() -> String {
    urdf(
        "j1 revolute base_link l1 0,0,0.3 z -2.2 2.2
         j2 revolute l1 l2 0.3,0,0 z -2.4 2.4
         j3 prismatic l2 l3 0.25,0,-0.05 z -0.2 0
         j4 revolute l3 l4 0,0,-0.05 z -3 3
         tool_joint fixed l4 tool0 0,0,-0.02 z 0 0",
    )
}

/// An arm with a parallelogram, whose second rod turns back what the first one turned.
pub(crate) fn parallelogram() -> String {
    urdf(
        "j1 revolute base_link l1 0,0,0.3 z -2.5 2.5
         j2 revolute l1 l2 0.1,0.02,0.1 y -1.2 1.2
         rod revolute l2 l3 0,0,0.4 y -1.2 1.2 j2
         j3 revolute l3 l4 0.03,0,0.05 y -1.5 1.5
         j4 revolute l4 l5 0.3,0.01,0 x -2.5 2.5
         j5 revolute l5 l6 0.1,0,0.02 y -1.8 1.8
         tool_joint fixed l6 tool0 0.05,0,0 z 0 0",
    )
}

/// An arm whose boom slides out between its hinges.
pub(crate) fn telescope() -> String {
    urdf(
        "j1 revolute base_link l1 0,0,0.3 z -2.5 2.5
         j2 revolute l1 l2 0.05,0.02,0.1 y -1.2 1.2
         boom prismatic l2 l3 0.2,0,0.05 x 0 0.4
         j3 revolute l3 l4 0.1,0,0 y -1.5 1.5
         j4 revolute l4 l5 0.1,0.01,0 z -1.8 1.8
         j5 revolute l5 l6 0.1,0,0.02 x -2.5 2.5
         tool_joint fixed l6 tool0 0.05,0,0.03 z 0 0",
    )
}

/// Hinges in a row.
pub(crate) fn hinges(count: usize) -> String {
    let mut out = String::new();
    for k in 0..count {
        let (axis, at) = [("z", "0,0.01,0.12"), ("y", "0.02,0,0.1"), ("x", "0.01,-0.02,0.14")][k % 3];
        out += &format!(
            "joint_{} revolute link_{k} link_{} {at} {axis} -1.6 1.6\n",
            k + 1,
            k + 1
        );
    }
    urdf(&(out + &format!("tool_joint fixed link_{count} tool0 0,0,0.05 z 0 0\n")))
}
