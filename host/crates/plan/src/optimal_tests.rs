use nalgebra::Vector3;

use super::super::selection::align;
use super::*;
use spherecal_model::halton::halton;

fn problem(n: usize, m: usize) -> SelectionProblem {
    let number = |i: usize, k: usize| 4.0 * halton(i * 31 + k * 7 + 1, (i + k) % 11) - 2.0;
    let candidates: Vec<Vec<f64>> = (0..n).map(|c| (0..3 * m).map(|k| number(c, k)).collect()).collect();
    let predictions = (0..9)
        .map(|v| {
            let rows = (0..3 * m).map(|k| number(v + 1000, k)).collect();
            let p = Vector3::new(halton(v + 1, 0), halton(v + 1, 1), halton(v + 1, 2));
            (rows, p, 0.1)
        })
        .collect::<Vec<_>>();
    SelectionProblem::new(m, &candidates, &predictions)
}

// Largest error of `S` and `T` after many updates, relative to the largest of each.
fn drift(design: &mut Design<'_>) -> f64 {
    let (s, t) = (design.s.clone(), design.t.clone());
    design.refresh();
    let largest = |of: &[Matrix3<f64>]| of.iter().map(Matrix3::amax).fold(0.0, f64::max);
    let difference = |a: &[Matrix3<f64>], b: &[Matrix3<f64>]| {
        let pairs = a.iter().zip(b).map(|(a, b)| (a - b).amax());
        pairs.fold(0.0, f64::max) / largest(b)
    };
    difference(&s, &design.s).max(difference(&t, &design.t))
}

// The criterion computed directly, by inverting the information matrix.
fn direct(problem: &SelectionProblem, chosen: &[usize]) -> f64 {
    let m = problem.weight.nrows();
    let mut information = DMatrix::<f64>::identity(m, m);
    for c in chosen {
        let a = problem.candidate(*c);
        information += &a * a.transpose();
    }
    (&problem.weight * information.try_inverse().expect("positive definite")).trace()
}

// Fails if an update of Σ, S, T or the criterion is wrong when a candidate is added or removed.
#[test]
fn updates_equal_the_direct_computation() {
    let problem = problem(60, 8);
    let mut design = Design::new(&problem);
    assert!((design.value - direct(&problem, &[])).abs() < 1e-9);
    for (c, sign) in [(3, 1.0), (17, 1.0), (22, 1.0), (17, -1.0), (30, 1.0), (3, -1.0)] {
        let expected = design.value - if sign > 0.0 { design.gain(c) } else { -design.loss(c) };
        design.update(c, sign);
        assert!((design.value - expected).abs() < 1e-9);
        assert!((design.value - direct(&problem, &design.chosen)).abs() < 1e-9);
    }
    assert!(drift(&mut design) < 1e-9);
    // Where many are chosen, the candidates are ranked with the error of single precision.
    design.grow(MANY + 8, |_| ());
    design.exchange(2, 0.0);
    assert!((design.value - direct(&problem, &design.chosen)).abs() < 1e-9);
    assert!(drift(&mut design) < 1e-5);
}

// Fails if the greedy step is not the best single one, or if a swap increases the criterion.
#[test]
fn greedy_takes_the_best_and_exchange_never_loses() {
    let problem = problem(40, 8);
    let mut design = Design::new(&problem);
    design.grow(1, |_| ());
    let best = (0..40).map(|c| direct(&problem, &[c])).fold(f64::INFINITY, f64::min);
    assert!((design.value - best).abs() < 1e-9);
    design.grow(6, |_| ());
    let before = design.value;
    design.exchange(3, 1e-9);
    assert_eq!(design.chosen.len(), 6);
    assert!(design.value <= before + 1e-12);
}

// Fails if a rigid motion of all validation points still counts as error.
#[test]
fn the_base_is_aligned_out() {
    let points: Vec<Vector3<f64>> = (1..9)
        .map(|i| Vector3::new(halton(i, 0), halton(i, 1), halton(i, 2)))
        .collect();
    let mut blocks: Vec<DMatrix<f64>> = points
        .iter()
        .map(|p| {
            let v = Vector3::new(0.1, -0.2, 0.3) + Vector3::new(0.4, 0.5, -0.6).cross(p);
            DMatrix::from_row_slice(1, 3, v.as_slice())
        })
        .collect();
    align(&mut blocks, &points);
    assert!(blocks.iter().all(|b| b.amax() < 1e-12));
}
