//! Whether world W5s is as hard as a real arm: residuals of the full model, compared with those of the stored iiwa 14.

use nalgebra::Vector3;
use rayon::prelude::*;
use spherecal::identify::{Experiment, Options, Target, identify};
use spherecal::plan::{Cell, DesignRequest, design};
use spherecal::sim::worlds::World;
use spherecal_lab::worlds::{planned_poses, record_poses};

/// Rows of the real data.
const ROWS: usize = 180;

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Shape {
    /// Root mean square of the residuals' lengths, in mm.
    rms_mm: f64,
    /// Fourth moment of their coordinates over the square of the second: 3 for normal errors.
    kurtosis: f64,
    /// Share of the rows that are named as outliers.
    outliers: f64,
    /// Correlation of the residuals of rows that follow each other on one sphere.
    neighbours: f64,
}

impl Shape {
    fn of(experiment: &Experiment) -> Self {
        let fit = identify(experiment, &Options::default()).expect("readable data");
        let rows = &fit.residual.rows;
        let errors: Vec<Vector3<f64>> = rows.iter().map(|r| Vector3::from(r.error_mm)).collect();
        let n = errors.len() as f64;
        let square = errors.iter().map(Vector3::norm_squared).sum::<f64>() / n;
        let fourth = errors.iter().flatten_axes().map(|x| x.powi(4)).sum::<f64>() / (3.0 * n);
        let sphere = |k: usize| match experiment.observations[rows[k].index].target {
            Target::Sphere { sphere, place } => Some((sphere, place)),
            _ => None,
        };
        let (mut product, mut pairs) = (0.0, 0.0);
        for k in 1..errors.len() {
            if sphere(k) == sphere(k - 1) {
                product += errors[k].dot(&errors[k - 1]);
                pairs += 1.0;
            }
        }
        Self {
            rms_mm: square.sqrt(),
            kurtosis: fourth / (square / 3.0).powi(2),
            outliers: fit.residual.outliers.len() as f64 / n,
            neighbours: product / pairs / square,
        }
    }
}

/// The coordinates of vectors, one after the other.
trait Axes<'a>: Iterator<Item = &'a Vector3<f64>> + Sized {
    fn flatten_axes(self) -> impl Iterator<Item = f64> {
        self.flat_map(|v| [v.x, v.y, v.z])
    }
}

impl<'a, I: Iterator<Item = &'a Vector3<f64>>> Axes<'a> for I {}

/// Shapes of robots of W5s with as many rows as the real data, of a first seed.
fn drawn(first: u64, robots: u64) -> Vec<Shape> {
    let plan = design(&Cell::iiwa7(), &DesignRequest::new(ROWS)).expect("the built-in cell is plannable");
    let poses = planned_poses(&plan);
    (first..first + robots)
        .into_par_iter()
        .map(|seed| Shape::of(&record_poses(World::W5s, seed, &poses).expect("a world").spheres))
        .collect()
}

/// Tenth, median and ninetieth of a hundred.
fn spread(drawn: &[Shape], of: fn(&Shape) -> f64) -> [f64; 3] {
    let mut values: Vec<f64> = drawn.iter().map(of).collect();
    values.sort_by(f64::total_cmp);
    [0.1, 0.5, 0.9].map(|share| values[(share * (values.len() - 1) as f64).round() as usize])
}

// Fails if the residuals that the full model leaves on W5s are not like those that it leaves on the real iiwa 14: root
// mean square and correlation of neighbours within 20 % in the median of the robots. Outliers and fourth moment of the
// median robot are smaller than the real ones (docs/design/identification.md): there the real one must lie among
// the middle four fifths of W5s' robots. W0 fails in all four.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_w5s_leaves_the_residuals_of_a_real_arm() {
    let real = Shape::of(&super::mukca::experiment());
    let drawn = drawn(9000, 24);
    for (name, near, of) in [
        ("root mean square, mm", true, (|s| s.rms_mm) as fn(&Shape) -> f64),
        ("neighbours", true, |s| s.neighbours),
        ("outliers", false, |s| s.outliers),
        ("kurtosis", false, |s| s.kurtosis),
    ] {
        let (own, [low, median, high]) = (of(&real), spread(&drawn, of));
        println!("{name}: real iiwa 14 {own:.3}, W5s {median:.3} ({low:.3} to {high:.3})");
        if near {
            assert!((median / own - 1.0).abs() < 0.2, "{name}: {median} of {own}");
        } else {
            assert!((low..=high).contains(&own), "{name}: {own} of {low} to {high}");
        }
    }
}
