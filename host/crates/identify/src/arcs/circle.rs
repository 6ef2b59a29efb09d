//! A circle in space, fitted to the points of an arc that a tracker measured.
//!
//! It leads from the arcs to the joint axes: an axis is the line through the circle's centre along
//! its normal. The fit is geometric: it minimises the orthogonal distances to the circle, axial and
//! radial, by Gauss-Newton from an algebraic start. Huber's and then Tukey's weights keep a few bad
//! points from moving it.

use nalgebra::{Matrix3, Matrix6, SymmetricEigen, Vector3, Vector6};

/// Fewest points of a fit: 6 unknowns, and some degrees of freedom.
const FEWEST: usize = 8;
/// Tuning constants of 95 % efficiency under normal noise (Huber, Tukey).
const HUBER: f64 = 1.345;
const TUKEY: f64 = 4.685;
/// Median absolute deviation to standard deviation, normal noise.
const MAD_TO_SIGMA: f64 = 1.4826;

/// A fitted circle.
#[derive(Clone, Debug, PartialEq)]
pub struct Circle {
    /// Centre, in m, in the frame of the points.
    pub centre_m: Vector3<f64>,
    /// Unit normal. Its sign is arbitrary until the sense of rotation is known.
    pub normal: Vector3<f64>,
    /// Radius, in m.
    pub radius_m: f64,
    /// Covariance of centre (3), tilts of the normal towards [`Circle::plane`]'s two axes (rad) and
    /// radius, in m, rad and their products.
    pub covariance: Matrix6<f64>,
    /// Two unit vectors that span the circle's plane.
    pub plane: [Vector3<f64>; 2],
    /// Noise of one residual, robustly estimated, in m.
    pub sigma_m: f64,
    /// Points given a weight below one half: outliers.
    pub outliers: usize,
}

/// Why no circle could be fitted.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum CircleError {
    /// Not enough points.
    #[error("the arc has {found} points, but {FEWEST} are needed: measure more points")]
    TooFew {
        /// Points given.
        found: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("a coordinate of point {index} is not a finite number: leave the point out or measure it again")]
    NotFinite {
        /// Index of the point.
        index: usize,
    },
    /// The points lie on a line, or in one spot.
    #[error(
        "the arc spans only {span_mm:.3} mm across: turn the joint through a wider angle or move the TCP off its axis"
    )]
    TooShort {
        /// Standard deviation of the points along the shorter direction of their plane, in mm.
        span_mm: f64,
    },
}

/// Fits a circle to `points` (m).
///
/// # Errors
/// Fewer than 8 points, coordinates that are not finite, points on a line.
pub fn fit_circle(points: &[Vector3<f64>]) -> Result<Circle, CircleError> {
    if points.len() < FEWEST {
        return Err(CircleError::TooFew { found: points.len() });
    }
    if let Some(index) = points.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
        return Err(CircleError::NotFinite { index });
    }
    let mut circle = algebraic(points)?;
    let mut weights = vec![1.0; points.len()];
    let mut tukey = false;
    // Far more than the few iterations it needs. The loop ends when nothing moves.
    for _ in 0..60 {
        let step = gauss_newton_step(&mut circle, points, &weights);
        let next = weights_of(&mut circle, points, tukey);
        let settled = step < 1e-12 * circle.radius_m.max(1e-3);
        weights = next;
        if settled {
            if tukey {
                break;
            }
            tukey = true;
        }
    }
    circle.outliers = weights.iter().filter(|w| **w < 0.5).count();
    circle.covariance = covariance(&circle, points, &weights);
    Ok(circle)
}

/// The best plane, and Kåsa's circle in it: needs no start value.
fn algebraic(points: &[Vector3<f64>]) -> Result<Circle, CircleError> {
    let n = points.len() as f64;
    let mean = points.iter().sum::<Vector3<f64>>() / n;
    let scatter = points
        .iter()
        .fold(Matrix3::zeros(), |s, p| s + (p - mean) * (p - mean).transpose())
        / n;
    let eigen = SymmetricEigen::new(scatter);
    let mut order = [0, 1, 2];
    order.sort_by(|i, j| eigen.eigenvalues[*j].total_cmp(&eigen.eigenvalues[*i]));
    let axis = |k: usize| -> Vector3<f64> { eigen.eigenvectors.column(order[k]).into_owned() };
    let span = eigen.eigenvalues[order[1]].max(0.0).sqrt();
    let (u, v) = (axis(0), axis(1));
    // x² + y² = 2 x cx + 2 y cy + k, linear in (cx, cy, k).
    let mut normal_matrix = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for p in points {
        let (x, y) = ((p - mean).dot(&u), (p - mean).dot(&v));
        let row = Vector3::new(2.0 * x, 2.0 * y, 1.0);
        normal_matrix += row * row.transpose();
        right += row * (x * x + y * y);
    }
    let too_short = CircleError::TooShort { span_mm: span * 1e3 };
    if span < 1e-6 {
        return Err(too_short);
    }
    let Some(inverse) = normal_matrix.try_inverse() else {
        return Err(too_short);
    };
    let solution = inverse * right;
    let (cx, cy) = (solution.x, solution.y);
    let radius_m = (solution.z + cx * cx + cy * cy).max(0.0).sqrt();
    if !radius_m.is_finite() || radius_m > 100.0 {
        return Err(too_short);
    }
    Ok(Circle {
        centre_m: mean + u * cx + v * cy,
        normal: u.cross(&v),
        radius_m,
        covariance: Matrix6::zeros(),
        plane: [u, v],
        sigma_m: 0.0,
        outliers: 0,
    })
}

/// Axial and radial distance of a point from the circle, and their derivatives
/// with respect to centre, tilts and radius.
fn residuals(circle: &Circle, p: &Vector3<f64>) -> ([f64; 2], [Vector6<f64>; 2]) {
    let [u, v] = circle.plane;
    let w = p - circle.centre_m;
    let axial = circle.normal.dot(&w);
    let flat = w - circle.normal * axial;
    let rho = flat.norm();
    let e = if rho > 1e-12 { flat / rho } else { u };
    let (eu, ev) = (e.dot(&u), e.dot(&v));
    let n = circle.normal;
    (
        [axial, rho - circle.radius_m],
        [
            Vector6::new(-n.x, -n.y, -n.z, u.dot(&w), v.dot(&w), 0.0),
            Vector6::new(-e.x, -e.y, -e.z, -axial * eu, -axial * ev, -1.0),
        ],
    )
}

/// One weighted Gauss-Newton step; returns its length in m (tilts times radius).
fn gauss_newton_step(circle: &mut Circle, points: &[Vector3<f64>], weights: &[f64]) -> f64 {
    let mut matrix = Matrix6::zeros();
    let mut gradient = Vector6::zeros();
    for (p, weight) in points.iter().zip(weights) {
        let (r, j) = residuals(circle, p);
        for k in 0..2 {
            matrix += j[k] * j[k].transpose() * *weight;
            gradient += j[k] * (r[k] * weight);
        }
    }
    let Some(factor) = matrix.cholesky() else {
        return 0.0;
    };
    let step = -factor.solve(&gradient);
    let [u, v] = circle.plane;
    circle.centre_m += Vector3::new(step[0], step[1], step[2]);
    circle.normal = (circle.normal + u * step[3] + v * step[4]).normalize();
    circle.radius_m += step[5];
    // Carry the plane's axes along with the normal.
    let carried = (u - circle.normal * circle.normal.dot(&u)).normalize();
    circle.plane = [carried, circle.normal.cross(&carried)];
    let tilt = circle.radius_m * step[3].hypot(step[4]);
    step.fixed_rows::<3>(0).norm().hypot(tilt).hypot(step[5])
}

/// Weights of the points at the present circle; also re-estimates the noise.
fn weights_of(circle: &mut Circle, points: &[Vector3<f64>], tukey: bool) -> Vec<f64> {
    let each: Vec<[f64; 2]> = points.iter().map(|p| residuals(circle, p).0).collect();
    let mut absolute: Vec<f64> = each.iter().flatten().map(|r| r.abs()).collect();
    absolute.sort_by(f64::total_cmp);
    let median = absolute[absolute.len() / 2];
    // The lower limit keeps exact data (without any noise) at weight 1.
    circle.sigma_m = MAD_TO_SIGMA * median;
    let scale = circle.sigma_m.max(1e-12);
    each.iter()
        .map(|r| {
            let z = r[0].abs().max(r[1].abs()) / scale;
            if tukey {
                let inside = 1.0 - (z / (TUKEY * 1.1)).powi(2);
                if inside > 0.0 { inside * inside } else { 0.0 }
            } else {
                (HUBER / z.max(HUBER)).min(1.0)
            }
        })
        .collect()
}

/// `s² (Jᵀ W J)⁻¹`, with `s²` from the weighted residuals.
fn covariance(circle: &Circle, points: &[Vector3<f64>], weights: &[f64]) -> Matrix6<f64> {
    let mut matrix = Matrix6::zeros();
    let (mut sum, mut count) = (0.0, 0.0);
    for (p, weight) in points.iter().zip(weights) {
        let (r, j) = residuals(circle, p);
        for k in 0..2 {
            matrix += j[k] * j[k].transpose() * *weight;
            sum += weight * r[k] * r[k];
            count += weight;
        }
    }
    let variance = sum / (count - 6.0).max(1.0);
    matrix
        .try_inverse()
        .map_or_else(Matrix6::zeros, |inverse| inverse * variance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    fn arc(normal: Vector3<f64>, radius: f64, span: f64, n: usize, noise: f64, seed: u64) -> Vec<Vector3<f64>> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let noise = Normal::new(0.0, noise).expect("finite");
        let u = normal.cross(&Vector3::new(0.3, -0.5, 0.8)).normalize();
        let v = normal.cross(&u);
        (0..n)
            .map(|i| {
                let angle = span * (i as f64 / (n - 1) as f64 - 0.5);
                Vector3::new(0.2, -1.0, 3.0)
                    + (u * angle.cos() + v * angle.sin()) * radius
                    + Vector3::from_fn(|_, _| noise.sample(&mut rng))
            })
            .collect()
    }

    proptest! {
        // Fails if the geometric fit does not return the circle of exact points.
        #[test]
        fn exact_points_give_the_circle(x in -1.0f64..1.0, y in -1.0f64..1.0, radius in 0.03f64..1.0, span in 0.6f64..6.0) {
            let normal = Vector3::new(x, y, 0.4).normalize();
            let circle = fit_circle(&arc(normal, radius, span, 40, 0.0, 1)).expect("a good arc");
            prop_assert!((circle.centre_m - Vector3::new(0.2, -1.0, 3.0)).norm() < 1e-9);
            prop_assert!(circle.normal.cross(&normal).norm() < 1e-9);
            prop_assert!((circle.radius_m - radius).abs() < 1e-9);
        }
    }

    // Fails if the stated covariance is not the scatter of repeated fits.
    #[test]
    fn covariance_is_the_scatter_of_repeated_fits() {
        let normal = Vector3::new(0.1, 0.2, 1.0).normalize();
        let (mut scatter, mut stated) = (0.0, 0.0);
        let runs = 300;
        for seed in 0..runs {
            let circle = fit_circle(&arc(normal, 0.5, 2.0, 60, 25e-6, seed)).expect("a good arc");
            scatter += (circle.centre_m - Vector3::new(0.2, -1.0, 3.0)).norm_squared();
            stated += circle.covariance.fixed_view::<3, 3>(0, 0).trace();
        }
        let ratio = (scatter / stated).sqrt();
        assert!((0.9..1.15).contains(&ratio), "scatter over stated {ratio}");
    }

    // Fails if two gross errors in sixty move the axis by more than the noise would.
    #[test]
    fn gross_errors_are_found_and_left_out() {
        let normal = Vector3::new(0.1, 0.2, 1.0).normalize();
        let mut points = arc(normal, 0.5, 2.0, 60, 25e-6, 7);
        points[10] += Vector3::new(0.0, 0.004, 0.002);
        points[41] -= Vector3::new(0.001, 0.0, 0.003);
        let circle = fit_circle(&points).expect("a good arc");
        assert!(
            circle.outliers >= 2 && circle.outliers < 8,
            "{} outliers",
            circle.outliers
        );
        assert!((circle.centre_m - Vector3::new(0.2, -1.0, 3.0)).norm() < 60e-6);
    }

    #[test]
    fn hopeless_arcs_are_refused() {
        let line: Vec<_> = (0..20).map(|i| Vector3::new(f64::from(i) * 0.01, 0.0, 0.0)).collect();
        assert!(matches!(fit_circle(&line), Err(CircleError::TooShort { .. })));
        assert_eq!(fit_circle(&line[..5]), Err(CircleError::TooFew { found: 5 }));
        let mut bad = line;
        bad[3].y = f64::NAN;
        assert_eq!(fit_circle(&bad), Err(CircleError::NotFinite { index: 3 }));
    }
}
