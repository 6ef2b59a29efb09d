//! What the torque columns of a table say: their sign, their offsets, and the load at the flange.

use std::collections::HashSet;

use nalgebra::{DMatrix, DVector, Vector3};
use spherecal_shared::robot::{Inertia, Robot, Tool};

use crate::load::Nominal;
use crate::{Experiment, Observation, Set};

/// Most rows that are looked at, spread evenly.
const MOST_ROWS: usize = 2000;
/// Correlation of measured torque and gravity from which the sign is known.
const SIGN_KNOWN: f64 = 0.5;
/// A load that is less certain than this (kg, 1 sigma) is not taken from the torques.
const LOAD_SURE_KG: f64 = 0.3;
/// Difference from the stated load that is reported, in kg and in sigma.
const LOAD_DIFFERS: (f64, f64) = (0.3, 4.0);
/// A centre of mass further from the flange than this (m) is no load at the flange.
const LOAD_REACH_M: f64 = 0.5;
/// Sweeps in which the scatter of each joint is found.
const SWEEPS: usize = 3;

/// What was found of the torques of a table.
#[derive(Clone, Debug, PartialEq)]
struct Torques {
    /// 1 where they hold the arm against gravity, -1 where they are gravity's own; none where it cannot be told.
    sign: Option<f64>,
    /// Offset of each joint against the model's gravity, in N m, after the sign.
    offsets_nm: Vec<f64>,
    /// The load at the flange that explains them; none where they do not tell.
    load: Option<EstimatedLoad>,
}

/// A load at the flange.
#[derive(Clone, Copy, Debug, PartialEq)]
struct EstimatedLoad {
    mass_kg: f64,
    /// Standard deviation of the mass by the scatter of the torques alone.
    sigma_kg: f64,
    /// In the last frame of the table, in m.
    com_m: Vector3<f64>,
}

/// Measured torques of a row.
struct TorqueRow<'a> {
    q: &'a [f64],
    tau: &'a [f64],
}

/// Holding torques by the model with some tool, in N m.
fn holding(nominal: &Nominal, q: &[f64]) -> Vec<f64> {
    nominal.load(q, None).joint[..q.len()].iter().map(|m| m[2]).collect()
}

fn tool_with(tool: &Tool, mass_kg: f64, com_m: [f64; 3]) -> Tool {
    Tool {
        body: Inertia {
            mass_kg,
            com_m,
            inertia_kg_m2: [0.0; 6],
        },
        ..*tool
    }
}

/// Looks at the torques of the calibration rows. `tool` is in the last frame of the table. None where
/// fewer than a few rows have torques.
fn torques(robot: &Robot, tool: &Tool, observations: &[Observation]) -> Option<Torques> {
    let n = robot.dof();
    // A row that is copied tells nothing more.
    let mut seen = HashSet::new();
    let all: Vec<TorqueRow<'_>> = observations
        .iter()
        .filter(|o| o.set == Set::Calibrate)
        .filter_map(|o| {
            let (q, tau) = (&*o.q, o.tau.as_deref()?);
            (q.len() == n && tau.len() == n).then_some(TorqueRow { q, tau })
        })
        .filter(|row| seen.insert(row.q.iter().chain(row.tau).map(|x| x.to_bits()).collect::<Vec<u64>>()))
        .collect();
    let rows: Vec<&TorqueRow<'_>> = all.iter().step_by(all.len().div_ceil(MOST_ROWS).max(1)).collect();
    if rows.len() < n + 4 {
        return None;
    }
    let empty = Nominal::new(robot, &tool_with(tool, 0.0, [0.0; 3]));
    let stated = Nominal::new(robot, tool);
    let sign = sign(&rows, &stated);
    let direction = sign.unwrap_or(1.0);
    let mean_off = |j: usize| {
        let off = |row: &&TorqueRow<'_>| direction * row.tau[j] - holding(&stated, row.q)[j];
        rows.iter().map(off).sum::<f64>() / rows.len() as f64
    };
    let mut found = Torques {
        sign,
        offsets_nm: (0..n).map(mean_off).collect(),
        load: None,
    };
    // Of a robot without masses the torques are those of unknown links.
    if sign.is_some()
        && !empty.assumed()
        && let Some((load, offsets_nm)) = load(robot, tool, &rows, &empty, direction)
    {
        found.load = Some(load);
        found.offsets_nm = offsets_nm;
    }
    Some(found)
}

/// The sign of the torques by their correlation with gravity, all joints together.
fn sign(rows: &[&TorqueRow<'_>], nominal: &Nominal) -> Option<f64> {
    let n = rows.first()?.q.len();
    let count = rows.len() as f64;
    let gravity: Vec<Vec<f64>> = rows.iter().map(|row| holding(nominal, row.q)).collect();
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for j in 0..n {
        let mean_g = gravity.iter().map(|g| g[j]).sum::<f64>() / count;
        let mean_t = rows.iter().map(|row| row.tau[j]).sum::<f64>() / count;
        for (g, row) in gravity.iter().zip(rows) {
            let (x, y) = (g[j] - mean_g, row.tau[j] - mean_t);
            xx += x * x;
            xy += x * y;
            yy += y * y;
        }
    }
    let correlation = xy / (xx * yy).sqrt();
    (correlation.abs() >= SIGN_KNOWN).then(|| correlation.signum())
}

/// The load at the flange and the joints' offsets by least squares; each joint has a scatter of its own.
fn load(
    robot: &Robot,
    tool: &Tool,
    rows: &[&TorqueRow<'_>],
    empty: &Nominal,
    direction: f64,
) -> Option<(EstimatedLoad, Vec<f64>)> {
    let n = robot.dof();
    let at = |com: [f64; 3]| Nominal::new(robot, &tool_with(tool, 1.0, com));
    let units = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(at);
    let unknowns = 4 + n;
    let mut a = DMatrix::zeros(rows.len() * n, unknowns);
    let mut b = DVector::zeros(rows.len() * n);
    for (k, row) in rows.iter().enumerate() {
        let none = holding(empty, row.q);
        let of = units.each_ref().map(|unit| holding(unit, row.q));
        for j in 0..n {
            let r = k * n + j;
            // Torque is linear in the mass and in its first moments.
            a[(r, 0)] = of[0][j] - none[j];
            for axis in 0..3 {
                a[(r, 1 + axis)] = of[1 + axis][j] - of[0][j];
            }
            a[(r, 4 + j)] = 1.0;
            b[r] = direction * row.tau[j] - none[j];
        }
    }
    let mut weight = vec![1.0; n];
    let mut solved = None;
    for _ in 0..SWEEPS {
        let root = |r: usize| weight[r % n];
        let mut wa = a.clone();
        for (r, mut line) in wa.row_iter_mut().enumerate() {
            line.scale_mut(root(r));
        }
        let wb = DVector::from_fn(b.len(), |r, _| b[r] * root(r));
        let inverse = (wa.tr_mul(&wa)).cholesky()?.inverse();
        let x = &inverse * wa.tr_mul(&wb);
        let rest = &b - &a * &x;
        for (j, weight) in weight.iter_mut().enumerate() {
            let square: f64 = (0..rows.len()).map(|k| rest[k * n + j].powi(2)).sum();
            // An angle of a joint without load has a torque of the sensor's noise alone.
            *weight = 1.0 / (square / rows.len() as f64).sqrt().max(1e-3);
        }
        solved = Some((x, inverse));
    }
    // The weights of the last sweep but one made the rest; its covariance has those of that sweep.
    let (x, covariance) = solved?;
    let sigma_kg = covariance[(0, 0)].max(0.0).sqrt();
    let mass_kg = x[0];
    let com_m = if mass_kg > LOAD_SURE_KG.min(2.0 * sigma_kg.max(0.02)) {
        Vector3::new(x[1], x[2], x[3]) / mass_kg
    } else {
        Vector3::zeros()
    };
    let possible = sigma_kg <= LOAD_SURE_KG && mass_kg > -LOAD_SURE_KG && com_m.norm() <= LOAD_REACH_M;
    let load = EstimatedLoad {
        mass_kg: mass_kg.max(0.0),
        sigma_kg,
        com_m,
    };
    possible.then(|| (load, x.rows(4, n).iter().copied().collect()))
}

impl Torques {
    /// For people: sign and offsets.
    fn words(&self) -> String {
        let sign = match self.sign {
            Some(s) if s < 0.0 => {
                "the torque columns have the sign of gravity's own torques (as KUKA's): their sign was turned"
            }
            Some(_) => "the torque columns have the sign of torques that hold the arm",
            None => {
                return "the torque columns do not follow gravity, so their sign cannot be told: they are taken as torques \
                        that hold the arm"
                    .to_owned();
            }
        };
        let offsets: Vec<String> = self.offsets_nm.iter().map(|o| format!("{o:+.2}")).collect();
        format!("{sign}; offsets against the model by joint: {} N m", offsets.join(", "))
    }

    /// Turns the rows' torques to the sign of torques that hold the arm.
    fn turn(&self, observations: &mut [Observation]) {
        if self.sign.is_some_and(|s| s < 0.0) {
            for tau in observations.iter_mut().filter_map(|o| o.tau.as_mut()).flatten() {
                *tau = -*tau;
            }
        }
    }
}

impl EstimatedLoad {
    /// Whether it differs from a stated mass (kg) by more than can be chance.
    fn differs(&self, stated_kg: f64) -> bool {
        let off = (self.mass_kg - stated_kg).abs();
        off > LOAD_DIFFERS.0.max(LOAD_DIFFERS.1 * self.sigma_kg)
    }
}

/// Brings torque columns to the sign of torques that hold the arm, and takes the load at the flange from
/// them where the user stated none.
pub(super) fn understand_torques(
    experiment: &mut Experiment,
    validation: &mut [Observation],
    payload_kg: Option<f64>,
    notes: &mut Vec<String>,
) {
    let found = torques(&experiment.robot, &experiment.tool, &experiment.observations);
    let mut told = None;
    if let Some(found) = &found {
        notes.push(found.words());
        found.turn(&mut experiment.observations);
        found.turn(validation);
        told = found.load;
    }
    let words = |load: &EstimatedLoad| {
        format!(
            "{:.2} kg (± {:.2} kg by the scatter of the torques)",
            load.mass_kg, load.sigma_kg
        )
    };
    let body = experiment.tool.body;
    match (payload_kg, told) {
        (Some(kg), Some(load)) if load.differs(kg) => notes.push(format!(
            "--payload-kg is {kg:.2}, and the torque columns speak for {}: weigh the load",
            words(&load)
        )),
        (Some(_), _) => {}
        (None, Some(load)) => {
            experiment.tool.body = Inertia {
                mass_kg: load.mass_kg,
                com_m: load.com_m.into(),
                inertia_kg_m2: [0.0; 6],
            };
            notes.push(format!(
                "no --payload-kg was given: the torque columns speak for a load of {} at the flange, which was taken",
                words(&load)
            ));
        }
        (None, None) if experiment.robot.joints.iter().all(|j| j.link.mass_kg <= 0.0) => {}
        (None, None) => notes.push(if body.mass_kg > 0.0 {
            format!(
                "no --payload-kg was given: the load at the flange is taken as {:.2} kg, that of the robot's own description",
                body.mass_kg
            )
        } else {
            "no --payload-kg was given: nothing is taken to hang at the flange unless the residuals say so".to_owned()
        }),
    }
}

#[cfg(test)]
#[path = "torques_tests.rs"]
mod tests;
