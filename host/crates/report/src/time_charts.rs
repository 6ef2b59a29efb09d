//! Figures of contacts and over time: histograms of the trigger, curves of a hold.

use plotters::prelude::*;

use super::charts::{ChartError, FAINT, INK, PAPER, SERIES, SOFT, axes, draw, legend, round_step, short};
use super::headline::first_upper;
use super::input::{Curves, HistogramChart};

/// The finite values of a histogram with their smallest and largest.
fn range(histogram: &HistogramChart) -> (Vec<f64>, f64, f64) {
    let values: Vec<f64> = histogram.values.iter().copied().filter(|v| v.is_finite()).collect();
    let (low, high) = values
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    let (low, high) = if low <= high { (low, high) } else { (0.0, 1.0) };
    (values, low, high)
}

/// What a histogram would say with a single bar: all values within one step are the same.
pub(super) fn single_value(histogram: &HistogramChart) -> Option<String> {
    let (values, low, high) = range(histogram);
    let step = histogram.step.max(1e-3 * high.abs());
    (!values.is_empty() && high - low < step).then(|| {
        let what = first_upper(&histogram.what);
        format!("{what}: {} in all {} {}.", short(&low), values.len(), histogram.of)
    })
}

pub(super) fn histogram(histogram: &HistogramChart) -> Result<String, ChartError> {
    let (values, low, high) = range(histogram);
    let parts = (2.0 * (values.len() as f64).cbrt() * 2.0).clamp(8.0, 30.0);
    let step = round_step((high - low).max(1e-3 * high.abs().max(1.0)), parts).max(histogram.step);
    // Bars of counted values stand about their value.
    let first = if step > histogram.step {
        (low / step).floor() * step
    } else {
        low - 0.5 * step
    };
    let bins = (((high - first) / step).floor() as usize + 1).min(200);
    let mut counts = vec![0u32; bins];
    for value in &values {
        if let Some(slot) = counts.get_mut(((value - first) / step) as usize) {
            *slot += 1;
        }
    }
    let top = f64::from(counts.iter().max().copied().unwrap_or(1).max(1)) * 1.1;
    draw((760, 240), &histogram.what, |area| {
        let mut chart = axes!(
            area,
            (first - step)..(first + step * (bins + 1) as f64),
            0.0..top,
            histogram.what.as_str(),
            histogram.of.as_str()
        );
        chart.draw_series(counts.iter().enumerate().filter(|(_, n)| **n > 0).map(|(i, n)| {
            let x = first + step * i as f64;
            Rectangle::new([(x, 0.0), (x + step, f64::from(*n))], SERIES[1].mix(0.6).filled())
        }))?;
        Ok(())
    })
}

/// Curves over time, with a band about zero.
pub(super) fn curves(input: &Curves) -> Result<String, ChartError> {
    let points = || input.curves.iter().flat_map(|c| &c.1).filter(|p| p.1.is_finite());
    let end = points().map(|p| p.0).fold(1e-3, f64::max);
    let low = points().map(|p| p.1).fold(-input.band, f64::min);
    let high = points().map(|p| p.1).fold(input.band, f64::max);
    let pad = 0.08 * (high - low).max(1e-6);
    let room = 0.09 * input.curves.len().min(8) as f64 * (high - low).max(1e-6);
    draw((760, 320), &input.what, |area| {
        let mut chart = axes!(
            area,
            0.0..end,
            (low - pad)..(high + pad + room),
            "time (s)",
            input.what.as_str()
        );
        if input.band > 0.0 {
            chart.draw_series([Rectangle::new(
                [(0.0, -input.band), (end, input.band)],
                FAINT.mix(0.6).filled(),
            )])?;
        }
        for (k, (name, points)) in input.curves.iter().enumerate() {
            let c = SERIES[[1, 2, 0, 3, 4][k % 5]];
            let series = chart.draw_series(LineSeries::new(
                points.iter().copied().filter(|p| p.1.is_finite()),
                c.stroke_width(2),
            ))?;
            if input.curves.len() <= 8 {
                series
                    .label(name.clone())
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 14, y)], c.stroke_width(2)));
            }
        }
        if !input.curves.is_empty() && input.curves.len() <= 8 {
            legend!(chart);
        }
        Ok(())
    })
}
