//! From a (calibrated) table back to a URDF.
//!
//! A link frame of a URDF rides on a joint of the table: it is fixed in Fi.
//! That constant is taken from the nominal table; the calibrated joint origins
//! follow from it and the calibrated frames, so that the forward kinematics of
//! the file are those of the table. All else in the file (meshes, inertias,
//! names, comments) stays as it was.

use std::fmt::Write as _;

use nalgebra::Vector3;
use spherecal_shared::robot::{MdhRow, Pose};

use super::frames::{compose, distance, inverse, row_transform, to_rpy_near};
use super::model::{Origin, RobotModel, table_frames};
use super::urdf::{JointMotion, OriginPlace, Urdf, UrdfChain, UrdfJoint};
use super::urdf_in::frames_at_zero;

/// Origins closer to the file's own than this (m, or an entry of the rotation)
/// are left as the file writes them.
pub(super) const SAME: f64 = 1e-13;

/// What gives a URDF's chain the kinematics of a table, each with the index of its joint.
#[derive(Clone, Debug, Default)]
pub(super) struct Corrected {
    pub(super) origins: Vec<(usize, Pose<f64>)>,
    /// Axes of sliding joints, in their own frames.
    axes: Vec<(usize, Vector3<f64>)>,
}

/// The joint origins that give a URDF's chain the kinematics of a table, and the axes of the slides as the model has them.
pub(super) fn corrected(model: &RobotModel, urdf: &Urdf, chain: &UrdfChain, rows: &[MdhRow<f64>]) -> Corrected {
    let zero = vec![0.0; rows.len()];
    let nominal = table_frames(&model.rows(), &zero);
    let calibrated = table_frames(rows, &zero);
    let (in_file, _) = frames_at_zero(urdf, chain);
    let mut out = Corrected::default();
    let mut slides = model.slides.iter();
    let mut before = Pose::identity();
    let mut n = 0;
    // A frame of the file that rides on joint `n` of the table.
    let riding = |n: usize, in_file: &Pose<f64>| match (nominal.get(n), calibrated.get(n)) {
        (Some(was), Some(is)) => {
            let in_link = compose(&inverse(&compose(&model.base, was)), in_file);
            compose(&compose(&model.base, is), &in_link)
        }
        _ => *in_file,
    };
    // Upwards the child's frame must be on its joint's axis, so what stands before a joint rides on it, up to the next.
    let turns = |i: &usize| urdf.joints[*i].motion == JointMotion::Turns;
    let up = chain.path.iter().take(chain.up);
    let last_up = up.clone().filter(|i| turns(i)).count().checked_sub(1);
    for (k, i) in up.enumerate() {
        let joint = &urdf.joints[*i];
        let place = |n: usize, frame: &Pose<f64>| last_up.map_or(*frame, |last| riding(n.min(last), frame));
        let here = if k == 0 && !turns(i) {
            before
        } else {
            place(n, &in_file[k])
        };
        n += usize::from(turns(i));
        before = place(n, &compose(&in_file[k], &inverse(&joint.origin)));
        out.origins.push((*i, compose(&inverse(&before), &here)));
        if joint.motion == JointMotion::Slides
            && let Some(direction) = slides.next()
        {
            out.axes.push((*i, here.rotation.tr_mul(&-direction)));
        }
    }
    for (k, &i) in chain.path.iter().enumerate().skip(chain.up) {
        let joint = &urdf.joints[i];
        if joint.motion == JointMotion::Turns {
            let here = riding(n, &in_file[k]);
            out.origins.push((i, compose(&inverse(&before), &here)));
            before = here;
            n += 1;
        } else {
            before = compose(&before, &joint.origin);
        }
        if joint.motion == JointMotion::Slides
            && let Some(direction) = slides.next()
        {
            out.axes.push((i, before.rotation.tr_mul(direction)));
        }
    }
    out
}

/// Numbers as an attribute holds them.
fn numbers(v: &[f64]) -> String {
    let words: Vec<String> = v.iter().map(|x| format!("{}", x + 0.0)).collect();
    words.join(" ")
}

/// Text of an `<origin/>`; its angles are those nearest to `like`.
fn origin_element(frame: &Pose<f64>, like: [f64; 3]) -> String {
    format!(
        "<origin xyz=\"{}\" rpy=\"{}\"/>",
        numbers(frame.position.as_slice()),
        numbers(&to_rpy_near(&frame.rotation, like))
    )
}

/// Text as an XML comment (which must not hold two hyphens).
fn comment(notes: &[String]) -> String {
    if notes.is_empty() {
        return String::new();
    }
    let mut text = notes.join("\n     ");
    while text.contains("--") {
        text = text.replace("--", "- -");
    }
    format!("<!-- {text} -->\n")
}

/// Text inside an XML attribute.
fn attribute(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

/// The robot as a URDF whose forward kinematics are those of `rows`: the input
/// with corrected joint origins where the robot came from a URDF, else a new
/// one. `notes` become a comment before the root element.
pub fn write_urdf(model: &RobotModel, rows: &[MdhRow<f64>], notes: &[String]) -> String {
    match &model.origin {
        Origin::Urdf(source) => edited(&source.0, corrected(model, &source.0, &source.1, rows), notes),
        _ => new_urdf(model, rows, notes),
    }
}

/// The text of a URDF with other joint origins.
pub(super) fn edited(urdf: &Urdf, corrected: Corrected, notes: &[String]) -> String {
    let mut edits: Vec<(usize, usize, String)> = vec![(urdf.root_at, urdf.root_at, comment(notes))];
    for (i, origin) in corrected.origins {
        let joint = &urdf.joints[i];
        if distance(&origin, &joint.origin) < SAME {
            continue;
        }
        match &joint.place {
            OriginPlace::Element(range) => edits.push((range.start, range.end, origin_element(&origin, joint.rpy))),
            OriginPlace::Absent(at) => edits.push((*at, *at, origin_element(&origin, joint.rpy))),
        }
    }
    for (i, axis) in corrected.axes {
        let text = format!("<axis xyz=\"{}\"/>", numbers(axis.as_slice()));
        match &urdf.joints[i].axis_place {
            OriginPlace::Element(range) => edits.push((range.start, range.end, text)),
            OriginPlace::Absent(at) => edits.push((*at, *at, text)),
        }
    }
    edits.sort_by_key(|e| e.0);
    let mut out = String::with_capacity(urdf.text.len() + 1000);
    let mut at = 0;
    for (start, end, text) in edits {
        out.push_str(urdf.text.get(at..start).unwrap_or(""));
        out.push_str(&text);
        at = end.max(at);
    }
    out.push_str(urdf.text.get(at..).unwrap_or(""));
    out
}

/// The same with the TCP (m, in the flange's frame) as a link of its own, `<robot>_tcp`, beside the user's. That of an
/// earlier calibration is moved.
pub fn write_urdf_with_tcp(model: &RobotModel, rows: &[MdhRow<f64>], notes: &[String], tcp_m: &[f64; 3]) -> String {
    let tip = &model.frame_names.1;
    let mut known: &[String] = &[];
    if let Origin::Urdf(source) = &model.origin {
        if let Some(i) = own_tcp(&source.0, tip) {
            let mut corrected = corrected(model, &source.0, &source.1, rows);
            corrected.origins.push((i, tcp_frame(tcp_m)));
            return edited(&source.0, corrected, notes);
        }
        known = &source.0.links;
    }
    let mut out = write_urdf(model, rows, notes);
    add_tcp(&mut out, &model.robot.name, known, tip, tcp_m);
    out
}

/// The joint that carries the tool centre point of a tip, where an earlier calibration wrote one.
pub(super) fn own_tcp(urdf: &Urdf, tip: &str) -> Option<usize> {
    let earlier = |joint: &UrdfJoint| joint.carries_own_tcp() && joint.parent == *tip;
    urdf.joints.iter().position(earlier)
}

/// A tool centre point (m) as a frame.
pub(super) fn tcp_frame(tcp_m: &[f64; 3]) -> Pose<f64> {
    Pose {
        position: (*tcp_m).into(),
        ..Pose::identity()
    }
}

/// Adds the tool centre point (m) of a tip to the text of a URDF as a link, `<name>_tcp`, unless this is a `known` link.
pub(super) fn add_tcp(out: &mut String, name: &str, known: &[String], tip: &str, tcp_m: &[f64; 3]) {
    let Some(end) = out.rfind("</robot>") else { return };
    let name: String = name
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '_' })
        .collect();
    let mut link = format!("{name}_tcp");
    while known.contains(&link) {
        link = format!("calibrated_{link}");
    }
    out.insert_str(
        end,
        &format!(
            "  <!-- the tool centre point that belongs to this geometry -->\n  <link name=\"{link}\"/>\n  \
             <joint name=\"{}\" type=\"fixed\">\n    {}\n    <parent link=\"{}\"/>\n    \
             <child link=\"{link}\"/>\n  </joint>\n",
            attribute(&UrdfJoint::name_of_tcp(tip, &link)),
            origin_element(&tcp_frame(tcp_m), [0.0; 3]),
            attribute(tip)
        ),
    );
}

/// Radius of a link as it is drawn, in m: arms of 5 to 20 kg payload are about 0.1 m thick.
const BAR_M: f64 = 0.05;

/// What a viewer draws of a link whose next joint is at `end` (m, in the link's frame): a bar between both joints. Nothing
/// where they are in one place.
fn bar(end: &Vector3<f64>) -> String {
    let length = end.norm();
    if length < BAR_M {
        return String::new();
    }
    let middle = end / 2.0;
    // The cylinder's axis is z: turned about y, then about z.
    let (pitch, yaw) = ((end.z / length).acos(), end.y.atan2(end.x));
    format!(
        "    <visual>\n      <origin xyz=\"{}\" rpy=\"{}\"/>\n      <geometry><cylinder radius=\"{BAR_M}\" \
         length=\"{length}\"/></geometry>\n    </visual>\n",
        numbers(middle.as_slice()),
        numbers(&[0.0, pitch, yaw])
    )
}

/// A URDF for a robot that came without one.
fn new_urdf(model: &RobotModel, rows: &[MdhRow<f64>], notes: &[String]) -> String {
    let (root, tip) = &model.frame_names;
    // Each joint in the frame of its parent; the last is the flange.
    let mut origins: Vec<Pose<f64>> = rows.iter().map(|row| row_transform(row, 0.0)).collect();
    if let Some(first) = origins.first_mut() {
        *first = compose(&model.base, first);
    }
    let ends = origins.iter().skip(1).chain([&model.flange]);
    let mut out = format!(
        "<?xml version=\"1.0\"?>\n{}<robot name=\"{}\">\n  <link name=\"{}\">\n{}  </link>\n",
        comment(notes),
        attribute(&model.robot.name),
        attribute(root),
        origins.first().map_or_else(String::new, |first| bar(&first.position))
    );
    let mut parent = attribute(root);
    for (k, ((joint, origin), end)) in model.robot.joints.iter().zip(&origins).zip(ends).enumerate() {
        let child = format!("link_{}", k + 1);
        let b = &joint.link;
        let [xx, yy, zz, xy, xz, yz] = b.inertia_kg_m2;
        let _ = write!(
            out,
            "  <link name=\"{child}\">\n    <inertial>\n      <origin xyz=\"{} {} {}\" rpy=\"0 0 0\"/>\n      \
             <mass value=\"{}\"/>\n      <inertia ixx=\"{xx}\" ixy=\"{xy}\" ixz=\"{xz}\" iyy=\"{yy}\" iyz=\"{yz}\" \
             izz=\"{zz}\"/>\n    </inertial>\n{}  </link>\n",
            b.com_m[0],
            b.com_m[1],
            b.com_m[2],
            b.mass_kg,
            bar(&end.position)
        );
        let l = &joint.limits;
        let _ = write!(
            out,
            "  <joint name=\"joint_{}\" type=\"revolute\">\n    {}\n    <parent link=\"{parent}\"/>\n    \
             <child link=\"{child}\"/>\n    <axis xyz=\"0 0 1\"/>\n    \
             <limit lower=\"{}\" upper=\"{}\" velocity=\"{}\" effort=\"{}\"/>\n  </joint>\n",
            k + 1,
            origin_element(origin, [0.0; 3]),
            l.min_rad,
            l.max_rad,
            l.velocity_rad_s,
            l.torque_nm
        );
        parent = child;
    }
    let tip = attribute(tip);
    let _ = write!(
        out,
        "  <link name=\"{tip}\"/>\n  <joint name=\"{parent}-{tip}\" type=\"fixed\">\n    {}\n    \
         <parent link=\"{parent}\"/>\n    <child link=\"{tip}\"/>\n  </joint>\n</robot>\n",
        origin_element(&model.flange, [0.0; 3])
    );
    out
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;

    use super::super::built_in;
    use super::*;

    // Fails if a viewer draws a bar of a built-in arm that does not lead from its joint to the next one, or none.
    #[test]
    fn bars_lead_from_joint_to_joint() {
        for name in ["iiwa7", "ur5e", "fr3"] {
            let model = built_in(name).expect("built in");
            let text = write_urdf(&model, &model.rows(), &[]);
            let document = roxmltree::Document::parse(&text).expect("XML");
            let values = |node: roxmltree::Node<'_, '_>, name: &str| -> Vec<f64> {
                let words = node.attribute(name).expect(name).split(' ');
                words.map(|word| word.parse().expect("a number")).collect()
            };
            let origin = |node: roxmltree::Node<'_, '_>| {
                let origin = node.children().find(|n| n.has_tag_name("origin")).expect("an origin");
                (Vector3::from_vec(values(origin, "xyz")), values(origin, "rpy"))
            };
            let mut bars = 0;
            for visual in document.descendants().filter(|n| n.has_tag_name("visual")) {
                let link = visual.parent().and_then(|n| n.attribute("name")).expect("a link");
                let leads_away = |n: &roxmltree::Node<'_, '_>| {
                    let parent = n.children().find(|n| n.has_tag_name("parent"));
                    n.has_tag_name("joint") && parent.and_then(|p| p.attribute("link")) == Some(link)
                };
                let next = document.descendants().find(leads_away).expect("a joint");
                let (middle, rpy) = origin(visual);
                let cylinder = visual
                    .descendants()
                    .find(|n| n.has_tag_name("cylinder"))
                    .expect("a bar");
                let half = Vector3::z() * values(cylinder, "length")[0] / 2.0;
                let along = Rotation3::from_euler_angles(rpy[0], rpy[1], rpy[2]) * half;
                assert!(
                    (middle - along).norm() < 1e-9,
                    "{name}, {link}: begins beside its joint"
                );
                assert!(
                    (middle + along - origin(next).0).norm() < 1e-9,
                    "{name}, {link}: ends beside the next joint"
                );
                bars += 1;
            }
            assert!(bars >= 4, "{name}: {bars} bars");
        }
    }
}
