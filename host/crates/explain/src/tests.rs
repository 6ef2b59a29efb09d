//! Mistakes made in the data of arms with errors of their own, and whether they are named.

mod kinds;
mod streams;

use nalgebra::{DVector, Matrix3, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use spherecal_model::input::Adjustments;
use spherecal_model::robots::frames::{compose, from_rpy};
use spherecal_model::robots::{RobotModel, built_in, load_urdf_text};
use spherecal_model::{Observation, Pose, Set, Target};

use crate::hypotheses::{Change, Hypothesis, pairs, singles};
use crate::{Explanation, Subject, explain};

/// Noise of a coordinate, in m (1 sigma).
const NOISE_M: f64 = 1e-4;

/// An arm of joints `xyz axis`, in a row.
fn arm(name: &str, joints: &[([f64; 3], &str)], tip: [f64; 3]) -> RobotModel {
    let mut out = format!("<robot name=\"{name}\"><link name=\"l0\"/>");
    let origin = |[x, y, z]: [f64; 3]| format!("<origin xyz=\"{x} {y} {z}\"/>");
    for (k, (at, axis)) in joints.iter().enumerate() {
        let (parent, n) = (k, k + 1);
        out += &format!(
            "<link name=\"l{n}\"/><joint name=\"j{n}\" type=\"revolute\">{}<parent link=\"l{parent}\"/><child link=\"l{n}\"/><axis \
             xyz=\"{axis}\"/><limit lower=\"-2.5\" upper=\"2.5\"/></joint>",
            origin(*at)
        );
    }
    let n = joints.len();
    out += &format!(
        "<link name=\"tool0\"/><joint name=\"t\" type=\"fixed\">{}<parent link=\"l{n}\"/><child link=\"tool0\"/></joint></robot>",
        origin(tip)
    );
    load_urdf_text(name, &out, None).unwrap()
}

fn arms() -> Vec<RobotModel> {
    let fanuc = arm(
        "fanuc-like",
        &[
            ([0.0, 0.0, 0.33], "0 0 1"),
            ([0.05, 0.0, 0.0], "0 1 0"),
            ([0.0, 0.0, 0.33], "0 -1 0"),
            ([0.0, 0.0, 0.035], "-1 0 0"),
            ([0.335, 0.0, 0.0], "0 -1 0"),
            ([0.08, 0.0, 0.0], "-1 0 0"),
        ],
        [0.02, 0.0, 0.0],
    );
    let so101 = arm(
        "so101-like",
        &[
            ([0.0, 0.0, 0.06], "0 0 1"),
            ([0.03, 0.0, 0.054], "0 1 0"),
            ([0.028, 0.0, 0.113], "0 1 0"),
            ([0.135, 0.0, 0.005], "0 1 0"),
            ([0.06, 0.0, 0.0], "1 0 0"),
        ],
        [0.04, 0.0, 0.0],
    );
    vec![built_in("ur5e").unwrap(), built_in("iiwa14").unwrap(), fanuc, so101]
}

const TOOL: [f64; 3] = [0.03, -0.015, 0.12];

/// An arm with errors of its own, and where its base stands for the instrument.
struct Real {
    path: spherecal_model::robots::JointPath,
    base: Pose<f64>,
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
}

impl Real {
    /// Offsets of 5 mrad, origins off by 0.3 mm and 1 mrad (1 sigma).
    fn new(model: &RobotModel, rng: &mut ChaCha8Rng) -> Self {
        let mut path = model.joint_path().unwrap();
        for joint in &mut path.joints {
            let at = Vector3::from_fn(|_, _| normal(rng) * 3e-4);
            let turn = from_rpy([normal(rng) * 1e-3, normal(rng) * 1e-3, normal(rng) * 5e-3]);
            joint.origin = compose(
                &joint.origin,
                &Pose {
                    rotation: turn,
                    position: at,
                },
            );
        }
        let base = Pose {
            rotation: from_rpy([
                rng.random::<f64>() * 3.0,
                rng.random::<f64>(),
                rng.random::<f64>() * 6.0,
            ]),
            position: Vector3::new(2.0, -1.0, 0.5),
        };
        Self { path, base }
    }

    /// A row: joint angles that were recorded, and what was measured while the arm was at `at`.
    fn row(&self, recorded: &[f64], at: &[f64], poses: bool, rng: &mut ChaCha8Rng) -> Observation {
        let tip = compose(&self.base, &self.path.frames(&self.path.positions(at)).tip);
        let at = tip.point(&Vector3::from(TOOL)) + Vector3::from_fn(|_, _| normal(rng) * NOISE_M);
        let target = if poses {
            Target::Frame(Box::new(Pose {
                rotation: tip.rotation * from_rpy([0.3, 0.1, -0.4]),
                position: at,
            }))
        } else {
            Target::Point(at.into())
        };
        Observation {
            q: recorded.to_vec(),
            tau: None,
            target,
            set: Set::Calibrate,
            seat: None,
        }
    }
}

/// Sound rows of an arm with errors.
fn sound(model: &RobotModel, seed: u64, rows: usize, poses: bool) -> Vec<Observation> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let real = Real::new(model, &mut rng);
    let mut any = |_| {
        let limits = model.robot.joints.iter().map(|j| j.limits);
        let q: Vec<f64> = limits
            .map(|l| {
                let (low, high) = (l.min_rad.max(-2.2), l.max_rad.min(2.2));
                low + (high - low) * rng.random::<f64>()
            })
            .collect();
        real.row(&q, &q, poses, &mut rng)
    };
    (0..rows).map(&mut any).collect()
}

/// The rows as somebody would record them who makes the mistake that `adjust` corrects.
fn mistaken(rows: &[Observation], adjust: &Adjustments) -> Vec<Observation> {
    let n = rows[0].q.len();
    let (map, zero) = adjust.joint_map(n);
    let back = map.try_inverse().unwrap();
    let mirror = Matrix3::from_diagonal(&Vector3::new(1.0, if adjust.mirror { -1.0 } else { 1.0 }, 1.0));
    let point = |p: &Vector3<f64>| mirror * p / adjust.point_factor;
    let by = adjust.shift as i64;
    let count = rows.len() as i64;
    (0..count)
        .filter_map(|k| {
            // The measurement of row k stands `by` rows later.
            let measured = &rows[usize::try_from(k - by).ok().filter(|i| *i < rows.len())?];
            let q = &back * (DVector::from_column_slice(&rows[k as usize].q) - &zero);
            let target = match &measured.target {
                Target::Point(p) => Target::Point(point(&Vector3::from(*p)).into()),
                Target::Frame(pose) => {
                    let (r, p) = (mirror * pose.rotation * mirror, point(&pose.position));
                    let pose = if adjust.invert {
                        Pose {
                            rotation: r.transpose(),
                            position: -(r.transpose() * p),
                        }
                    } else {
                        Pose {
                            rotation: r,
                            position: p,
                        }
                    };
                    Target::Frame(Box::new(pose))
                }
                other => other.clone(),
            };
            Some(Observation {
                q: q.as_slice().to_vec(),
                target,
                ..measured.clone()
            })
        })
        .collect()
}

fn explained(model: &RobotModel, rows: &[Observation], tool: [f64; 3]) -> Explanation {
    let mut model = model.clone();
    model.tool.tcp_m = tool;
    explain(&Subject::new(&model, rows, &[]))
}

/// Whether a hypothesis is the only one that is named, is named among those that tie, or is not named.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Named {
    No,
    Among,
    Alone,
}

fn named(explanation: &Explanation, truth: &Adjustments) -> Named {
    let there = explanation.found.iter().any(|f| f.adjust == *truth);
    match (there, explanation.found.len()) {
        (true, 1) => Named::Alone,
        (true, _) => Named::Among,
        _ => Named::No,
    }
}

/// Mistakes that change nothing that points could show: the base takes up the zero of the first joint.
fn changes_nothing(hypothesis: &Hypothesis) -> bool {
    matches!(&hypothesis.change, Change::Table(a) if a.zeros.iter().any(|z| z.0 == 0))
}

/// The mistakes of an arm, each with its correction.
fn mistakes(n: usize, poses: bool) -> Vec<(String, Adjustments)> {
    singles(n, true, poses, false, &[])
        .into_iter()
        .filter(|h| !changes_nothing(h))
        .filter_map(|h| match h.change {
            Change::Table(adjust) => Some((h.words, adjust)),
            _ => None,
        })
        .collect()
}

// Fails if a single mistake in the data of one of four arms is not named, for one of 40 mistakes.
#[test]
fn some_single_mistakes_are_named() {
    single_mistakes(40);
}

// Fails if a single mistake in the data of one of four arms is not named in 95 of 100 cases, or is too often named beside
// others that fit as well.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_single_mistakes_are_named() {
    single_mistakes(1);
}

/// Tries every `step`th mistake. A TCP near the last axis takes up the zero of the last joint: it is no single case.
fn single_mistakes(step: usize) {
    let (mut right, mut alone, mut all) = (0, 0, 0);
    let mut missed = Vec::new();
    for (k, model) in arms().iter().enumerate() {
        for (m, (words, adjust)) in mistakes(model.robot.dof(), false)
            .into_iter()
            .filter(|m| step == 1 || m.1.zeros.is_empty())
            .enumerate()
            .step_by(step)
        {
            let rows = mistaken(&sound(model, (1000 * k + m) as u64, 60, false), &adjust);
            let found = explained(model, &rows, TOOL);
            let how = named(&found, &adjust);
            all += 1;
            right += usize::from(how >= Named::Among);
            alone += usize::from(how == Named::Alone);
            if how == Named::No {
                missed.push(format!("{}: {words}: {:?}", model.robot.name, found.sentences()));
            }
        }
    }
    println!("{right} of {all} named, {alone} alone; missed: {missed:#?}");
    assert!(right * 100 >= 95 * all, "{right} of {all}: {missed:#?}");
    // How many tie depends on the few that are tried.
    assert!(step > 1 || alone * 10 >= 8 * all, "{alone} of {all}");
}

// Fails if something is said to be wrong with a sound table.
#[test]
fn sound_tables_are_left_alone() {
    sound_tables(2);
}

// Fails if something is said to be wrong with one of 200 sound tables.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_sound_tables_are_left_alone() {
    sound_tables(50);
}

/// Tries `count` tables of each arm.
fn sound_tables(count: u64) {
    for (k, model) in arms().iter().enumerate() {
        for seed in 0..count {
            let rows = sound(model, 100 * k as u64 + seed, 40, seed % 2 == 1);
            let found = explained(model, &rows, TOOL);
            assert!(
                found.found.is_empty() && !found.readout,
                "{}: {:?}",
                model.robot.name,
                found.sentences()
            );
            assert!(found.own_m < 1e-3, "{}: {}", model.robot.name, found.own_m);
        }
    }
}

// Fails if fewer than eight of ten tables with a joint that counts the other way and two swapped ones are explained.
#[test]
fn two_mistakes_at_once_are_named() {
    two_mistakes(1);
}

// Fails as above, for six pairs of mistakes on each arm.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_two_mistakes_at_once_are_named() {
    two_mistakes(6);
}

/// Tries `count` pairs of mistakes on each arm.
fn two_mistakes(count: usize) {
    let (mut right, mut all) = (0, 0);
    let mut missed = Vec::new();
    for (k, model) in arms().iter().enumerate() {
        let n = model.robot.dof();
        let both = pairs(&singles(n, true, false, false, &[]));
        let both: Vec<&Hypothesis> = both
            .iter()
            .filter(|h| matches!(&h.change, Change::Table(a) if a.flips.len() == 1 && !a.order.is_empty() && a.order[0] != n - 1))
            .collect();
        for s in 0..count {
            let Change::Table(adjust) = &both[(7 * s + 3 * k) % both.len()].change else {
                panic!()
            };
            let rows = mistaken(&sound(model, (50 * k + s) as u64, 60, false), adjust);
            let found = explained(model, &rows, TOOL);
            all += 1;
            if named(&found, adjust) == Named::No {
                missed.push(format!(
                    "{}: {}: {:?}",
                    model.robot.name,
                    adjust.options(),
                    found.sentences()
                ));
            } else {
                right += 1;
            }
        }
    }
    println!("{right} of {all}: {missed:#?}");
    assert!(right * 10 >= 8 * all, "{right} of {all}: {missed:#?}");
}

// Fails if inverted poses, a reversed tool, a tool in metres, another robot or a controller's readout is not named.
#[test]
fn tools_robots_poses_and_readouts() {
    let all = arms();
    let [ur5e, iiwa14, ..] = all.as_slice() else { panic!() };
    let words = |model, rows: &[Observation], tool| explained(model, rows, tool).sentences().join("; ");
    let inverted = Adjustments {
        invert: true,
        ..Adjustments::default()
    };
    let found = words(ur5e, &mistaken(&sound(ur5e, 5, 40, true), &inverted), TOOL);
    assert!(found.contains("--invert-poses"), "{found}");
    let rows = sound(ur5e, 6, 40, false);
    let found = words(ur5e, &rows, TOOL.map(|v| -v));
    assert!(
        found.contains("the tool points the other way") && found.contains("--tool-mm 29.9,-15"),
        "{found}"
    );
    let found = words(iiwa14, &sound(iiwa14, 6, 40, false), TOOL.map(|v| v * 1e-3));
    assert!(found.contains("the tool is given in m"), "{found}");
    let ur10e = built_in("ur10e").unwrap();
    let found = words(ur5e, &sound(&ur10e, 7, 40, false), TOOL);
    assert!(found.contains("--robot ur10e"), "{found}");
    let path = ur5e.joint_path().unwrap();
    let readout: Vec<Observation> = rows
        .iter()
        .map(|row| {
            let at = path.frames(&path.positions(&row.q)).tip.point(&Vector3::from(TOOL)) * 1e3;
            let rounded = at.map(|v| (v * 1e3).round() / 1e6);
            Observation {
                target: Target::Point(rounded.into()),
                ..row.clone()
            }
        })
        .collect();
    let found = words(ur5e, &readout, TOOL);
    assert!(found.contains("those of the nominal model"), "{found}");
}

// Fails if a joint that does not move is not named, or data of nothing get a name.
#[test]
fn still_joints_and_nonsense() {
    let all = arms();
    let mut rows = sound(&all[0], 9, 40, false);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for row in &mut rows {
        row.target = Target::Point([rng.random(), rng.random(), rng.random()]);
        row.q[2] = 0.3 + 1e-3 * rng.random::<f64>();
    }
    let found = explained(&all[0], &rows, TOOL);
    assert!(found.found.is_empty(), "{:?}", found.sentences());
    assert_eq!(found.sentences().len(), 1);
    assert!(
        found.sentences()[0].starts_with("joint 3 moves by 0.1 degrees alone"),
        "{:?}",
        found.sentences()
    );
    assert!(found.none_of_these().contains("none of"), "{}", found.none_of_these());
    assert!(found.tried > 500, "{}", found.tried);
}
