//! The paper's figures as SVG: the contact's force (5), the measured points (10)
//! and the histograms of the validation errors (11, 12).

use plotters::prelude::*;

use crate::Estimator;

use super::Reproduction;

const SIZE: (u32, u32) = (720, 480);
/// Force at which contact is declared, in N.
const TRIGGER_N: f64 = 7.5;

/// Colours of models, distinct in grey and for the colour-blind.
const COLOURS: [RGBColor; 4] = [
    RGBColor(120, 120, 120),
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
];

/// All figures: file name and content.
pub(super) fn all(r: &Reproduction) -> Result<Vec<(&'static str, String)>, Box<dyn std::error::Error>> {
    let mut figures = vec![
        ("figure_10.svg", points(r)?),
        (
            "figure_11.svg",
            histogram(
                r,
                "Figure 11. Validation errors",
                &[
                    Estimator::Nominal,
                    Estimator::PaperNelderMead,
                    Estimator::LaserNelderMead,
                    Estimator::Sphere,
                ],
            )?,
        ),
        (
            "figure_12.svg",
            histogram(
                r,
                "Figure 12. Validation errors of calibrated models",
                &[
                    Estimator::LaserNelderMead,
                    Estimator::PaperNelderMead,
                    Estimator::Laser,
                    Estimator::Sphere,
                ],
            )?,
        ),
    ];
    if r.contact_force.len() > 1 {
        figures.push(("figure_5.svg", force(&r.contact_force)?));
    }
    Ok(figures)
}

type Drawn = Result<String, Box<dyn std::error::Error>>;

/// Figure 5: force against time, with the trigger.
fn force(trace: &[(f64, f64)]) -> Drawn {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        area.fill(&WHITE)?;
        let span = |f: fn(&(f64, f64)) -> f64| {
            let low = trace.iter().map(f).fold(f64::INFINITY, f64::min);
            let high = trace.iter().map(f).fold(f64::NEG_INFINITY, f64::max);
            low..high.max(low + 1e-6)
        };
        let height = span(|p| p.1);
        let mut chart = ChartBuilder::on(&area)
            .caption("Figure 5. Force during a contact", ("sans-serif", 20))
            .margin(12)
            .x_label_area_size(40)
            .y_label_area_size(56)
            .build_cartesian_2d(span(|p| p.0), height.start.min(0.0)..height.end.max(1.2 * TRIGGER_N))?;
        chart.configure_mesh().x_desc("time (s)").y_desc("force (N)").draw()?;
        chart.draw_series(LineSeries::new(trace.iter().copied(), &COLOURS[1]))?;
        let (first, last) = (trace[0].0, trace[trace.len() - 1].0);
        chart.draw_series(LineSeries::new([(first, TRIGGER_N), (last, TRIGGER_N)], &COLOURS[2]))?;
        area.present()?;
    }
    Ok(svg)
}

/// Figure 10: calibration and validation points, from above and from the side.
fn points(r: &Reproduction) -> Drawn {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (SIZE.0 * 4 / 3, SIZE.1)).into_drawing_area();
        area.fill(&WHITE)?;
        let titled = area.titled(
            "Figure 10. Calibration (blue) and validation (orange) points, m",
            ("sans-serif", 20),
        )?;
        let halves = titled.split_evenly((1, 2));
        for (half, (i, j, x, y)) in halves.iter().zip([(0, 1, "x (m)", "y (m)"), (0, 2, "x (m)", "z (m)")]) {
            let range = |k: usize| {
                let all = || r.points_m.iter().flatten().map(|p| p[k]);
                let (low, high) = (
                    all().fold(f64::INFINITY, f64::min),
                    all().fold(f64::NEG_INFINITY, f64::max),
                );
                if low.is_finite() {
                    low - 0.05..high + 0.05
                } else {
                    0.0..1.0
                }
            };
            let mut chart = ChartBuilder::on(half)
                .margin(12)
                .x_label_area_size(40)
                .y_label_area_size(48)
                .build_cartesian_2d(range(i), range(j))?;
            chart.configure_mesh().x_desc(x).y_desc(y).draw()?;
            for (points, colour) in r.points_m.iter().zip([COLOURS[1], COLOURS[2]]) {
                chart.draw_series(points.iter().map(|p| Circle::new((p[i], p[j]), 2, colour.filled())))?;
            }
        }
        area.present()?;
    }
    Ok(svg)
}

/// Figures 11 and 12: histograms of the errors with the arc-measured base, as
/// outlines that can lie over each other.
fn histogram(r: &Reproduction, title: &str, models: &[Estimator]) -> Drawn {
    let chosen: Vec<_> = models
        .iter()
        .filter_map(|name| r.validation.model(name.name()))
        .collect();
    let largest = chosen.iter().map(|m| m.arcs.max_mm).fold(0.1, f64::max);
    let bins = 30;
    let width = largest * 1.02 / f64::from(bins);
    let counts: Vec<Vec<f64>> = chosen
        .iter()
        .map(|m| {
            let mut counts = vec![0.0; bins as usize];
            for error in &m.errors_mm[0] {
                let bin = (error / width) as usize;
                if let Some(count) = counts.get_mut(bin) {
                    *count += 1.0;
                }
            }
            counts
        })
        .collect();
    let highest = counts.iter().flatten().copied().fold(1.0, f64::max);
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        area.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&area)
            .caption(title, ("sans-serif", 20))
            .margin(12)
            .x_label_area_size(40)
            .y_label_area_size(48)
            .build_cartesian_2d(0.0..largest * 1.02, 0.0..highest * 1.08)?;
        chart
            .configure_mesh()
            .x_desc("error (mm)")
            .y_desc("configurations")
            .draw()?;
        for ((model, counts), colour) in chosen.iter().zip(&counts).zip(COLOURS) {
            let outline = counts.iter().enumerate().flat_map(|(k, count)| {
                let left = k as f64 * width;
                [(left, *count), (left + width, *count)]
            });
            chart
                .draw_series(AreaSeries::new(outline, 0.0, colour.mix(0.18)).border_style(colour.stroke_width(2)))?
                .label(&model.name)
                .legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 14, y + 5)], colour.filled()));
        }
        chart
            .configure_series_labels()
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK)
            .draw()?;
        area.present()?;
    }
    Ok(svg)
}
