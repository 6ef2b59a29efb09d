//! Writes robots as TOML.

use std::fmt::Write as _;

use spherecal_shared::robot::{Inertia, Pose};

use super::frames::{distance, to_rpy};
use super::model::RobotModel;
use crate::printable;

/// A float as TOML that reads back to the same bits.
fn float(v: f64) -> String {
    let text = format!("{v:?}");
    if text.contains(['.', 'e', 'n', 'i']) {
        text
    } else {
        text + ".0"
    }
}

fn floats(values: &[f64]) -> String {
    let words: Vec<String> = values.iter().copied().map(float).collect();
    format!("[{}]", words.join(", "))
}

/// A basic string of TOML.
fn string(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

fn body(out: &mut String, b: &Inertia) {
    let _ = writeln!(
        out,
        "{{ mass_kg = {}, com_m = {}, inertia_kg_m2 = {} }}",
        float(b.mass_kg),
        floats(&b.com_m),
        floats(&b.inertia_kg_m2)
    );
}

/// Writes a robot as TOML; `notes` become comments at its head.
pub fn write(model: &RobotModel, notes: &[String]) -> String {
    let mut out = String::new();
    for note in notes.iter().flat_map(|n| n.lines()) {
        let _ = writeln!(out, "# {}", printable(note));
    }
    let _ = writeln!(
        out,
        "# Craig's modified DH: T_i = Rx(alpha) Tx(a) Ry(beta) Rz(theta + q) Tz(d); m, rad, kg."
    );
    let _ = writeln!(out, "name = {}\n", string(&model.robot.name));
    for (k, j) in model.robot.joints.iter().enumerate() {
        let m = &j.mdh;
        let _ = writeln!(out, "[[joint]]");
        if let Some(name) = model.joint_names.get(k) {
            let _ = writeln!(out, "name = {}", string(name));
        }
        let _ = writeln!(
            out,
            "mdh = {{ alpha = {}, a = {}, beta = {}, theta = {}, d = {} }}",
            float(m.alpha),
            float(m.a),
            float(m.beta),
            float(m.theta),
            float(m.d)
        );
        out.push_str("link = ");
        body(&mut out, &j.link);
        let l = &j.limits;
        let _ = writeln!(
            out,
            "limits = {{ min_rad = {}, max_rad = {}, velocity_rad_s = {}, torque_nm = {} }}",
            float(l.min_rad),
            float(l.max_rad),
            float(l.velocity_rad_s),
            float(l.torque_nm)
        );
        if j.rotor_kg_m2 != 0.0 {
            let _ = writeln!(out, "rotor_kg_m2 = {}", float(j.rotor_kg_m2));
        }
        out.push('\n');
    }
    let _ = writeln!(
        out,
        "# In the flange frame.\n[tool]\ntcp_m = {}",
        floats(&model.tool.tcp_m)
    );
    if model.tool.body.mass_kg > 0.0 {
        out.push_str("body = ");
        body(&mut out, &model.tool.body);
    }
    let t = &model.tolerances;
    let stated = [
        ("length_m", t.length_m),
        ("twist_rad", t.twist_rad),
        ("offset_rad", t.offset_rad),
    ];
    if stated.iter().any(|(_, value)| value.is_some()) {
        out.push_str("\n# How far the table may be from the arm: 1 sigma.\n[tolerances]\n");
        for (name, value) in stated {
            if let Some(value) = value {
                let _ = writeln!(out, "{name} = {}", float(value));
            }
        }
    }
    let (root, tip) = &model.frame_names;
    for (table, name, frame, what) in [
        ("base", root, &model.base, "F0 in the root frame."),
        ("flange", tip, &model.flange, "The flange frame in Fn."),
    ] {
        if distance(frame, &Pose::identity()) > 0.0 || name != table {
            let rpy = to_rpy(&frame.rotation);
            let _ = writeln!(
                out,
                "\n# {what}\n[{table}]\nname = {}\nxyz_m = {}\nrpy_rad = {}",
                string(name),
                floats(frame.position.as_slice()),
                floats(&rpy)
            );
        }
    }
    out
}
