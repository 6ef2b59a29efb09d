//! Draws figures as SVG, by `plotters`, in the colours of the page's theme.
//!
//! `plotters` writes fixed colours. Each is a placeholder (see [`PALETTE`]): [`themed`] makes it a variable of the page.

use std::fmt::Write as _;

use plotters::coord::Shift;
use plotters::prelude::*;

use super::input::{ErrorSeries, PredictedAccuracy, ResidualPoint};
use spherecal_identify::evaluate::model_title;
use spherecal_model::ContactTrace;

/// A figure that could not be drawn.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{figure}: {message}")]
pub struct ChartError {
    /// Which one.
    pub figure: String,
    /// What the drawing said.
    pub message: String,
}

/// Placeholder colours and the CSS variables that replace them.
const PALETTE: [(RGBColor, &str); 11] = [
    (INK, "--ink"),
    (FAINT, "--rule"),
    (SOFT, "--soft"),
    (SERIES[0], "--series-0"),
    (SERIES[1], "--series-1"),
    (SERIES[2], "--series-2"),
    (SERIES[3], "--series-3"),
    (SERIES[4], "--series-4"),
    (SERIES[5], "--series-5"),
    (ALARM, "--alarm"),
    (PAPER, "--paper"),
];
pub(super) const INK: RGBColor = RGBColor(1, 2, 3);
pub(super) const FAINT: RGBColor = RGBColor(4, 5, 6);
pub(super) const SOFT: RGBColor = RGBColor(7, 8, 9);
/// One colour for each known model (see [`colour`]), and one for any other.
pub(super) const SERIES: [RGBColor; 6] = [
    RGBColor(10, 11, 12),
    RGBColor(13, 14, 15),
    RGBColor(16, 17, 18),
    RGBColor(19, 20, 21),
    RGBColor(22, 23, 24),
    RGBColor(31, 32, 33),
];
pub(super) const ALARM: RGBColor = RGBColor(25, 26, 27);
pub(super) const PAPER: RGBColor = RGBColor(28, 29, 30);

/// Colour of a model by its name, the same in every figure.
pub(super) fn colour(name: &str) -> RGBColor {
    SERIES[match name {
        "nominal" => 0,
        "sphere" | "calibrated" => 1,
        "laser" => 2,
        "laser_full" => 3,
        "calibrated_table_only" => 4,
        _ => 5,
    }]
}

/// A number on an axis, without needless zeros.
pub(super) fn short(value: &f64) -> String {
    let text = format!("{value:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// Draws into an SVG of the given size and returns it in the page's colours.
pub(super) fn draw(
    size: (u32, u32),
    what: &str,
    paint: impl FnOnce(&DrawingArea<SVGBackend<'_>, Shift>) -> Result<(), Box<dyn std::error::Error>>,
) -> Result<String, ChartError> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        paint(&area)
            .and_then(|()| area.present().map_err(Into::into))
            .map_err(|e| ChartError {
                figure: what.to_owned(),
                message: e.to_string(),
            })?;
    }
    Ok(themed(&svg, size, what))
}

/// Replaces placeholder colours by CSS variables and the fixed size by a flexible one, and adds a
/// label for screen readers.
fn themed(svg: &str, (width, height): (u32, u32), what: &str) -> String {
    let start = svg.find("<svg").unwrap_or(0);
    let body = svg[start..].find('>').map_or("", |k| &svg[start + k + 1..]);
    let mut body = body.to_owned();
    for (RGBColor(r, g, b), name) in PALETTE {
        let hex = format!("#{r:02X}{g:02X}{b:02X}");
        for attribute in ["fill", "stroke"] {
            body = body.replace(
                &format!("{attribute}=\"{hex}\""),
                &format!("style=\"{attribute}:var({name})\""),
            );
        }
    }
    let mut out = String::with_capacity(body.len() + 200);
    let label = what.replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;");
    let _ = write!(
        out,
        "<svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{label}\" \
         xmlns=\"http://www.w3.org/2000/svg\">"
    );
    out.push_str(&body);
    out
}

/// A round step that divides `span` into about `parts`.
pub(super) fn round_step(span: f64, parts: f64) -> f64 {
    let raw = (span / parts).max(1e-12);
    let power = 10f64.powf(raw.log10().floor());
    let mantissa = raw / power;
    let nice = [1.0, 2.0, 2.5, 5.0, 10.0]
        .into_iter()
        .find(|m| mantissa <= *m)
        .unwrap_or(10.0);
    nice * power
}

pub(super) type Area<'a, 'b> = &'a DrawingArea<SVGBackend<'b>, Shift>;

/// A chart with axes in the house's style.
macro_rules! axes {
    ($area:expr, $x:expr, $y:expr, $xd:expr, $yd:expr) => {{
        let mut chart = ChartBuilder::on($area)
            .margin(12)
            .margin_right(18)
            .x_label_area_size(44)
            .y_label_area_size(58)
            .build_cartesian_2d($x, $y)?;
        chart
            .configure_mesh()
            .disable_x_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(FAINT)
            .axis_style(SOFT)
            .label_style(("sans-serif", 14, &SOFT))
            .axis_desc_style(("sans-serif", 15, &INK))
            .x_desc($xd)
            .y_desc($yd)
            .x_labels(8)
            .y_labels(6)
            .x_label_formatter(&short)
            .y_label_formatter(&short)
            .draw()?;
        chart
    }};
}

pub(super) use axes;

/// The legend, top right, on the page's own ground.
macro_rules! legend {
    ($chart:expr) => {
        $chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(PAPER.mix(0.85))
            .border_style(TRANSPARENT)
            .label_font(("sans-serif", 14, &INK))
            .margin(8)
            .draw()?
    };
}

pub(super) use legend;

/// What an axis shows, with the frame of the errors where it is known.
fn axis(what: &str, frame: &str) -> String {
    if frame.is_empty() {
        format!("{what} (mm)")
    } else {
        format!("{what}, {frame} (mm)")
    }
}

/// Histograms of several models over one axis (Figures 11 and 12); `frame` is that of the errors.
pub(super) fn histogram(series: &[&ErrorSeries], what: &str, frame: &str) -> Result<String, ChartError> {
    draw((760, 320), what, |area| {
        let largest = series
            .iter()
            .flat_map(|s| &s.errors_mm)
            .copied()
            .filter(|v| v.is_finite())
            .fold(1e-6, f64::max);
        let n = series.iter().map(|s| s.errors_mm.len()).max().unwrap_or(1) as f64;
        let step = round_step(largest, (2.0 * n.cbrt() * 2.0).clamp(10.0, 40.0));
        let bins = ((largest / step).floor() as usize + 1).min(400);
        let counts: Vec<Vec<usize>> = series
            .iter()
            .map(|s| {
                let mut count = vec![0; bins];
                for v in s.errors_mm.iter().filter(|v| v.is_finite()) {
                    if let Some(slot) = count.get_mut((v / step) as usize) {
                        *slot += 1;
                    }
                }
                count
            })
            .collect();
        // Room for the legend above the histograms.
        let room = 1.08 + 0.09 * series.len() as f64;
        let top = counts.iter().flatten().max().copied().unwrap_or(1).max(1) as f64 * room;
        let mut chart = axes!(
            area,
            0.0..step * bins as f64,
            0.0..top,
            axis("position error", frame),
            "configurations"
        );
        for (s, count) in series.iter().zip(&counts) {
            let c = colour(&s.name);
            chart.draw_series(count.iter().enumerate().filter(|(_, n)| **n > 0).map(|(i, n)| {
                let x = step * i as f64;
                Rectangle::new([(x, 0.0), (x + step, *n as f64)], c.mix(0.28).filled())
            }))?;
            let mut outline = vec![(0.0, 0.0)];
            for (i, n) in count.iter().enumerate() {
                outline.push((step * i as f64, *n as f64));
                outline.push((step * (i + 1) as f64, *n as f64));
            }
            outline.push((step * bins as f64, 0.0));
            chart
                .draw_series(LineSeries::new(outline, c.stroke_width(2)))?
                .label(model_title(&s.name))
                .legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 14, y + 5)], c.filled()));
        }
        legend!(chart);
        Ok(())
    })
}

/// When the force last rises through the threshold until the declaration, in s, between two
/// samples in proportion; none where no sample shows it.
pub(super) fn crossing(trace: &ContactTrace, threshold_n: f64) -> Option<f64> {
    let until = trace
        .samples
        .iter()
        .take_while(|s| s.0 <= trace.trigger_s + 1e-9)
        .count();
    // The sample after the declaration counts, too: telemetry may be slower than the controller.
    let seen = trace.samples.get(..(until + 1).min(trace.samples.len()))?;
    seen.windows(2).rev().find_map(|pair| {
        let ((t0, f0), (t1, f1)) = (pair[0], pair[1]);
        (f0 < threshold_n && f1 >= threshold_n).then(|| t0 + (t1 - t0) * (threshold_n - f0) / (f1 - f0))
    })
}

/// The force of one contact, its trigger and the force that declares contact (Figure 5); the axis reaches `peak_n` (N).
pub(super) fn force(
    trace: &ContactTrace,
    threshold_n: f64,
    peak_n: f64,
    size: (u32, u32),
) -> Result<String, ChartError> {
    draw(size, &format!("Force trace, sphere {}", trace.sphere), |area| {
        let (mut t0, mut t1, mut low, high) = (f64::INFINITY, f64::NEG_INFINITY, 0.0f64, peak_n.max(threshold_n));
        for &(t, f) in &trace.samples {
            (t0, t1) = (t0.min(t), t1.max(t));
            low = low.min(f);
        }
        if !(t1 > t0) {
            (t0, t1) = (0.0, 1.0);
        }
        let zero = trace.trigger_s;
        let pad = 0.08 * (high - low).max(1.0);
        let mut chart = axes!(
            area,
            (t0 - zero)..(t1 - zero),
            (low - pad)..(high + pad),
            if size.0 > 500 { "time from the trigger (s)" } else { "s" },
            if size.0 > 500 { "force (N)" } else { "N" }
        );
        chart.draw_series(DashedLineSeries::new(
            [(t0 - zero, threshold_n), (t1 - zero, threshold_n)],
            6,
            5,
            SOFT.stroke_width(1),
        ))?;
        chart.draw_series(LineSeries::new(
            trace.samples.iter().map(|&(t, f)| (t - zero, f)),
            SERIES[1].stroke_width(2),
        ))?;
        chart.draw_series(LineSeries::new(
            [(0.0, low - pad), (0.0, high + pad)],
            ALARM.stroke_width(1),
        ))?;
        if let Some(at) = crossing(trace, threshold_n) {
            chart.draw_series([Circle::new((at - zero, threshold_n), 5, ALARM.filled())])?;
        }
        Ok(())
    })
}

/// Residuals in the order of recording, by group, with outliers ringed.
pub(super) fn residuals(points: &[ResidualPoint]) -> Result<String, ChartError> {
    let mut groups: Vec<&str> = Vec::new();
    for p in points {
        if !groups.contains(&p.group.as_str()) {
            groups.push(&p.group);
        }
    }
    // Large outliers would compress all other points to the bottom, so they are drawn at the top
    // edge.
    let mut sorted: Vec<f64> = points.iter().map(|p| p.distance_mm).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let high = sorted
        .get(sorted.len().saturating_sub(1) * 98 / 100)
        .copied()
        .unwrap_or(1.0);
    let edge = sorted.last().copied().unwrap_or(1.0).min(2.5 * high).max(1e-6) * 1.05;
    let room = if groups.len() <= 12 {
        1.05 + 0.09 * groups.len() as f64
    } else {
        1.05
    };
    let top = edge * room;
    draw((760, 300), "Residual of every recording, by sphere", |area| {
        let mut chart = axes!(
            area,
            0.0..points.len().max(1) as f64,
            0.0..top,
            "recording, in the order of measurement",
            "residual (mm)"
        );
        for (k, group) in groups.iter().enumerate() {
            let c = SERIES[[1, 2, 0, 3, 4][k % 5]];
            let own = || points.iter().enumerate().filter(move |(_, p)| p.group == *group);
            let series = chart.draw_series(
                own().map(|(i, p)| Circle::new((i as f64 + 0.5, p.distance_mm.min(edge)), 3, c.mix(0.75).filled())),
            )?;
            if groups.len() <= 12 {
                series
                    .label((*group).to_owned())
                    .legend(move |(x, y)| Circle::new((x + 7, y), 4, c.filled()));
            }
            chart.draw_series(
                own()
                    .filter(|(_, p)| p.outlier)
                    .map(|(i, p)| Circle::new((i as f64 + 0.5, p.distance_mm.min(edge)), 7, ALARM.stroke_width(2))),
            )?;
        }
        if groups.len() <= 12 {
            legend!(chart);
        }
        Ok(())
    })
}

/// Predicted errors against errors found, with the lines of one and two sigma.
pub(super) fn prediction(p: &PredictedAccuracy) -> Result<String, ChartError> {
    draw(
        (760, 320),
        "Predicted and actual error of every validation sample",
        |area| {
            let x = p.pairs_mm.iter().map(|v| v.0).fold(1e-6, f64::max) * 1.08;
            let y = p.pairs_mm.iter().map(|v| v.1).fold(1e-6, f64::max).max(x) * 1.08;
            let mut chart = axes!(
                area,
                0.0..x,
                0.0..y,
                "predicted error, 1 sigma (mm)",
                axis("found error", &p.axis)
            );
            for (factor, name, weight) in [(1.0, "1 sigma", 0.9), (2.0, "2 sigma", 0.5)] {
                let end = x.min(y / factor);
                chart
                    .draw_series(LineSeries::new(
                        [(0.0, 0.0), (end, factor * end)],
                        SOFT.mix(weight).stroke_width(2),
                    ))?
                    .label(name)
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 14, y)], SOFT.mix(weight).stroke_width(2)));
            }
            chart.draw_series(
                p.pairs_mm
                    .iter()
                    .map(|&(a, b)| Circle::new((a, b), 3, SERIES[1].mix(0.7).filled())),
            )?;
            legend!(chart);
            Ok(())
        },
    )
}
