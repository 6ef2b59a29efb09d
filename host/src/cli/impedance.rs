//! `spherecal impedance`: holds the arm by a Cartesian spring that lines on the standard input set.

use std::time::{Duration, Instant};

use clap::Args;
use serde::Deserialize;
use spherecal_campaign::{Answer, CampaignError, CampaignObserver, ManualControl, Order};
use spherecal_job as job;
use spherecal_shared::protocol::host::{ImpedanceCommand, Sample};

use super::args::RunArgs;
use super::exit::{CliError, Exit, interrupt, unwritten};
use super::features;
use super::out::{errln, outln};
use super::progress::{Entered, TerminalOperator};

/// Time between two lines of output, in µs of device time.
const EVERY_US: u64 = 100_000;
/// Longest wait that a line may ask for, in s.
const WAIT_S: f64 = 3600.0;

/// Hold the arm by a Cartesian spring, and set it live.
///
/// The arm is held where it is. Each line on the standard input is one JSON object; all its fields are optional:
///
///   "stiffness": 400 or [400, 400, 200]   N/m along the axes of the robot's base, from 0 to 5000
///   "rotation": 50                        N m/rad, from 0 to 300
///   "move_mm": [0, 0, 10]                 moves the spring's rest, up to 300 mm from the beginning
///   "turn_deg": [0, 0, 5]                 turns it: a rotation vector from the beginning, up to 57 degrees
///   "wait_s": 2                           the next line is read so much later
///   "stop": true                          ends, as the end of the input and Ctrl-C do: the arm then holds
///
/// A line that cannot be used is told, and changes nothing. Ten times a second a line tells where the TCP is, how far it is
/// off the spring's rest, and the force and moment on it. All guards of the controller hold: a fault ends the command.
#[derive(Args, Clone, Debug)]
#[command(
    after_help = "Examples: spherecal impedance --link franka:172.16.0.2 --config cell.toml\n          \
    echo '{\"move_mm\": [0, 0, 10], \"wait_s\": 2}' | spherecal impedance --link sim --json\n\n\
    Exit codes: 0 ended as asked; 1 a fault, or the link failed; 2 wrong input."
)]
pub struct ImpedanceArgs {
    #[command(flatten)]
    pub(super) run: RunArgs,
    /// Stiffness of translation at the beginning, in N/m.
    #[arg(long, value_name = "N/M", default_value_t = 400.0)]
    stiffness: f64,
    /// Stiffness of rotation at the beginning, in N m/rad.
    #[arg(long, value_name = "NM/RAD", default_value_t = 50.0)]
    rotation: f64,
}

/// A stiffness along all axes, or along each.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(untagged)]
enum Along {
    All(f64),
    Each([f64; 3]),
}

#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields)]
struct Line {
    stiffness: Option<Along>,
    rotation: Option<f64>,
    move_mm: Option<[f64; 3]>,
    turn_deg: Option<[f64; 3]>,
    wait_s: f64,
    stop: bool,
}

impl Line {
    /// Reads a line. `Err`: what is wrong with it, in words.
    fn read(text: &str) -> Result<Self, String> {
        let line: Self = serde_json::from_str(text).map_err(|error| error.to_string())?;
        if !(0.0..=WAIT_S).contains(&line.wait_s) {
            return Err(format!("wait_s is {}: give a value from 0 to {WAIT_S}", line.wait_s));
        }
        Ok(line)
    }

    /// The spring after this line. `Err`: the field, its value and its range.
    fn applied(&self, spring: &ImpedanceCommand) -> Result<ImpedanceCommand, String> {
        let mut spring = *spring;
        match self.stiffness {
            Some(Along::All(stiffness)) => spring.stiffness_n_m = [stiffness; 3],
            Some(Along::Each(stiffness)) => spring.stiffness_n_m = stiffness,
            None => {}
        }
        spring.rotation_nm_rad = self.rotation.unwrap_or(spring.rotation_nm_rad);
        let moved = self.move_mm.unwrap_or_default();
        spring.offset_m = std::array::from_fn(|i| spring.offset_m[i] + 1e-3 * moved[i]);
        if let Some(turn) = self.turn_deg {
            spring.turn_rad = turn.map(f64::to_radians);
        }
        checked(&spring)?;
        Ok(spring)
    }
}

/// Checks a spring. `Err`: the field as a line has it, its value in the line's unit, and its range.
fn checked(spring: &ImpedanceCommand) -> Result<(), String> {
    let Err(error) = spring.check() else {
        return Ok(());
    };
    let (field, unit) = match error.field {
        "stiffness_n_m" => ("stiffness", 1.0),
        "rotation_nm_rad" => ("rotation", 1.0),
        "offset_m" => ("move_mm, added up,", 1e3),
        _ => ("turn_deg", 1f64.to_degrees()),
    };
    let [value, min, max] = [error.value, error.min, error.max].map(|x| (1e3 * unit * x).round() / 1e3);
    Err(format!("{field} is {value}: give a value from {min} to {max}"))
}

/// Remarks of the campaign, on stderr.
struct Remarks;

impl CampaignObserver for Remarks {
    fn note(&mut self, text: &str) {
        errln!("{text}");
    }
}

/// Tells a line that was not used.
fn refuse(json: bool, why: &str) {
    if json {
        outln!("{}", serde_json::json!({"refused": why}));
    } else {
        errln!("refused: {why}");
    }
}

/// Tells the state of the arm.
fn tell(json: bool, time_us: u64, sample: &Sample, spring: &ImpedanceCommand) {
    let time_s = time_us as f64 * 1e-6;
    if json {
        let document = serde_json::json!({
            "time_s": time_s,
            "tcp_m": sample.tcp_m,
            "rest_m": sample.setpoint_m,
            "force_n": sample.force_n,
            "torque_nm": sample.torque_nm,
            "stiffness_n_m": spring.stiffness_n_m,
            "rotation_nm_rad": spring.rotation_nm_rad,
        });
        outln!("{document}");
        return;
    }
    let [x, y, z] = sample.tcp_m.map(|v| v * 1e3);
    let [a, b, c]: [f32; 3] = std::array::from_fn(|i| (sample.tcp_m[i] - sample.setpoint_m[i]) * 1e3);
    let ([f, g, h], [k, l, m]) = (sample.force_n, sample.torque_nm);
    outln!(
        "{time_s:7.1} s  TCP {x:8.2} {y:8.2} {z:8.2} mm  off {a:6.2} {b:6.2} {c:6.2} mm  force {f:6.1} {g:6.1} {h:6.1} N  moment \
         {k:6.2} {l:6.2} {m:6.2} N m"
    );
}

/// Holds the arm until the input ends. Returns the fault that ended it, in words.
fn hold(
    args: &ImpedanceArgs,
    control: &mut ManualControl<'_>,
    mut spring: ImpedanceCommand,
    interrupted: impl Fn() -> bool,
) -> Result<Option<String>, CampaignError> {
    let json = args.run.json;
    let order = |control: &mut ManualControl<'_>, spring: &ImpedanceCommand| {
        let Answer { refused, .. } = control.carry_out(&Order::Impedance(*spring))?;
        Ok::<_, CampaignError>(refused)
    };
    if let Some(refused) = order(control, &spring)? {
        return Ok(Some(refused));
    }
    let mut input = TerminalOperator::default();
    let (from_us, from) = (control.now_us(), Instant::now());
    let (mut told_us, mut told_tick, mut read_us) = (0, 0, 0);
    while !interrupted() {
        control.idle()?;
        if let Some(fault) = control.fault() {
            let (kind, value, limit) = (fault.fault, fault.value, fault.limit);
            return Ok(Some(format!(
                "{kind:?} (value {value:.3}, limit {limit:.3}): the arm holds, damped"
            )));
        }
        let now_us = control.now_us().saturating_sub(from_us);
        // A simulated arm is held for as long as a real one.
        let ahead = Duration::from_micros(now_us).saturating_sub(from.elapsed());
        if ahead > Duration::from_millis(2) {
            std::thread::sleep(ahead);
        }
        if now_us >= told_us
            && let Some(sample) = control.sample()
            && sample.tick > told_tick
        {
            tell(json, now_us, &sample, &spring);
            (told_us, told_tick) = (told_us + EVERY_US, sample.tick);
        }
        if now_us < read_us {
            continue;
        }
        let text = match input.line() {
            Entered::Nothing => continue,
            Entered::Closed => break,
            Entered::Line(text) => text,
        };
        let used = match Line::read(&text) {
            Ok(line) if line.stop => break,
            Ok(line) => line.applied(&spring).map(|spring| (line, spring)),
            Err(error) => Err(error),
        };
        match used {
            Ok((line, wanted)) => {
                if wanted != spring {
                    match order(control, &wanted)? {
                        Some(refused) => refuse(json, &refused),
                        None => spring = wanted,
                    }
                }
                read_us = control.now_us().saturating_sub(from_us) + (line.wait_s * 1e6) as u64;
            }
            Err(why) => refuse(json, &why),
        }
    }
    Ok(None)
}

pub(super) fn run(args: &ImpedanceArgs) -> Result<Exit, CliError> {
    let spring = ImpedanceCommand {
        stiffness_n_m: [args.stiffness; 3],
        rotation_nm_rad: args.rotation,
        offset_m: [0.0; 3],
        turn_rad: [0.0; 3],
    };
    checked(&spring).map_err(|why| CliError::input(format!("--{why}")))?;
    if args.run.resume {
        return Err(CliError::input(
            "--resume: `spherecal impedance` measures nothing: leave the option out",
        ));
    }
    features::check_run(&args.run)?;
    let stop = interrupt()?;
    let prepared = args.run.prepare()?;
    std::fs::create_dir_all(&args.run.out).map_err(unwritten(&args.run.out))?;
    let mut ended = None;
    let interrupted = || stop.load(std::sync::atomic::Ordering::Relaxed);
    job::impedance(
        &prepared,
        &args.run.link,
        &args.run.out,
        &mut Remarks,
        &stop,
        |control| {
            ended = hold(args, control, spring, interrupted)?;
            Ok(())
        },
    )?;
    ended.map_or(Ok(Exit::Done), |why| Err(CliError::job(why)))
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a line means something else than the help says, or if one that cannot be used is not told by field, value and
    // range.
    #[test]
    fn a_line_changes_what_it_names() {
        let spring = ImpedanceCommand {
            stiffness_n_m: [400.0; 3],
            rotation_nm_rad: 50.0,
            offset_m: [0.0, 0.01, 0.0],
            turn_rad: [0.0; 3],
        };
        let after = |text: &str| Line::read(text).and_then(|line| line.applied(&spring));
        assert_eq!(after("{}"), Ok(spring));
        let wanted =
            after(r#"{"stiffness": [400, 300, 200], "rotation": 20, "move_mm": [0, 10, -5], "turn_deg": [0, 0, 9]}"#);
        let wanted = wanted.expect("a spring");
        assert_eq!(
            (wanted.stiffness_n_m, wanted.rotation_nm_rad),
            ([400.0, 300.0, 200.0], 20.0)
        );
        assert_eq!(wanted.offset_m, [0.0, 0.02, -0.005]);
        assert!((wanted.turn_rad[2] - 0.05 * std::f64::consts::PI).abs() < 1e-12);
        assert_eq!(after(r#"{"stiffness": 0}"#).expect("a spring").stiffness_n_m, [0.0; 3]);
        for (text, told) in [
            (
                r#"{"stiffness": 6000}"#,
                "stiffness is 6000: give a value from 0 to 5000",
            ),
            (r#"{"rotation": -1}"#, "rotation is -1: give a value from 0 to 300"),
            (
                r#"{"move_mm": [0, 300, 0]}"#,
                "move_mm, added up, is 310: give a value from -300 to 300",
            ),
            (
                r#"{"wait_s": 1e9}"#,
                "wait_s is 1000000000: give a value from 0 to 3600",
            ),
            (r#"{"stifness": 1}"#, "unknown field `stifness`"),
            ("{", "EOF"),
        ] {
            let refused = after(text).expect_err(text);
            assert!(refused.contains(told), "{text}: {refused}");
        }
    }
}
