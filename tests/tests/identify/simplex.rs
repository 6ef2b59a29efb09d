//! Nelder-Mead against SciPy, and the paper's procedure against the stored world.

use nalgebra::{Matrix3, Vector3};
use spherecal::identify::{DistanceProblem, Options, Pairs, Pose};
use spherecal_lab::paper::{PaperProcedure, mini_batches, problem, scaled, whole};
use spherecal_lab::simplex::{SearchEnd, SearchLimits, minimise, usual_simplex};
use spherecal_tests::worlds::World;

#[derive(serde::Deserialize)]
struct Case {
    function: String,
    start: Vec<f64>,
    maxiter: Option<usize>,
    maxfev: Option<usize>,
    xatol: f64,
    fatol: f64,
    exact: bool,
    x: Vec<f64>,
    fun: f64,
    nit: usize,
    nfev: usize,
    status: usize,
    simplex: Vec<Vec<f64>>,
}

#[derive(serde::Deserialize)]
struct Cases {
    cases: Vec<Case>,
}

/// The functions of `tests/simplex_scipy.py`, operation by operation.
fn function(name: &str) -> fn(&[f64]) -> f64 {
    match name {
        "rosenbrock" => |x| {
            let mut s = 0.0;
            for i in 0..x.len() - 1 {
                let a = x[i + 1] - x[i] * x[i];
                let b = 1.0 - x[i];
                s += 100.0 * (a * a) + b * b;
            }
            s
        },
        "ellipsoid" => |x| {
            let mut s = 0.0;
            for (i, x) in x.iter().enumerate() {
                let d = x - 0.25 * i as f64;
                s += (1.0 + 3.0 * i as f64) * (d * d);
            }
            s
        },
        "absolute" => |x| {
            let mut s = 0.0;
            for (i, x) in x.iter().enumerate() {
                s += (i as f64 + 1.0) * (x - 0.5).abs();
            }
            s
        },
        "plateau" => |x| {
            let mut s = 0.0;
            for x in x {
                s += (8.0 * (x * x)).floor() / 8.0;
            }
            s
        },
        "powell" => |x| {
            let p = x[0] + 10.0 * x[1];
            let q = x[2] - x[3];
            let r = x[1] - 2.0 * x[2];
            let t = x[0] - x[3];
            p * p + 5.0 * (q * q) + (r * r) * (r * r) + 10.0 * ((t * t) * (t * t))
        },
        "wave" => |x| {
            let mut s = 0.0;
            for x in x {
                s = s + x * x - (3.0 * x).cos() * (-x * x).exp();
            }
            s
        },
        other => panic!("no function {other}"),
    }
}

// Fails if the search takes another path than SciPy's: where the function is
// exact arithmetic every bit of result and simplex must be the same.
#[test]
fn the_simplex_is_scipys_bit_by_bit() {
    let Cases { cases } = spherecal_tests::data("simplex_scipy.json");
    for case in &cases {
        let limits = SearchLimits {
            iterations: case.maxiter,
            evaluations: case.maxfev,
            x_tolerance: case.xatol,
            f_tolerance: case.fatol,
            ..SearchLimits::default()
        };
        let found = minimise(function(&case.function), usual_simplex(&case.start), &limits);
        let name = format!("{} {:?}", case.function, case.start);
        assert_eq!((found.evaluations, found.iterations), (case.nfev, case.nit), "{name}");
        let ended = [SearchEnd::Converged, SearchEnd::Evaluations, SearchEnd::Iterations][case.status];
        assert_eq!(found.ended, ended, "{name}");
        if case.exact {
            assert_eq!(found.value, case.fun, "{name}");
            assert_eq!(found.x, case.x, "{name}");
            assert_eq!(found.simplex, case.simplex, "{name}");
        } else {
            assert!((found.value - case.fun).abs() < 1e-9, "{name}");
        }
    }
    assert!(cases.len() >= 12);
}

fn spheres_of_w1(pairs: Pairs) -> (World, DistanceProblem) {
    let world = World::load("world_W1_seed0");
    let mut spheres = world.spheres();
    spheres.tool = world.measured_tool();
    let options = Options {
        pairs,
        subset: Some(world.subset300.clone()),
        base: Some(Pose {
            rotation: Matrix3::from_fn(|r, c| world.nominal_rotation[r][c]),
            position: Vector3::zeros(),
        }),
        ..Options::default()
    };
    let (problem, _) = problem(&spheres, &options, &PaperProcedure::default()).expect("good data");
    (world, problem)
}

// Fails if objective or simplex differ from SciPy's run on the same data, or if
// the parameters that start at zero do not freeze as in the paper's Table 6.
#[test]
fn the_papers_simplex_is_reproduced_and_freezes() {
    let (world, spheres) = spheres_of_w1(Pairs::Vector);
    let short = |evaluations| SearchLimits {
        evaluations: Some(evaluations),
        ..SearchLimits::default()
    };
    let found = whole(&spheres, &short(120));
    let stored = &world.expected["sphere_NM_vec_120fev"];
    assert_eq!(found.searches, [(120, 52)]);
    // SciPy on this sum, centred about its mean, gives 26982.073368293597; the
    // stored 26982.073395 is the same point by a formula that cancels 9 digits.
    assert!(
        (found.objective_mm2 - 26982.073368293597).abs() < 1e-7,
        "{}",
        found.objective_mm2
    );
    assert!((found.objective_mm2 / 26982.073395 - 1.0).abs() < 2e-9);
    for (ours, theirs) in found.x.iter().zip(&stored.x) {
        assert!((ours - theirs).abs() < 1e-9, "{ours} {theirs}");
    }
    // On these 300 poses SciPy too freezes from 118 evaluations on (51 iterations).
    for evaluations in 118..=140 {
        let found = whole(&spheres, &short(evaluations));
        assert_eq!(found.zeros().len(), 12);
        assert!(found.frozen() >= 10, "{evaluations}: {:?}", found.zeros());
    }

    let mut laser = world.laser();
    laser.tool = world.measured_tool();
    let options = Options {
        base: Some(world.base()),
        ..Options::default()
    };
    let (laser, _) = problem(&laser, &options, &PaperProcedure::default()).expect("good data");
    let found = whole(&laser, &short(120));
    assert_eq!(found.searches, [(120, 52)]);
    assert!(
        (found.objective_mm2 - 473.609310).abs() < 1e-6,
        "{}",
        found.objective_mm2
    );
}

// Fails if the scaled simplex misses the optimum by 1 %, or if the usual one,
// with as many evaluations, is not far from it: the first steps are at fault.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_scaled_steps_reach_the_optimum_and_the_usual_do_not() {
    for pairs in [Pairs::Vector, Pairs::Norm] {
        let (_, problem) = spheres_of_w1(pairs);
        let optimum = problem.objective_mm2(&problem.solve(false).expect("solvable"));
        let found = scaled(&problem);
        let ratio = found.objective_mm2 / optimum;
        let evaluations: usize = found.searches.iter().map(|s| s.0).sum();
        println!("{pairs:?}: {optimum} mm², {ratio} after {evaluations} evaluations");
        assert!(ratio < 1.01, "{pairs:?}: {ratio} after {evaluations} evaluations");
        if pairs == Pairs::Vector {
            let usual = whole(&problem, &SearchLimits::default()).objective_mm2 / optimum;
            println!("usual simplex {usual}");
            assert!(usual > 5.0, "{usual}");
        }
    }
}

// Fails if the sequential mini-batches do not end in the values of the paper's
// Table 6: ten or more of twelve at 5.5e-5 to 6.3e-5, theta3 at -4.9e-4.
#[test]
fn mini_batches_end_in_the_values_of_table_6() {
    let (_, problem) = spheres_of_w1(Pairs::Vector);
    let run = mini_batches(&problem, &PaperProcedure::default(), 1);
    assert!(run.searches.iter().all(|s| s.0 == 120));
    let zeros = run.zeros();
    let near = zeros.iter().filter(|(_, x)| (5.5e-5..6.4e-5).contains(x)).count();
    assert!(near >= 10, "{zeros:?}");
    let odd: Vec<_> = zeros.iter().filter(|(_, x)| *x < -4e-4).collect();
    assert!(odd.len() == 1 && (odd[0].1 + 4.9e-4).abs() < 0.2e-4, "{zeros:?}");
}
