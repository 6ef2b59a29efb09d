//! Errors over the workspace in three dimensions (Figure 10 of the paper). The view is from the
//! front right and above. Each configuration is a dot whose radius shows the robot's error.

use plotters::prelude::*;

use super::charts::{ChartError, FAINT, INK, SERIES, SOFT, draw, round_step};
use super::input::WorkspacePoint;

/// Azimuth and elevation of the eye, in rad.
const EYE: (f64, f64) = (-0.9, 0.42);

/// Where a point (m) appears in the view: right, up, and depth towards the eye, in m.
fn project(p: [f64; 3]) -> (f64, f64, f64) {
    let (sa, ca) = EYE.0.sin_cos();
    let (se, ce) = EYE.1.sin_cos();
    let right = -sa * p[0] + ca * p[1];
    let away = ca * p[0] + sa * p[1];
    (-right, ce * p[2] - se * (-away), se * p[2] - ce * away)
}

/// A box around the points with round corners, in m: low and high.
fn bounds(points: &[WorkspacePoint]) -> ([f64; 3], [f64; 3], f64) {
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for p in points {
        for k in 0..3 {
            low[k] = low[k].min(p.at_m[k]);
            high[k] = high[k].max(p.at_m[k]);
        }
    }
    let span = (0..3).map(|k| high[k] - low[k]).fold(0.1, f64::max);
    let step = round_step(span, 6.0);
    for k in 0..3 {
        low[k] = (low[k] / step).floor() * step;
        high[k] = (high[k] / step).ceil() * step;
    }
    (low, high, step)
}

/// Radius of the largest dot, in pixels.
const LARGEST_DOT: f64 = 16.0;

/// Radius of the dot of an error, in pixels: in proportion to the error, as far as it can be seen.
fn radius(value: f64, largest: f64) -> i32 {
    (LARGEST_DOT * (value / largest).clamp(0.0, 1.0)).round().max(2.0) as i32
}

/// Both models, to one scale: the nominal robot, and the calibrated one.
pub(super) fn panels(points: &[WorkspacePoint]) -> Result<[String; 2], ChartError> {
    let largest = points
        .iter()
        .flat_map(|p| [p.nominal_mm, p.calibrated_mm])
        .filter(|v| v.is_finite())
        .fold(1e-6, f64::max);
    Ok([
        panel(points, largest, "before: nominal", SERIES[0], |p| p.nominal_mm)?,
        panel(points, largest, "after: calibrated", SERIES[1], |p| p.calibrated_mm)?,
    ])
}

/// One model; `largest` is the error of the largest dot, in mm.
fn panel(
    points: &[WorkspacePoint],
    largest: f64,
    title: &str,
    colour: RGBColor,
    error_mm: impl Fn(&WorkspacePoint) -> f64,
) -> Result<String, ChartError> {
    let (low, high, step) = bounds(points);
    let corners: Vec<[f64; 3]> = (0..8)
        .map(|c| core::array::from_fn(|k| if c >> k & 1 == 0 { low[k] } else { high[k] }))
        .collect();
    let seen: Vec<(f64, f64, f64)> = corners.iter().map(|c| project(*c)).collect();
    let range = |of: fn(&(f64, f64, f64)) -> f64| {
        seen.iter()
            .map(of)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
    };
    let (x0, x1) = range(|s| s.0);
    let (y0, y1) = range(|s| s.1);
    let (width, height, top) = (480.0, 320.0, 34.0);
    let scale = ((width - 70.0) / (x1 - x0)).min((height - top - 48.0) / (y1 - y0));
    let left = (width - scale * (x1 - x0)) / 2.0;
    let at = |p: [f64; 3]| {
        let (x, y, _) = project(p);
        ((left + scale * (x - x0)) as i32, (top + scale * (y1 - y)) as i32)
    };
    draw(
        (width as u32, height as u32),
        &format!("Position errors, {title}"),
        |area| {
            let line =
                |a: [f64; 3], b: [f64; 3], style: ShapeStyle| area.draw(&PathElement::new(vec![at(a), at(b)], style));
            // The floor's grid and the two walls behind.
            let thin = FAINT.stroke_width(1);
            for axis in 0..2 {
                let mut v = low[axis];
                while v <= high[axis] + 1e-9 {
                    let (mut a, mut b) = (low, low);
                    (a[axis], b[axis]) = (v, v);
                    b[1 - axis] = high[1 - axis];
                    line(a, b, thin)?;
                    v += step;
                }
            }
            for (a, b) in [(0, 4), (1, 5), (2, 6), (3, 7), (4, 5), (5, 7), (7, 6), (6, 4)] {
                line(corners[a], corners[b], thin)?;
            }
            let text = |words: String, p: (i32, i32), size: i32, c: &RGBColor| {
                area.draw(&Text::new(words, p, ("sans-serif", size).into_font().color(c)))
            };
            text(title.to_owned(), (12, 10), 18, &INK)?;
            for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
                let mut end = low;
                end[axis] = high[axis];
                line(low, end, SOFT.stroke_width(2))?;
                end[axis] += 0.12 * step;
                let (px, py) = at(end);
                text(format!("{name} {:.1} m", high[axis]), (px + 4, py - 6), 13, &SOFT)?;
            }
            let mut order: Vec<&WorkspacePoint> = points.iter().collect();
            order.sort_by(|a, b| project(a.at_m).2.total_cmp(&project(b.at_m).2));
            for p in order {
                let size = radius(error_mm(p), largest);
                area.draw(&Circle::new(at(p.at_m), size, colour.mix(0.55).filled()))?;
            }
            // The scale of the dots, with its unit.
            let base = height as i32 - 17;
            text("error:".to_owned(), (12, base - 7), 15, &SOFT)?;
            for (k, share) in [0.1, 0.3, 1.0].into_iter().enumerate() {
                let x = 90 + 120 * k as i32;
                let size = radius(share * largest, largest);
                area.draw(&Circle::new((x, base), size, SOFT.mix(0.55).filled()))?;
                text(
                    format!("{:.2} mm", share * largest),
                    (x + size + 6, base - 7),
                    15,
                    &SOFT,
                )?;
            }
            Ok(())
        },
    )
}
