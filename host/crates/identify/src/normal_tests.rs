//! Sums over many rows: the same on any number of cores, and those of their parts.

use rand::{RngExt as _, SeedableRng as _};
use spherecal_model::{Experiment, Observation, Set, Target, paper_plate};
use spherecal_shared::robot::{iiwa7, iiwa7_tool};

use super::groups::BLOCK;
use super::*;
use crate::hierarchy::prepare;
use crate::load::Nominal;
use crate::options::Torque;

/// Rows at random configurations, some by the tracker, some on two spheres.
fn experiment(rows: usize) -> Experiment {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
    let observations = (0..rows).map(|k| Observation {
        seat: None,
        q: (0..7).map(|_| random.random_range(-1.5..1.5)).collect(),
        tau: None,
        target: match k % 5 {
            0 => Target::Sphere { sphere: 1, place: 0 },
            1 => Target::Sphere { sphere: 2, place: 0 },
            _ => Target::Point([0.4, 0.1, 0.3]),
        },
        set: Set::Calibrate,
    });
    Experiment {
        robot: iiwa7(),
        tool: iiwa7_tool(),
        spheres: paper_plate(),
        observations: observations.collect(),
    }
}

// Fails if the equations of more rows than one task sums depend on the number of
// threads, or are not the sum of those of their parts.
#[test]
fn sums_of_many_rows_are_the_sums_of_their_parts() {
    let rows = 2 * BLOCK + 5000;
    let experiment = experiment(rows);
    let layout = Layout::new(&experiment, 2, true);
    let nominal = Nominal::new(&experiment.robot, &experiment.tool);
    let prepared = prepare(&experiment, &layout, &nominal, Torque::Model, |_| true).unwrap();
    let state = State::nominal(&experiment.robot, &experiment.tool, &layout);
    let weights: Vec<f64> = (0..rows).map(|k| 0.5 + (k % 7) as f64).collect();
    let mut whitening = Whitening::new(&crate::Noise::default());
    (whitening.joint, whitening.seating, whitening.point) = (1e-8, 1e-10, 1e-9);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let groups = groups(&prepared);
            let normal = accumulate(&state, &layout, &prepared, &groups, &whitening, &weights);
            (normal, distances(&state, &layout, &prepared, &whitening))
        })
    };
    let (one, three) = (on(1), on(3));
    assert_eq!(one.0.matrix, three.0.matrix);
    assert_eq!((&one.0.gradient, &one.1), (&three.0.gradient, &three.1));

    // Parts that one task sums each, which is the plain loop.
    let mut matrix = DMatrix::zeros(layout.len(), layout.len());
    let mut slope = DVector::zeros(layout.len());
    let mut d2 = Vec::new();
    for (part, weights) in prepared.chunks(4000).zip(weights.chunks(4000)) {
        let groups = groups(part);
        let normal = accumulate(&state, &layout, part, &groups, &whitening, weights);
        matrix += normal.matrix;
        slope += normal.gradient;
        d2.extend(distances(&state, &layout, part, &whitening));
    }
    assert_eq!(d2, one.1);
    let off = |a: &[f64], b: &[f64]| {
        let size = a.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        a.iter().zip(b).fold(0.0_f64, |m, (x, y)| m.max((x - y).abs())) / size
    };
    assert!(off(matrix.as_slice(), one.0.matrix.as_slice()) < 1e-12);
    assert!(off(slope.as_slice(), one.0.gradient.as_slice()) < 1e-12);
    assert!(matrix.amax() > 0.0);
}
