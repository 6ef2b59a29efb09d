//! `spherecal plant --ur`: the simulated arm behind the interfaces of Universal Robots, in real time.

use std::path::Path;

use spherecal_model::robots::{UrParameters, ur_lengths};
use spherecal_ur::robot::{ArmHardware, RobotConfig, start_robot};
use spherecal_ur::robot_api_port;
use spherecal_ur::wire::{ControllerVersion, KinematicsInfo, Series};

use super::exit::{CliError, Exit, interrupt};
use super::out::{announce, errln, warn_if_open};
use super::robot_sides::{PlantArgs, address, guided, lines, wait};
use crate::simulated;
use spherecal_job as job;

/// The robot without `--config`; with `--cb3` it is that of [`CB3`] which is as large.
const ROBOT: &str = "ur5e";
/// Robots of the CB3 series.
const CB3: [&str; 3] = ["ur5", "ur3", "ur10"];

/// The largest number in a calibration: rad, or m between the frames of parallel joints.
const MOST: f64 = 1e5;

/// The parameters of a file: a line for each joint.
fn parameters(path: &Path) -> Result<UrParameters, CliError> {
    let rows: Vec<[f64; 4]> = lines(path, MOST, "theta, a, d and alpha of a joint")?;
    let rows: [[f64; 4]; 6] = rows.try_into().map_err(|rows: Vec<_>| {
        CliError::input(format!(
            "{}: {} lines: give one for each of 6 joints",
            path.display(),
            rows.len()
        ))
    })?;
    let column = |k: usize| rows.map(|row| row[k]);
    Ok(UrParameters {
        theta: column(0),
        a: column(1),
        d: column(2),
        alpha: column(3),
    })
}

/// `spherecal plant --ur`
pub(super) fn universal_robots(args: &PlantArgs, at: &str) -> Result<Exit, CliError> {
    let at = address("--ur", at)?;
    let mut config = args.configuration()?;
    if args.config.is_none() {
        (if args.cb3 { CB3[0] } else { ROBOT }).clone_into(&mut config.robot);
    }
    let series = if CB3.contains(&config.robot.as_str()) {
        Series::Cb3
    } else {
        Series::ESeries
    };
    let nominal = ur_lengths(&config.robot).ok_or_else(|| {
        CliError::input(format!(
            "--ur: robot is \"{}\", which is none of Universal Robots: write robot = \"{ROBOT}\" in the configuration, or leave \
             --config out",
            config.robot
        ))
    })?;
    if args.cb3 && series != Series::Cb3 {
        return Err(CliError::input(format!(
            "--cb3: robot is \"{}\", which is no CB3: write robot = \"ur5\" in the configuration, or leave --cb3 out",
            config.robot
        )));
    }
    if args.polyscope_x && series == Series::Cb3 {
        return Err(CliError::input(format!(
            "--polyscope-x: robot is \"{}\", a CB3, whose software is 3: leave --polyscope-x out",
            config.robot
        )));
    }
    let dh = match &args.dh {
        Some(path) => parameters(path)?,
        None => UrParameters::of_lengths(nominal),
    };
    let arm: Box<dyn ArmHardware> = match &args.guide {
        Some(path) => Box::new(guided::<6>(&config, path)?),
        None => Box::new(simulated::ur_robot(&config)?),
    };
    let kinematics = KinematicsInfo {
        theta: dh.theta,
        a: dh.a,
        d: dh.d,
        alpha: dh.alpha,
        ..KinematicsInfo::default()
    };
    let model = job::loaded_model(&config)?;
    let limits = |joint: usize| model.robot.joints.get(joint).map(|joint| &joint.limits);
    let mut side = RobotConfig {
        address: at,
        limits: std::array::from_fn(|joint| {
            limits(joint).map_or((0.0, 0.0), |limits| (limits.velocity_rad_s, limits.torque_nm))
        }),
        ..RobotConfig::new(series, kinematics)
    };
    let mut ports = at.to_string();
    if args.polyscope_x {
        side.version = ControllerVersion::POLYSCOPE_X;
        // Port 80 is not everybody's.
        ports = format!("{at}, and at port {} for the Robot API", robot_api_port(at.port()));
    }
    warn_if_open("plant", at);
    let interrupt = interrupt()?;
    let version = side.version;
    let side = start_robot(side, arm)
        .map_err(|error| CliError::input(format!("cannot listen at {ports}: {error}; is another robot running?")))?;
    announce(&format!(
        "RTDE (software {version}, {}), on ur:{}",
        config.robot,
        side.address()
    ));
    wait(&interrupt, || ());
    let s = side.shut_down();
    errln!(
        "{} periods ({} behind the wall clock), {} data packages, {} inputs, {} broken connections, {} programs ({} refused), {} \
         periods with torques, {} programs without torques in time, {} protective stops by a limit",
        s.periods,
        s.slipped,
        s.packages,
        s.inputs,
        s.broken,
        s.programs,
        s.refused,
        s.followed,
        s.silent,
        s.limits
    );
    Ok(Exit::Done)
}
