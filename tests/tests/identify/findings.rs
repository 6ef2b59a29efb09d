//! A study of what the residual analysis names: five causes, each made in the data of several drawn
//! robots, and the same robots without any. It prints the rates that `docs/design/record-2026.md` states.
//!
//! `FINDINGS_SEEDS=4000:20` names the first seed and the number of robots.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use spherecal::identify::{Check, EvaluateOptions, Evaluation, Experiment, Recordings, Target, Verdict, evaluate};
use spherecal::model::input::Labels;
use spherecal::sim::plant::PlantConfig;
use spherecal::sim::worlds::World;
use spherecal_lab::worlds::{Trial, record_plant};

use super::broken::move_contacts;
use super::verdicts::default_plan;

/// Checks that say the findings.
const NAMES: [&str; 7] = [
    "place",
    "place_scatter",
    "read_at_rest",
    "plate_drift",
    "encoder",
    "payload",
    "no_outliers",
];

/// What is made in the data.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Made {
    Nothing,
    /// One of four places of a tracker's points is off by this (m).
    Place(f64),
    /// The points of one of four places scatter by this more (m).
    Scatter(f64),
    /// All joints are read with this share of the last move to go.
    Lag(f64),
    /// One joint is.
    LagOfOne(f64),
    /// The plate or the tracker drifts by this (m).
    Drift(f64),
    /// The stated load is lighter than the true one by this (kg).
    Payload(f64),
    /// This many rows are 3 to 6 mm off.
    Gross(usize),
}

/// Contacts with the plate, or points that a tracker sees.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Contacts,
    Points,
}

/// Moves each target as the arm sees it: joints on spheres, points in the tracker's frame.
fn displace(trial: &mut Trial, kind: Kind, mut by: impl FnMut(usize, &[f64]) -> Vector3<f64>) {
    match kind {
        Kind::Contacts => move_contacts(trial, by),
        Kind::Points => {
            let base = trial.base();
            for (index, observation) in trial.laser.observations.iter_mut().enumerate() {
                if let Target::Point(point) = &mut observation.target {
                    let moved = Vector3::from(*point) + base.rotation * by(index, &observation.q);
                    *point = moved.into();
                }
            }
        }
    }
}

fn rows(trial: &mut Trial, kind: Kind) -> &mut Experiment {
    match kind {
        Kind::Contacts => &mut trial.spheres,
        Kind::Points => &mut trial.laser,
    }
}

/// Angles that are read with a share of the last move to go.
fn lag(experiment: &mut Experiment, share: impl Fn(usize) -> f64) {
    let before: Vec<_> = experiment
        .observations
        .iter()
        .map(|o| (o.target.clone(), o.q.clone()))
        .collect();
    let sphere = |t: &Target| match *t {
        Target::Sphere { sphere, .. } => Some(sphere),
        _ => None,
    };
    for (pair, observation) in before.windows(2).zip(experiment.observations.iter_mut().skip(1)) {
        if sphere(&pair[0].0) == sphere(&pair[1].0) {
            for (joint, angle) in observation.q.iter_mut().enumerate() {
                *angle -= share(joint) * (pair[1].1[joint] - pair[0].1[joint]);
            }
        }
    }
}

fn record(world: World, kind: Kind, made: Made, seed: u64) -> Recordings {
    let mut plant = PlantConfig { seed, ..world.plant() };
    if world != World::W5 {
        // What real arms yield (W5), without what else W5 has.
        plant.compliance.joints_rad_per_nm = PlantConfig::as_measured().compliance.joints_rad_per_nm;
    }
    let mut trial = record_plant(world, plant, &default_plan()).expect("the built-in worlds work");
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let along = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0)).normalize();
    let joint = random.random_range(1..6);
    let count = rows(&mut trial, kind).observations.len();
    let place = |k: usize| 4 * k / count;
    match made {
        Made::Nothing => {}
        Made::Place(size) => displace(&mut trial, kind, |k, _| {
            if place(k) == 2 { along * size } else { Vector3::zeros() }
        }),
        Made::Scatter(size) => displace(&mut trial, kind, |k, _| {
            let by = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0)) * size;
            if place(k) == 2 { by } else { Vector3::zeros() }
        }),
        Made::Lag(share) => lag(rows(&mut trial, kind), |_| share),
        Made::LagOfOne(share) => lag(rows(&mut trial, kind), |j| if j == joint { share } else { 0.0 }),
        Made::Drift(size) => displace(&mut trial, kind, |k, _| along * (size * k as f64 / count as f64)),
        Made::Payload(kg) => {
            let tool = &mut rows(&mut trial, kind).tool;
            tool.body.mass_kg = (tool.body.mass_kg - kg).max(0.0);
        }
        Made::Gross(bad) => {
            let step = count / bad;
            displace(&mut trial, kind, |k, _| {
                let by = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0)).normalize();
                let far = random.random_range(3e-3..6e-3);
                if k % step == step / 2 {
                    by * far
                } else {
                    Vector3::zeros()
                }
            });
        }
    }
    let mut recordings = match kind {
        Kind::Contacts => Recordings::from(&trial),
        Kind::Points => Recordings::new(trial.laser.clone()),
    };
    recordings.tracker = None;
    if kind == Kind::Points {
        recordings.places = Labels::default();
        for name in ["A", "B", "C", "D"] {
            recordings.places.number(name);
        }
        for (k, sample) in recordings.samples.iter_mut().enumerate() {
            sample.place = place(k) as u32;
        }
    }
    recordings
}

fn evaluated(world: World, kind: Kind, made: Made, seed: u64) -> Evaluation {
    let options = EvaluateOptions {
        align: false,
        cross_validate: false,
        ..EvaluateOptions::default()
    };
    evaluate(&record(world, kind, made, seed), &options, &mut |_| {}).expect("readable data")
}

/// First seed and number of robots.
fn seeds(first: u64, count: u64) -> std::ops::Range<u64> {
    let asked = std::env::var("FINDINGS_SEEDS").unwrap_or_default();
    let numbers: Vec<u64> = asked.split(':').filter_map(|n| n.parse().ok()).collect();
    match numbers[..] {
        [first, count] => first..first + count,
        _ => first..first + count,
    }
}

/// Robots in which each cause is named, in the order of [`NAMES`]. What is named has its probability in the words of its check,
/// which passes where the cause would not matter.
fn found(world: World, kind: Kind, made: Made, seeds: std::ops::Range<u64>) -> [usize; NAMES.len()] {
    let verdicts: Vec<(u64, Verdict)> = seeds
        .into_par_iter()
        .map(|seed| (seed, evaluated(world, kind, made, seed).verdict))
        .collect();
    let mut counts = [0; NAMES.len()];
    for (seed, verdict) in &verdicts {
        for (name, count) in NAMES.iter().zip(&mut counts) {
            let named = |c: &&Check| c.name == *name && (!c.passed || c.words.contains("p = "));
            let named = verdict.checks.iter().find(named);
            *count += usize::from(named.is_some());
            if let Some(check) = named {
                println!("  {world} {kind:?} {made:?} {seed}: {name}: {}", check.words);
            }
        }
    }
    println!(
        "{world} {kind:?} {made:?}, {} robots: {:?}",
        verdicts.len(),
        NAMES.iter().zip(counts).collect::<Vec<_>>()
    );
    counts
}

/// What is made, in which data, and the check that must name it.
const CASES: [(Kind, Made, &str); 10] = [
    (Kind::Points, Made::Place(1e-3), "place"),
    (Kind::Points, Made::Scatter(1e-3), "place_scatter"),
    (Kind::Contacts, Made::Lag(5e-4), "read_at_rest"),
    (Kind::Contacts, Made::LagOfOne(1e-3), "read_at_rest"),
    (Kind::Points, Made::Lag(5e-4), "read_at_rest"),
    (Kind::Contacts, Made::Drift(3e-4), "plate_drift"),
    (Kind::Contacts, Made::Drift(5e-4), "plate_drift"),
    (Kind::Contacts, Made::Payload(1.5), "payload"),
    (Kind::Points, Made::Payload(1.5), "payload"),
    (Kind::Contacts, Made::Gross(5), "no_outliers"),
];

fn named(kind: Kind, made: Made, check: &str, seeds: std::ops::Range<u64>) -> usize {
    let counts = found(World::W0, kind, made, seeds);
    NAMES
        .iter()
        .zip(counts)
        .find(|(name, _)| **name == check)
        .map_or(0, |(_, count)| count)
}

// Fails if a load of 1.5 kg is judged with the compliance that was estimated without it, which hides it.
// Fails, too, if its size is wrong, or if a load is named that is as stated: on the robot of W5, 30 kg were without a prior.
// Fails, too, if the load does not hang at the tool of the result.
// Contacts tell too little of a load for one robot to be a test: see the study.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_load_is_told_from_the_joints_compliance() {
    let load = |world, made, seed| {
        let evaluation = evaluated(world, Kind::Points, made, seed);
        let tool_kg = evaluation.calibration.tool.body.mass_kg;
        let mut checks = evaluation.verdict.checks.into_iter();
        (checks.find(|c| c.name == "payload").expect("judged"), tool_kg)
    };
    for (world, seed) in [(World::W0, 213), (World::W5, 106)] {
        let (sound, _) = load(world, Made::Nothing, seed);
        assert!(sound.passed, "{}", sound.words);
    }
    let (found, tool_kg) = load(World::W0, Made::Payload(1.5), 213);
    let stated_kg = record(World::W0, Kind::Points, Made::Payload(1.5), 213)
        .experiment
        .tool
        .body
        .mass_kg;
    assert!(!found.passed, "{}", found.words);
    let number = |after: &str| -> f64 {
        let rest = found.words.split(after).nth(1).unwrap_or_default();
        let number = rest.split_whitespace().next().unwrap_or_default();
        number.parse().unwrap_or_else(|_| panic!("{}", found.words))
    };
    let (size, sigma) = (number("the load at the flange is "), number("± "));
    assert!(found.words.contains("kg heavier"), "{}", found.words);
    assert!((size - 1.5).abs() < 3.0 * sigma && sigma < 0.75, "{}", found.words);
    assert!(
        (tool_kg - stated_kg - size).abs() < 0.1 * sigma + 0.005,
        "{tool_kg} kg after {stated_kg} kg, {}",
        found.words
    );
}

// Prints the study. Fails if a cause is named in fewer than 9 of 10 robots; by contacts a load of 1.5 kg has a sigma of 0.3 to
// 0.9 kg, and is named in 6 of 10.
#[test]
#[ignore = "study: takes minutes and prints the figures of docs/design/record-2026.md"]
fn study_of_findings() {
    let robots = seeds(100, 10);
    let count = robots.clone().count();
    // `FINDINGS_MADE=Payload` takes one of them.
    let asked = std::env::var("FINDINGS_MADE").unwrap_or_default();
    let mut missed = Vec::new();
    for (kind, made, check) in CASES.into_iter().filter(|c| format!("{:?}", c.1).contains(&asked)) {
        let named = named(kind, made, check, robots.clone());
        println!("{kind:?} {made:?}: {check} in {named} of {count}");
        let least = if (kind, made) == (Kind::Contacts, Made::Payload(1.5)) {
            6
        } else {
            9
        };
        if 10 * named < least * count {
            missed.push(format!("{kind:?} {made:?}: {named} of {count}"));
        }
    }
    // What is found where nothing was made: W5 has backlash, drift and early readings of its own.
    if format!("{:?}", Made::Nothing).contains(&asked) {
        for world in [World::W0, World::W3, World::W4, World::W5] {
            for kind in [Kind::Contacts, Kind::Points] {
                found(world, kind, Made::Nothing, robots.clone());
            }
        }
    }
    assert!(missed.is_empty(), "{missed:?}");
}
