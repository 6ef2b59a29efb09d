//! `spherecal robot`: list, show, convert.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use spherecal_shared::robot::BUILT_IN;

use super::exit::{CliError, Exit, unwritten};
use super::out::outln;
use super::own_calibration::{compare, read};
use spherecal_job::Link;
use spherecal_model::robots::{
    self, JointKind, PathJoint, RobotFileError, RobotModel, toml_file, write_kinematics_yaml, write_urdf,
};
use spherecal_model::{Pose, write_file};

/// Arguments of `robot`.
#[derive(Args, Clone, Debug)]
pub struct RobotArgs {
    /// What to do.
    #[command(subcommand)]
    pub action: RobotAction,
}

/// What `robot` does.
#[derive(Clone, Debug, Subcommand)]
pub enum RobotAction {
    /// List the built-in robots.
    #[command(after_help = "Example: spherecal robot list")]
    List {
        /// Print one JSON document on stdout and nothing else.
        #[arg(long)]
        json: bool,
    },
    /// Show a robot: table, limits, masses, tool.
    #[command(after_help = "Example: spherecal robot show arm.urdf")]
    Show {
        /// Built-in name, FILE.toml, FILE.urdf, FILE.urdf#TIP, or FILE.urdf#BASE:TIP for the chain between these links.
        #[arg(value_name = "NAME|FILE")]
        robot: String,
        /// Print one JSON document on stdout and nothing else.
        #[arg(long)]
        json: bool,
        /// Print the standard Denavit-Hartenberg table in place of the modified one.
        #[arg(long, conflicts_with = "json")]
        standard_dh: bool,
    },
    /// Compare two robots link by link: the nominal one and a calibrated one, or two calibrations.
    ///
    /// Each link's frame is compared in the frame before it, all joints at zero. The lengths are in mm, the small turns in
    /// mrad, both in the axes of the first robot's frame.
    #[command(
        after_help = "Example: spherecal robot compare ur5e contacts.robot.toml\n         spherecal robot compare contacts.robot.toml result/calibrated.toml"
    )]
    Compare {
        /// The first robot: built-in name, FILE.toml, FILE.urdf or FILE.yaml.
        #[arg(value_name = "NAME|FILE")]
        robot: String,
        /// The second robot.
        #[arg(value_name = "NAME|FILE")]
        other: String,
        /// Print one JSON document on stdout and nothing else.
        #[arg(long)]
        json: bool,
    },
    /// Read the calibration that a robot of Universal Robots computes with, compare it with the nominal robot, and write it.
    ///
    /// It only reads: the parameters come from the robot's primary interface. The file's name says its format, as with
    /// `convert`.
    #[command(after_help = "Example: spherecal robot read --link ur:192.168.1.10 my_ur5e.toml")]
    Read {
        /// The robot: ur:HOST.
        #[arg(long, value_name = "LINK", value_parser = super::own_calibration::ur_link)]
        link: Link,
        /// File to write. Without it the comparison alone is shown.
        #[arg(value_name = "TO")]
        to: Option<PathBuf>,
        /// Print one JSON document on stdout and nothing else.
        #[arg(long)]
        json: bool,
    },
    /// Convert a robot to the format that the extension of TO names: .toml, .urdf or .yaml.
    ///
    /// .yaml contains the joint origins with the keys of the vendor's ROS description: Universal
    /// Robots (kinematics_params of ur_description), Franka (kinematics.yaml of
    /// franka_description), or else the joints' names.
    #[command(
        after_help = "Examples:\n  spherecal robot convert arm.urdf arm.toml\n  spherecal robot convert --standard-dh arm.urdf arm.toml\n  spherecal robot convert calibration.conf#ur5e my_ur5e.toml\n  spherecal robot convert spherecal-out/calibrated.toml my_ur5e_calibration.yaml"
    )]
    Convert {
        /// Built-in name, FILE.toml, FILE.urdf, FILE.urdf#TIP, FILE.urdf#BASE:TIP, FILE.yaml (joint origins), or FILE.conf#NAME
        /// (calibration.conf of a controller of Universal Robots, and the built-in arm that it corrects).
        #[arg(value_name = "NAME|FILE")]
        robot: String,
        /// File to write.
        #[arg(value_name = "TO")]
        to: PathBuf,
        /// Write a .toml file with a standard Denavit-Hartenberg table in place of a modified one.
        #[arg(long)]
        standard_dh: bool,
    },
}

/// Does what was asked.
pub(super) fn run(args: &RobotArgs) -> Result<Exit, CliError> {
    match &args.action {
        RobotAction::List { json } => list(*json),
        RobotAction::Compare { robot, other, json } => compare(robot, other, *json)?,
        RobotAction::Read { link, to, json } => {
            let model = read(link, *json)?;
            if let Some(to) = to {
                convert(&model, to, false)?;
                if !json {
                    outln!("\n{}", to.display());
                }
            }
        }
        RobotAction::Show { robot, json: true, .. } => outln!("{:#}", document(&robots::load_path(robot)?)?),
        RobotAction::Show {
            robot,
            standard_dh: true,
            ..
        } => show_standard(&robots::load_path(robot)?),
        RobotAction::Show { robot, .. } => show(&robots::load_path(robot)?)?,
        RobotAction::Convert { robot, to, standard_dh } => {
            convert(&robots::load(robot)?, to, *standard_dh)?;
            outln!("{}", to.display());
        }
    }
    Ok(Exit::Done)
}

fn list(json: bool) {
    let robots: Vec<_> = BUILT_IN
        .iter()
        .map(|name| (name, robots::built_in(name).map_or(0, |m| m.robot.dof())))
        .collect();
    if json {
        let robots: Vec<_> = robots
            .iter()
            .map(|(name, joints)| serde_json::json!({ "name": name, "joints": joints }))
            .collect();
        outln!("{:#}", serde_json::json!({ "robots": robots }));
    } else {
        for (name, joints) in robots {
            outln!("{name:10} {joints} joints");
        }
    }
}

/// A robot as JSON: SI units, named in the fields.
fn document(model: &RobotModel) -> Result<serde_json::Value, RobotFileError> {
    let path = model.joint_path()?;
    let joints = path.joints.iter().map(|joint| {
        let by = joint
            .terms
            .iter()
            .map(|(k, factor)| serde_json::json!({ "column": path.columns.get(*k), "factor": factor }));
        serde_json::json!({
            "name": joint.name,
            "kind": if joint.kind == JointKind::Turns { "turns" } else { "slides" },
            "origin": pose_document(&joint.origin),
            "axis": joint.axis.as_slice(),
            "driven_by": by.collect::<Vec<_>>(),
            "offset": joint.offset,
        })
    });
    Ok(serde_json::json!({
        "chain": joints.collect::<Vec<_>>(),
        "left_out": model.left_out(),
        "notes": model.notes,
        "name": model.robot.name.as_str(),
        "convention": "modified Denavit-Hartenberg; Hayati's beta about y where consecutive axes are near parallel",
        "joints": model.robot.joints,
        "tool": model.tool,
        "root": model.frame_names.0,
        "flange": model.frame_names.1,
        "f0_in_root": pose_document(&model.base),
        "flange_in_fn": pose_document(&model.flange),
    }))
}

/// Roll, pitch and yaw of a pose (about x, then y, then z, fixed axes), in rad.
fn rpy(pose: &Pose<f64>) -> [f64; 3] {
    let r = &pose.rotation;
    [
        r[(2, 1)].atan2(r[(2, 2)]),
        (-r[(2, 0)]).max(-1.0).min(1.0).asin(),
        r[(1, 0)].atan2(r[(0, 0)]),
    ]
}

fn pose_document(pose: &Pose<f64>) -> serde_json::Value {
    let p = &pose.position;
    serde_json::json!({ "position_m": [p.x, p.y, p.z], "rpy_rad": rpy(pose) })
}

/// A pose in mm and degrees, without a sign of zero.
fn pose_words(pose: &Pose<f64>) -> String {
    let three = |values: [f64; 3], digits: i32| {
        let factor = 10f64.powi(digits);
        let words = values.map(|value| ((value * factor).round() / factor + 0.0).to_string());
        words.join(", ")
    };
    let p = &pose.position;
    let at = [p.x, p.y, p.z].map(|m| m * 1e3);
    format!(
        "at ({}) mm, turned by ({}) degrees (roll, pitch, yaw)",
        three(at, 3),
        three(rpy(pose).map(f64::to_degrees), 4)
    )
}

fn show(model: &RobotModel) -> Result<(), RobotFileError> {
    outln!(
        "{}, {} joints (modified DH, mm and degrees)\n",
        model.robot.name,
        model.robot.dof()
    );
    outln!(
        "  {:>5} {:>9} {:>9} {:>9} {:>9} {:>9}   {:>17} {:>8} {:>7} {:>7}",
        "joint",
        "alpha",
        "a",
        "beta",
        "theta",
        "d",
        "range",
        "deg/s",
        "N m",
        "kg"
    );
    for (joint, number) in model.robot.joints.iter().zip(1..) {
        let (r, l) = (&joint.mdh, &joint.limits);
        outln!(
            "  {number:>5} {:9.3} {:9.3} {:9.3} {:9.3} {:9.3}   {:8.1} {:8.1} {:8.1} {:7.1} {:7.3}",
            r.alpha.to_degrees(),
            r.a * 1e3,
            r.beta.to_degrees(),
            r.theta.to_degrees(),
            r.d * 1e3,
            l.min_rad.to_degrees(),
            l.max_rad.to_degrees(),
            l.velocity_rad_s.to_degrees(),
            l.torque_nm,
            joint.link.mass_kg
        );
    }
    let (root, flange) = &model.frame_names;
    outln!(
        "\n  base frame F0, in which placements of the plate are given: in {root} {}",
        pose_words(&model.base)
    );
    outln!(
        "  flange frame {flange}: in the last frame of the table {}",
        pose_words(&model.flange)
    );
    let [x, y, z] = model.tool.tcp_m.map(|m| m * 1e3);
    outln!(
        "  tool: TCP ({x:.3}, {y:.3}, {z:.3}) mm in the flange frame, {:.3} kg",
        model.tool.body.mass_kg
    );
    chain(model)
}

/// Base, joints by name with their axes, tip, and what is beside the chain.
fn chain(model: &RobotModel) -> Result<(), RobotFileError> {
    let path = model.joint_path()?;
    let (base, tip) = &model.frame_names;
    if let Some(words) = model.chain_words() {
        outln!("\n  chain: {words}");
    }
    let named = |joint: &PathJoint| joint.name.chars().count();
    let width = path.joints.iter().map(named).max().unwrap_or(0).clamp(5, 40);
    outln!("\n  {base}");
    let zero = vec![0.0; path.columns.len()];
    let frames = path.frames(&path.positions(&zero));
    for (joint, frame) in path.joints.iter().zip(&frames.before) {
        let three = |v: [f64; 3]| v.map(|x| format!("{:.4}", (x * 1e4).round() / 1e4 + 0.0)).join(", ");
        let kind = if joint.kind == JointKind::Turns {
            "turns about"
        } else {
            "slides along"
        };
        let follows = joint.terms.iter().map(|(k, factor)| {
            let column = path.columns.get(*k).map_or("", String::as_str);
            if *factor == 1.0 {
                column.to_owned()
            } else {
                format!("{factor} x {column}")
            }
        });
        let follows: Vec<String> = follows.collect();
        let follows = if follows == [joint.name.clone()] || joint.name.is_empty() {
            String::new()
        } else {
            format!(", follows {}", follows.join(" + "))
        };
        outln!(
            "   |- {:width$} {kind} ({}) at ({}) mm{follows}",
            joint.name,
            three((frame.rotation * joint.axis).into()),
            three((frame.position * 1e3).into()),
        );
    }
    outln!("  {tip}   (axes and places in {base}, all joints at zero)");
    let left_out = model.left_out();
    if !left_out.is_empty() {
        outln!("\n  not on the chain: {}", left_out.join("; "));
    }
    for note in &model.notes {
        outln!("\n  note: {note}");
    }
    Ok(())
}

fn show_standard(model: &RobotModel) {
    let chain = model.standard();
    outln!(
        "{}, {} joints (standard DH, mm and degrees)\n",
        model.robot.name,
        chain.rows.len()
    );
    outln!(
        "  {:>5} {:>10} {:>12} {:>10} {:>10}",
        "joint",
        "theta",
        "d",
        "a",
        "alpha"
    );
    for (row, number) in chain.rows.iter().zip(1..) {
        outln!(
            "  {number:>5} {:10.4} {:12.4} {:10.4} {:10.4}",
            row.theta.to_degrees(),
            row.d * 1e3,
            row.a * 1e3,
            row.alpha.to_degrees()
        );
    }
    let (root, flange) = &model.frame_names;
    outln!("\n  frame 0 in {root}: {}", pose_words(&chain.base));
    outln!(
        "  {flange} in frame {}: {}",
        chain.rows.len(),
        pose_words(&chain.flange)
    );
}

fn convert(model: &RobotModel, to: &Path, standard: bool) -> Result<(), CliError> {
    let notes = [format!("written by spherecal {}", env!("CARGO_PKG_VERSION"))];
    let extension = to
        .extension()
        .map(|e| e.to_string_lossy().to_lowercase())
        .unwrap_or_default();
    let text = match extension.as_str() {
        "toml" if standard => toml_file::write_standard(model, &notes),
        _ if standard => {
            return Err(CliError::input(format!(
                "--standard-dh: {} holds no table: end its name in .toml",
                to.display()
            )));
        }
        "toml" => toml_file::write(model, &notes),
        "urdf" | "xml" => write_urdf(model, &model.rows(), &notes),
        "yaml" | "yml" => write_kinematics_yaml(model, &model.rows(), &notes),
        _ => {
            return Err(CliError::input(format!(
                "{}: the extension names no known format: end the name in .toml, .urdf or .yaml",
                to.display()
            )));
        }
    };
    Ok(write_file(to, text).map_err(unwritten(to))?)
}
