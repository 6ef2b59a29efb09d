//! Step 1: the robot is read, nothing is commanded. Its angles, the sign of its torques, and what they say of arm
//! and tool.

use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::Vector3;
use spherecal_link::{JointReading, StateReader};
use spherecal_model::chain::Chain;
use spherecal_shared::robot::{GRAVITY_M_S2, Inertia, Robot, Tool};

use super::{Attendant, CommissioningStep, Figure, StepReport};
use crate::CampaignError;

/// What is accepted while nothing is commanded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadOnlyLimits {
    /// Time that is read, in s.
    pub time_s: f64,
    /// Largest movement of a joint meanwhile, in rad.
    pub moved_rad: f64,
    /// Largest gap between two states, in s.
    pub gap_s: f64,
    /// Largest share of states that do not arrive.
    pub lost_share: f64,
    /// Largest difference between measured and expected torque of a joint, as a share of its torque limit.
    pub torque_share: f64,
    /// Largest difference between the load at the flange and the one that is declared, in kg.
    pub load_kg: f64,
}

impl Default for ReadOnlyLimits {
    fn default() -> Self {
        Self {
            time_s: 2.0,
            moved_rad: 1e-3,
            gap_s: 0.02,
            lost_share: 0.02,
            torque_share: 0.03,
            load_kg: 0.3,
        }
    }
}

/// Gravity torque, in N m, from which the sign of the torques can be told.
const TOLD_NM: f64 = 3.0;
/// Agreement (cosine of the angle between measured and expected torques) from which the sign is told.
const ALIKE: f64 = 0.8;
/// Torque that 1 kg at the flange must cause for its mass to be told, as a share of a joint's torque limit.
const TOLD_LOAD: f64 = 0.01;

/// What the torques of an arm at rest are to gravity by the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sign {
    /// They hold the arm.
    OfActuator,
    /// They are what the links do to the actuators.
    OfLink,
    /// Gravity is too small in this pose to tell.
    Hidden,
    /// They disagree with gravity under either sign.
    Neither,
}

/// Measured torques, turned by `turn`, minus gravity by the model: per joint, in N m.
fn residual(measured: &[f64], gravity: &[f64], turn: f64) -> Vec<f64> {
    measured.iter().zip(gravity).map(|(tau, g)| turn * tau - g).collect()
}

/// `most`: the residual that is accepted of each joint, in N m. `declared`: the interface tells the sign, and the
/// torques are already those of the actuators.
fn sign(measured: &[f64], gravity: &[f64], most: &[f64], declared: bool) -> Sign {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let (size, expected) = (dot(measured, measured).sqrt(), dot(gravity, gravity).sqrt());
    let alike = dot(measured, gravity) / (size * expected);
    if expected >= TOLD_NM && alike > ALIKE {
        return Sign::OfActuator;
    }
    if expected >= TOLD_NM && alike < -ALIKE {
        return Sign::OfLink;
    }
    // Torques of zero where the arm hangs heavy tell something: that they are wrong.
    let fits = |turn| {
        let residual = residual(measured, gravity, turn);
        residual.iter().zip(most).all(|(r, most)| r.abs() <= *most)
    };
    if fits(1.0) || (!declared && fits(-1.0)) {
        Sign::Hidden
    } else {
        Sign::Neither
    }
}

/// The load beyond the declared one that explains torques best, in kg: each joint counts by its torque limit (N m).
/// `None` where the pose hardly shows a load.
fn extra_load_kg(residual: &[f64], per_kg: &[f64], most: &[f64]) -> Option<f64> {
    let (mut along, mut square) = (0.0, 0.0);
    for ((r, p), most) in residual.iter().zip(per_kg).zip(most) {
        along += r * p / most.powi(2);
        square += (p / most).powi(2);
    }
    (square.sqrt() > TOLD_LOAD).then(|| along / square)
}

#[derive(Clone, Debug, Default)]
struct MeanReading {
    q: Vec<f64>,
    tau: Vec<f64>,
    /// Whether the sign of `tau` is declared by the robot's interface.
    declared: bool,
    moved_rad: f64,
    gap_s: f64,
    /// Shortest time between two states: the period at which the robot numbers them.
    period_s: f64,
    /// Time from the first state to the last one.
    time_s: f64,
    count: usize,
}

fn read(
    reader: &mut dyn StateReader,
    limits: &ReadOnlyLimits,
    interrupt: &AtomicBool,
) -> Result<MeanReading, CampaignError> {
    let mut reading = JointReading::default();
    let mut mean = MeanReading::default();
    let (mut first, mut last): (Option<f64>, f64) = (None, 0.0);
    let (mut low, mut high) = (Vec::new(), Vec::new());
    loop {
        if interrupt.load(Ordering::Relaxed) {
            return Err(CampaignError::Interrupted);
        }
        reader.read(&mut reading)?;
        if let Some(what) = &reading.commanded {
            return Err(CampaignError::Commanded { what: what.clone() });
        }
        let begun = *first.get_or_insert(reading.time_s);
        if mean.count == 0 {
            mean.q = vec![0.0; reading.q.len()];
            (low, high) = (reading.q.clone(), reading.q.clone());
        } else {
            let gap_s = reading.time_s - last;
            mean.gap_s = mean.gap_s.max(gap_s);
            if gap_s > 0.0 && (mean.period_s == 0.0 || gap_s < mean.period_s) {
                mean.period_s = gap_s;
            }
        }
        last = reading.time_s;
        mean.count += 1;
        let declared = !reading.tau.is_empty();
        let tau = if declared { &reading.tau } else { &reading.unsigned_tau };
        mean.declared = declared;
        mean.tau.resize(tau.len(), 0.0);
        let add = |sum: &mut Vec<f64>, values: &[f64]| sum.iter_mut().zip(values).for_each(|(s, v)| *s += v);
        add(&mut mean.q, &reading.q);
        add(&mut mean.tau, tau);
        for ((low, high), q) in low.iter_mut().zip(&mut high).zip(&reading.q) {
            (*low, *high) = (q.min(*low), q.max(*high));
        }
        mean.time_s = last - begun;
        if mean.time_s >= limits.time_s {
            break;
        }
    }
    let count = mean.count as f64;
    mean.q.iter_mut().chain(&mut mean.tau).for_each(|sum| *sum /= count);
    let spread = low.iter().zip(&high).map(|(l, h)| h - l);
    mean.moved_rad = spread.fold(0.0, f64::max);
    Ok(mean)
}

fn judge(reading: &MeanReading, robot: &Robot, tool: &Tool, limits: &ReadOnlyLimits) -> StepReport {
    // The robot numbers its states, one each period.
    let lost = 1.0 - (reading.count as f64 - 1.0) * reading.period_s / reading.time_s;
    let mut figures = vec![
        Figure::shown("states read", reading.count as f64, ""),
        Figure::shown("period of the states, by the robot", reading.period_s * 1e3, "ms"),
        Figure::judged(
            "states that did not arrive",
            lost * 100.0,
            "%",
            limits.lost_share * 100.0,
        ),
        Figure::judged(
            "longest time between two states",
            reading.gap_s * 1e3,
            "ms",
            limits.gap_s * 1e3,
        ),
        Figure::judged(
            "largest movement of a joint",
            reading.moved_rad.to_degrees(),
            "deg",
            limits.moved_rad.to_degrees(),
        ),
    ];
    for (joint, q) in (1..).zip(&reading.q) {
        figures.push(Figure::shown(format!("joint {joint}"), q.to_degrees(), "deg"));
    }
    let mut remarks = Vec::new();
    let joints = robot.joints.len();
    let gravity = gravity_nm(robot, &tool.body, &reading.q);
    let most: Vec<f64> = robot.joints.iter().map(|j| j.limits.torque_nm).collect();
    let accepted: Vec<f64> = most.iter().map(|most| limits.torque_share * most).collect();
    let found = if reading.tau.len() == joints {
        sign(&reading.tau, &gravity, &accepted, reading.declared)
    } else {
        Sign::Hidden
    };
    if found == Sign::Hidden {
        figures.push(Figure::unknown("measured torque minus gravity by the model", "N m"));
        figures.push(Figure::unknown("load beyond the declared one", "kg"));
        remarks.push(if reading.tau.len() == joints {
            "gravity hardly loads the joints in this pose, so the torques tell neither their sign nor the load: stretch the \
             arm forwards, and begin again"
                .to_owned()
        } else {
            format!(
                "the link gives {} torques for {joints} joints: neither their sign nor the load can be checked",
                reading.tau.len()
            )
        });
        return StepReport::of(CommissioningStep::ReadOnly, figures, remarks);
    }
    let turn = if found == Sign::OfLink { -1.0 } else { 1.0 };
    let residual = residual(&reading.tau, &gravity, turn);
    for ((joint, r), most) in (1..).zip(&residual).zip(&accepted) {
        let name = format!("joint {joint}: measured torque minus gravity by the model");
        figures.push(Figure::judged(name, *r, "N m", *most));
    }
    if found == Sign::Neither {
        figures.push(Figure::unknown("load beyond the declared one", "kg"));
        return StepReport::of(CommissioningStep::ReadOnly, figures, remarks).failed(
            "the torques agree with the arm's gravity under neither sign: the configuration describes another robot or base, \
             the joints are in another order, or the torque sensors do not work"
                .to_owned(),
        );
    }
    // A load of 1 kg where the declared one is; at the TCP where none is declared.
    let com_m = if tool.body.mass_kg > 0.0 {
        tool.body.com_m
    } else {
        tool.tcp_m
    };
    let one = Inertia {
        mass_kg: 1.0,
        com_m,
        ..Inertia::default()
    };
    let nothing = gravity_nm(robot, &Inertia::default(), &reading.q);
    let per_kg: Vec<f64> = gravity_nm(robot, &one, &reading.q)
        .iter()
        .zip(&nothing)
        .map(|(with, without)| with - without)
        .collect();
    if let Some(kg) = extra_load_kg(&residual, &per_kg, &most) {
        figures.push(Figure::judged("load beyond the declared one", kg, "kg", limits.load_kg));
        if kg.abs() > limits.load_kg {
            remarks.push(format!(
                "the torques look like a load of {:.2} kg, {:.2} kg is declared: correct the tool's mass and centre of mass in \
                 the configuration and in the robot",
                tool.body.mass_kg + kg,
                tool.body.mass_kg
            ));
        }
    } else {
        figures.push(Figure::unknown("load beyond the declared one", "kg"));
        remarks.push("no load can be told in this pose: stretch the arm forwards, and begin again".to_owned());
    }
    let report = StepReport::of(CommissioningStep::ReadOnly, figures, remarks);
    match (reading.declared, found) {
        (true, Sign::OfLink) => report.failed(
            "the torques have the opposite sign of the one that the drive declares: correct torque_sign in its \
             handshake"
                .to_owned(),
        ),
        (false, _) => {
            let words = if turn > 0.0 {
                "of the actuators on the links"
            } else {
                "of the links on the actuators"
            };
            let mut report = report;
            report.remarks.push(format!(
                "by the gravity of the arm, the measured torques are those {words}"
            ));
            report
        }
        _ => report,
    }
}

/// Step 1. Commands nothing.
///
/// # Errors
/// The connection is lost, something commands the arm, or the user interrupts.
pub fn commission_read_only(
    reader: &mut dyn StateReader,
    robot: &Robot,
    tool: &Tool,
    limits: &ReadOnlyLimits,
    attendant: &mut dyn Attendant,
    interrupt: &AtomicBool,
) -> Result<StepReport, CampaignError> {
    attendant.tell(CommissioningStep::ReadOnly.expectation());
    attendant.ask("Begin?");
    if !answer(reader, attendant, interrupt)? {
        return finished(StepReport::declined(CommissioningStep::ReadOnly), attendant);
    }
    let found = read(reader, limits, interrupt)?;
    if found.q.len() != robot.joints.len() {
        return Err(CampaignError::Link(spherecal_link::LinkError::OtherRobot {
            drive: found.q.len(),
            robot: robot.joints.len(),
        }));
    }
    let mut report = judge(&found, robot, tool, limits);
    let angles: Vec<String> = found.q.iter().map(|q| format!("{:.2}", q.to_degrees())).collect();
    attendant.tell(&format!("Joint angles, base to flange: {} degrees", angles.join(", ")));
    attendant.ask("Does the pendant show the same angles, within 0.1 degrees?");
    if !answer(reader, attendant, interrupt)? {
        report = report.failed(
            "the pendant shows other angles: the joints are in another order, or their zero positions differ"
                .to_owned(),
        );
    }
    finished(report, attendant)
}

fn finished(report: StepReport, attendant: &mut dyn Attendant) -> Result<StepReport, CampaignError> {
    attendant.done(&report)?;
    Ok(report)
}

/// Waits for an answer. The robot is read meanwhile, so that its states do not pile up.
fn answer(
    reader: &mut dyn StateReader,
    attendant: &mut dyn Attendant,
    interrupt: &AtomicBool,
) -> Result<bool, CampaignError> {
    let mut reading = JointReading::default();
    loop {
        if let Some(answer) = attendant.answer() {
            return Ok(answer);
        }
        if interrupt.load(Ordering::Relaxed) {
            return Err(CampaignError::Interrupted);
        }
        reader.read(&mut reading)?;
    }
}

/// Torques of the actuators that hold the arm at `q` (rad) against gravity, base to flange, in N m.
///
/// `load` is the body at the flange, in the frame of the last joint. Gravity points along −z of F0.
pub fn gravity_nm(robot: &Robot, load: &Inertia, q: &[f64]) -> Vec<f64> {
    let frames = Chain::unchecked(robot, &Tool::default()).frames(q);
    let n = robot.joints.len().min(frames.len());
    let mut torques = vec![0.0; n];
    let bodies = robot.joints.iter().map(|j| &j.link).zip(0..n);
    let last = n.checked_sub(1);
    for (body, at) in bodies.chain(last.map(|at| (load, at))) {
        let com = frames[at].point(&Vector3::from(body.com_m));
        let weight = Vector3::z() * (body.mass_kg * GRAVITY_M_S2);
        for (torque, frame) in torques.iter_mut().zip(&frames).take(at + 1) {
            *torque += frame.z().dot(&(com - frame.position).cross(&weight));
        }
    }
    torques
}
