//! The calibration that a robot of Universal Robots computes with, and robots compared link by link.

use std::path::Path;

use serde_json::{Value, json};
use spherecal_job::Link;
use spherecal_link::UrReader;
use spherecal_model::robots::{self, RobotDifference, RobotModel, UrParameters, compare as difference, toml_file};
use spherecal_model::write_file;

use super::args::BadValue;
use super::exit::{CliError, unwritten};
use super::out::{errln, outln};

/// A link to a robot of Universal Robots.
pub(super) fn ur_link(text: &str) -> Result<Link, BadValue> {
    match text.parse() {
        Ok(link @ Link::Ur { .. }) => Ok(link),
        _ => Err(BadValue("give ur:HOST")),
    }
}

/// The robot as its controller computes it.
fn own_model(reader: &UrReader) -> Result<RobotModel, CliError> {
    let info = reader.kinematics()?;
    let dh = UrParameters {
        theta: info.theta,
        a: info.a,
        d: info.d,
        alpha: info.alpha,
    };
    let mut model = dh.robot().map_err(CliError::input)?;
    if info.status != 0 {
        let note = format!(
            "the robot says that its calibration has the status {}, where 0 is good",
            info.status
        );
        model.notes.push(note);
    }
    Ok(model)
}

/// The built-in robot that this one was before it was calibrated, and the difference.
fn from_nominal(model: &RobotModel) -> Option<(RobotModel, RobotDifference)> {
    let nominal = robots::built_in(&model.robot.name)?;
    let difference = difference(&nominal, model)?;
    Some((nominal, difference))
}

/// Writes the robot that is connected beside the table `out`, and returns the file's name.
pub(super) fn own_robot(reader: &UrReader, out: &Path) -> Result<String, CliError> {
    let model = own_model(reader).map_err(|error| {
        CliError::job(format!(
            "{error}; to go without the robot's own calibration, give --robot NAME|FILE"
        ))
    })?;
    let path = out.with_extension("robot.toml");
    let notes = [format!("as its controller (software {}) computes it", reader.version())];
    write_file(&path, toml_file::write(&model, &notes)).map_err(unwritten(&path))?;
    let file = path.display();
    match from_nominal(&model) {
        Some((nominal, found)) => errln!(
            "The robot is a {}. As it computes itself it is in {file}: its flange is {} from the nominal one.",
            nominal.robot.name,
            distance_words(&found)
        ),
        None => errln!("The robot is none that is built in. As it computes itself it is in {file}, without masses."),
    }
    for note in &model.notes {
        errln!("note: {note}");
    }
    Ok(file.to_string())
}

pub(super) fn read(link: &Link, as_json: bool) -> Result<RobotModel, CliError> {
    let Link::Ur { host, port } = link else {
        return Err(CliError::input("--link: give ur:HOST"));
    };
    let reader = UrReader::connect(host, *port)?;
    let model = own_model(&reader)?;
    let nominal = from_nominal(&model);
    if as_json {
        let difference = nominal.as_ref().map(|(_, found)| document(found));
        let name = nominal.as_ref().map(|(nominal, _)| nominal.robot.name.as_str());
        outln!(
            "{:#}",
            json!({ "robot": name, "software": reader.version(), "notes": model.notes, "from_nominal": difference })
        );
        return Ok(model);
    }
    let software = reader.version();
    match &nominal {
        Some((nominal, found)) => {
            outln!(
                "{} (software {software}), as it computes itself against the nominal robot\n",
                nominal.robot.name
            );
            table(found);
        }
        None => outln!("a robot that is not built in (software {software})"),
    }
    for note in &model.notes {
        outln!("\nnote: {note}");
    }
    Ok(model)
}

pub(super) fn compare(robot: &str, other: &str, as_json: bool) -> Result<(), CliError> {
    let (own, second) = (robots::load(robot)?, robots::load(other)?);
    let found = difference(&own, &second).ok_or_else(|| {
        CliError::input(format!(
            "{robot} has {} joints, but {other} has {}: give two robots of one kind",
            own.robot.dof(),
            second.robot.dof()
        ))
    })?;
    if as_json {
        outln!("{:#}", document(&found));
    } else {
        outln!("{other} against {robot}\n");
        table(&found);
    }
    Ok(())
}

fn document(found: &RobotDifference) -> Value {
    let links = found
        .links
        .iter()
        .map(|link| json!({ "link": link.name, "shift_m": link.shift_m, "turn_rad": link.turn_rad }));
    json!({ "links": links.collect::<Vec<_>>(), "flange_mean_m": found.mean_m, "flange_max_m": found.max_m })
}

fn distance_words(found: &RobotDifference) -> String {
    format!(
        "{:.2} mm in the mean over its workspace, at most {:.2} mm,",
        found.mean_m * 1e3,
        found.max_m * 1e3
    )
}

/// Link by link, in mm and mrad.
fn table(found: &RobotDifference) {
    outln!(
        "  {:20} {:>8} {:>8} {:>8}   {:>8} {:>8} {:>8}",
        "up to",
        "x mm",
        "y mm",
        "z mm",
        "x mrad",
        "y mrad",
        "z mrad"
    );
    for link in &found.links {
        let number = |value: f64| format!("{:8.3}", (value * 1e6).round() / 1e3 + 0.0);
        let [x, y, z] = link.shift_m.map(number);
        let [a, b, c] = link.turn_rad.map(number);
        outln!("  {:20} {x} {y} {z}   {a} {b} {c}", link.name);
    }
    outln!("\n  flange: {} from the first robot's", distance_words(found));
}
