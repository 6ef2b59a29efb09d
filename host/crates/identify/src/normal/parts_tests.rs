//! Rows with several parts: their columns against differences, their whitening against a dense one.

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};
use proptest::prelude::*;
use rand::SeedableRng as _;
use spherecal_model::{Experiment, Observation, Pose, Set, Target};
use spherecal_shared::robot::{Tool, built_in};

use super::accumulate;
use super::groups::{groups, places};
use super::pose_columns::PoseColumns;
use super::whitening::{Conditional, Own, Root, Whitening};
use crate::chain::{Prepared, State};
use crate::hierarchy::prepare;
use crate::load::Nominal;
use crate::options::{Noise, Torque};
use crate::parameters::{Kind, Layout};

/// Rows of three targets, of which some are hidden, and poses; of a robot with parallel axes.
fn experiment() -> Experiment {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(4);
    let mut point = || Some([0; 3].map(|_| random.random_range(-0.5..0.5)));
    let targets = [
        Target::Points([point(), point(), point()].into()),
        Target::Points([None, point(), point()].into()),
        Target::Points([point(), None, point()].into()),
        Target::Points([None, None, point()].into()),
        Target::Point([0.3, 0.1, 0.2]),
        Target::Frame(Box::new(Pose {
            rotation: Matrix3::identity(),
            position: Vector3::new(0.2, 0.3, 0.4),
        })),
    ];
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let observations = targets.into_iter().map(|target| Observation {
        seat: None,
        q: (0..6).map(|_| random.random_range(-1.5..1.5)).collect(),
        tau: None,
        target,
        set: Set::Calibrate,
    });
    Experiment {
        robot: built_in("ur5e").unwrap(),
        tool: Tool::default(),
        spheres: Vec::new(),
        observations: observations.collect(),
    }
}

struct Setup {
    layout: Layout,
    state: State,
    prepared: Vec<Prepared>,
}

/// A state away from the nominal one in every parameter.
fn setup() -> Setup {
    let mut experiment = experiment();
    let layout = Layout::new(&experiment, 2, true);
    let nominal = Nominal::new(&experiment.robot, &experiment.tool);
    let mut state = State::nominal(&experiment.robot, &experiment.tool, &layout);
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(6);
    for kind in layout.kinds() {
        let size = match kind {
            Kind::Bending(..) | Kind::Tilt(_) | Kind::Compliance(_) => 1e-7,
            Kind::Target(..) => 0.1,
            Kind::Body(_) | Kind::Base(..) => 0.3,
            _ => 1e-3,
        };
        state.add(kind, random.random_range(-size..size));
    }
    state.pivots = vec![Vector3::new(0.1, -0.2, 0.3)];
    state.refresh();
    // The measurements are near the model's, as in a fit.
    let prepared = prepare(&experiment, &layout, &nominal, Torque::Model, |_| true).unwrap();
    let base = state.bases[0];
    for (p, observation) in prepared.iter().zip(&mut experiment.observations) {
        let at = |number: usize| -> [f64; 3] {
            let off = Vector3::new(1e-5, -2e-5, 3e-5) * (number + 1) as f64;
            (base.point(&state.target_at(&p.q, &p.load, number)) + off).into()
        };
        match &mut observation.target {
            Target::Points(points) => {
                for (number, point) in points.iter_mut().enumerate() {
                    *point = point.map(|_| at(number));
                }
            }
            Target::Frame(pose) => {
                let body = state.body_at(&state.at(p), &p.load);
                let off = Rotation3::new(Vector3::new(1e-4, -2e-4, 3e-4)).into_inner();
                pose.rotation = off * base.rotation * body;
                pose.position = at(0).into();
            }
            other => *other = Target::Point(at(0)),
        }
    }
    let prepared = prepare(&experiment, &layout, &nominal, Torque::Model, |_| true).unwrap();
    Setup {
        layout,
        state,
        prepared,
    }
}

/// Noise of variance 1 in each number and none of the joints: nothing is changed by whitening.
fn plain() -> Whitening {
    let mut whitening = Whitening::new(&Noise::default());
    (whitening.joint, whitening.seating, whitening.point) = (0.0, 1.0, 1.0);
    whitening.further.fill(1.0);
    whitening.along.fill(1.0);
    whitening.body = 1.0;
    whitening
}

/// The columns of a row over the whole layout, 3K x layout, and its residual.
fn dense(setup: &Setup, observation: &Prepared) -> (DMatrix<f64>, DVector<f64>) {
    let Setup { layout, state, .. } = setup;
    let rows = 3 * (1 + observation.further.len());
    let mut columns = DMatrix::zeros(rows, layout.len());
    let mut residual = DVector::zeros(rows);
    let group = &groups(std::slice::from_ref(observation))[0];
    let mut at = 0;
    PoseColumns::each(state, layout, observation, &plain(), 1.0, |pose| {
        for (c, column, sign) in places(layout, group) {
            columns
                .fixed_view_mut::<3, 1>(at, column)
                .copy_from(&(pose.own[c] * sign));
        }
        let mut phi = vec![0.0; layout.n * layout.basis()];
        pose.bases(layout, observation, phi.chunks_exact_mut(layout.basis()));
        for (j, phi) in phi.chunks_exact(layout.basis()).enumerate() {
            for (k, value) in phi.iter().enumerate() {
                let column = pose.joints[j] * *value;
                columns
                    .fixed_view_mut::<3, 1>(at, layout.joint(j) + k)
                    .copy_from(&column);
            }
        }
        residual.fixed_rows_mut::<3>(at).copy_from(&pose.residual);
        at += 3;
    });
    assert_eq!(at, rows);
    (columns, residual)
}

fn residuals(state: &State, n: usize, observation: &Prepared) -> DVector<f64> {
    let blocks = state.blocks(n, observation);
    DVector::from_iterator(
        3 * blocks.len(),
        blocks
            .iter()
            .flat_map(|b| b.residual.iter().copied().collect::<Vec<_>>()),
    )
}

// Fails if a column of a part (leading target, further target, orientation; hidden targets too) is not how its residual
// changes with the parameter.
#[test]
fn columns_of_all_parts_are_derivatives() {
    let setup = setup();
    let n = setup.layout.n;
    for observation in &setup.prepared {
        let (columns, residual) = dense(&setup, observation);
        assert!((residual - residuals(&setup.state, n, observation)).amax() < 1e-15);
        for (c, kind) in setup.layout.kinds().into_iter().enumerate() {
            let step = match kind {
                Kind::Bending(..) | Kind::Tilt(_) | Kind::Compliance(_) => 1e-6,
                _ => 1e-5,
            };
            let moved = |by: f64| {
                let mut state = setup.state.clone();
                state.add(kind, by);
                state.refresh();
                residuals(&state, n, observation)
            };
            let slope = (moved(step) - moved(-step)) / (2.0 * step);
            let off = (&slope - columns.column(c)).amax();
            let size = 1.0 + slope.amax();
            assert!(off < 3e-4 * size, "{kind:?} of row {}: {off:e}", observation.index);
        }
    }
}

// Fails if the equations of rows with several parts are not those of the dense covariance of the whole row, with one
// weight for the row.
#[test]
fn equations_are_those_of_the_dense_covariance() {
    let setup = setup();
    let Setup {
        layout,
        state,
        prepared,
    } = &setup;
    let mut whitening = plain();
    (whitening.joint, whitening.point, whitening.body) = (1e-8, 2e-9, 3e-7);
    whitening.further = [1e-9, 5e-8, 1e-9, 1e-9, 1e-9];
    whitening.tool = [4e-9, 7e-8];
    whitening.along = [3e-8, 1e-10, 2e-8, 4e-9, 1e-9, 1e-9];
    let weights: Vec<f64> = (0..prepared.len()).map(|k| 0.3 + 0.2 * k as f64).collect();
    let grouped = groups(prepared);
    let found = accumulate(state, layout, prepared, &grouped, &whitening, &weights);
    let (mut matrix, mut right) = (DMatrix::zeros(layout.len(), layout.len()), DVector::zeros(layout.len()));
    for (observation, weight) in prepared.iter().zip(&weights) {
        let (columns, residual) = dense(&setup, observation);
        let blocks = state.blocks(layout.n, observation);
        let joints = DMatrix::from_fn(residual.len(), layout.n, |r, c| blocks[r / 3].joints[c][r % 3]);
        let mut covariance = &joints * joints.transpose() * whitening.joint;
        if observation.has_several() {
            let arm = |r: usize| blocks[r / 3].arm;
            let shift = DMatrix::from_fn(residual.len(), 3, |r, c| {
                f64::from(u8::from(arm(r).is_some() && r % 3 == c))
            });
            let turn = DMatrix::from_fn(residual.len(), 3, |r, c| {
                arm(r).map_or(0.0, |arm| Vector3::ith(c, 1.0).cross(&arm)[r % 3])
            });
            let [of_shift, of_turn] = whitening.tool;
            covariance += &shift * shift.transpose() * of_shift + &turn * turn.transpose() * of_turn;
        }
        for (k, block) in blocks.iter().enumerate() {
            let own = whitening.own(block.part, block.sight);
            let (sight, mut place) = (block.sight, covariance.fixed_view_mut::<3, 3>(3 * k, 3 * k));
            place += Matrix3::from_diagonal_element(own.across) + sight * sight.transpose() * (own.along - own.across);
        }
        let inverse = covariance.try_inverse().unwrap();
        matrix += columns.transpose() * &inverse * &columns * *weight;
        right += columns.transpose() * &inverse * residual * *weight;
    }
    let off = (&found.matrix - &matrix).amax() / matrix.amax();
    assert!(off < 1e-9, "{off:e}");
    let off = (&found.gradient - &right).amax() / right.amax();
    assert!(off < 1e-9, "{off:e}");
}

fn vector() -> impl Strategy<Value = Vector3<f64>> {
    proptest::array::uniform3(-1.0..1.0_f64).prop_map(Vector3::from)
}

proptest! {
    // Fails if whitening part by part is not the forward substitution of the Cholesky factor of the whole covariance, or
    // if the determinants differ.
    #[test]
    fn whitening_by_parts_is_the_dense_cholesky(
        parts in proptest::collection::vec((proptest::array::uniform7(vector()), vector(), -3.0..1.0_f64), 1..7),
    ) {
        let mut whitening = plain();
        whitening.joint = 0.04;
        let size = 3 * parts.len();
        let joints = DMatrix::from_fn(size, 7, |r, c| parts[r / 3].0[c][r % 3]);
        let residual = DVector::from_fn(size, |r, _| parts[r / 3].1[r % 3]);
        let mut covariance = &joints * joints.transpose() * whitening.joint;
        for (k, part) in parts.iter().enumerate() {
            for axis in 0..3 {
                covariance[(3 * k + axis, 3 * k + axis)] += 10_f64.powf(2.0 * part.2);
            }
        }
        let l = covariance.cholesky().unwrap().l();
        let white = l.solve_lower_triangular(&residual).unwrap();
        let log: f64 = -l.diagonal().iter().map(|x| x.ln()).sum::<f64>();

        let mut before: Vec<(Vec<Vector3<f64>>, Vector3<f64>)> = Vec::new();
        let mut found = 0.0;
        for (k, (own, residual, floor)) in parts.iter().enumerate() {
            let floor = 10_f64.powf(2.0 * floor);
            let given = Conditional::new(&whitening, &Own::alike(floor), own, before.iter().map(|b| &b.0[..]));
            let times = |(c, column): (usize, &Vector3<f64>)| given.times(column, before.iter().map(|b| b.0[c]));
            let joints: Vec<_> = own.iter().enumerate().map(times).collect();
            let w = given.times(residual, before.iter().map(|b| b.1));
            found += given.log_determinant();
            let off = (w - white.fixed_rows::<3>(3 * k)).amax();
            prop_assert!(off < 1e-8 * (1.0 + white.amax()), "part {k}: {off:e}");
            if k == 0 {
                let root = Root::new(&whitening.covariance(own, &Own::alike(floor)));
                prop_assert_eq!(root.times(residual), w);
            }
            before.push((joints, w));
        }
        prop_assert!((found - log).abs() < 1e-8 * (1.0 + log.abs()));
    }
}
