//! Writes robots as TOML.

use std::fmt::Write as _;

use spherecal_shared::robot::{Inertia, Pose};

use super::frames::{compose, distance, inverse, to_rpy};
use super::model::{RobotModel, moved};
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
    let rows = model.rows();
    let row = |k: usize| {
        let m = &rows[k];
        let values = [m.alpha, m.a, m.beta, m.theta, m.d].map(float);
        let [alpha, a, beta, theta, d] = values;
        format!("mdh = {{ alpha = {alpha}, a = {a}, beta = {beta}, theta = {theta}, d = {d} }}")
    };
    let law = "Craig's modified DH: T_i = Rx(alpha) Tx(a) Ry(beta) Rz(theta + q) Tz(d); m, rad, kg.";
    whole(model, notes, law, &row, &model.base, &model.flange)
}

/// The same with a standard table.
pub fn write_standard(model: &RobotModel, notes: &[String]) -> String {
    let chain = model.standard();
    // Each link in the frame at its far end.
    let mut far = model.clone();
    for ((joint, own), frame) in far
        .robot
        .joints
        .iter_mut()
        .zip(model.frames_at_zero())
        .zip(chain.frames())
    {
        joint.link = moved(&joint.link, &compose(&inverse(&frame), &own));
    }
    let row = |k: usize| {
        let r = &chain.rows[k];
        let [theta, d, a, alpha] = [r.theta, r.d, r.a, r.alpha].map(float);
        format!("dh = {{ theta = {theta}, d = {d}, a = {a}, alpha = {alpha} }}")
    };
    let law = "Standard DH: T_i = Rz(theta + q) Tz(d) Tx(a) Rx(alpha), frame i at the far end of link i; m, rad, kg.";
    whole(&far, notes, law, &row, &chain.base, &chain.flange)
}

/// Writes a robot whose rows `row` writes, between the frames `base` and `flange`.
fn whole(
    model: &RobotModel,
    notes: &[String],
    law: &str,
    row: &dyn Fn(usize) -> String,
    base: &Pose<f64>,
    flange: &Pose<f64>,
) -> String {
    let mut out = String::new();
    for note in notes.iter().flat_map(|n| n.lines()) {
        let _ = writeln!(out, "# {}", printable(note));
    }
    let _ = writeln!(out, "# {law}");
    let _ = writeln!(out, "name = {}\n", string(&model.robot.name));
    for (k, j) in model.robot.joints.iter().enumerate() {
        let _ = writeln!(out, "[[joint]]");
        if let Some(name) = model.joint_names.get(k) {
            let _ = writeln!(out, "name = {}", string(name));
        }
        let _ = writeln!(out, "{}", row(k));
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
        ("base", root, base, "F0 in the root frame."),
        ("flange", tip, flange, "The flange frame in Fn."),
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
