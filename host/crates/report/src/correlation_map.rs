//! Correlations of the parameters as a map with its colour scale.

use plotters::prelude::*;

use super::charts::{ALARM, Area, ChartError, FAINT, INK, SERIES, SOFT, draw};
use super::input::Correlation;

/// Room beside the map for its scale, in pixels.
const SCALE: i32 = 96;
const PARTS: i32 = 20;

/// Colour and strength of a correlation.
fn tint(value: f64) -> (RGBColor, f64) {
    let colour = if value >= 0.0 { ALARM } else { SERIES[1] };
    (colour, value.abs().min(1.0).powf(1.3))
}

/// Correlations as a map: red positive, blue negative, by strength.
pub(super) fn correlation(c: &Correlation) -> Result<String, ChartError> {
    let n = c.names.len();
    let cell = if n > 36 { 15 } else { 19 };
    let side = 92;
    let size = (side + cell * n as i32 + SCALE, side + cell * n as i32 + 12);
    draw(
        (size.0.max(1) as u32, size.1.max(1) as u32),
        "Correlation of the parameters",
        |area| {
            label_names(area, c, cell, side)?;
            for (i, row) in c.values.iter().enumerate() {
                for (j, &value) in row.iter().enumerate() {
                    if !value.is_finite() {
                        continue;
                    }
                    let (x, y) = (side + cell * j as i32, side + cell * i as i32);
                    let (colour, strength) = tint(value);
                    let strength = if i == j { 0.12 } else { strength };
                    area.draw(&Rectangle::new(
                        [(x, y), (x + cell - 1, y + cell - 1)],
                        colour.mix(strength).filled(),
                    ))?;
                }
            }
            area.draw(&Rectangle::new(
                [(side - 1, side - 1), (side + cell * n as i32, side + cell * n as i32)],
                FAINT.stroke_width(1),
            ))?;
            scale(area, side, side + cell * n as i32)
        },
    )
}

/// The colours with their values, right of the map. A correlation has no unit.
fn scale(area: Area<'_, '_>, top: i32, right: i32) -> Result<(), Box<dyn std::error::Error>> {
    let left = right + 18;
    let height = 8;
    for k in 0..=PARTS {
        let (colour, strength) = tint(1.0 - 2.0 * f64::from(k) / f64::from(PARTS));
        area.draw(&Rectangle::new(
            [(left, top + height * k), (left + 14, top + height * (k + 1))],
            colour.mix(strength).filled(),
        ))?;
    }
    area.draw(&Rectangle::new(
        [(left, top), (left + 14, top + height * (PARTS + 1))],
        FAINT.stroke_width(1),
    ))?;
    let words = |text: &str, y: i32| {
        area.draw(&Text::new(
            text.to_owned(),
            (left + 20, y),
            ("sans-serif", 12).into_font().color(&SOFT),
        ))
    };
    words("1", top)?;
    words("0", top + height * PARTS / 2)?;
    words("-1", top + height * PARTS)?;
    area.draw(&Text::new(
        "correlation",
        (left - 6, top - 20),
        ("sans-serif", 12).into_font().color(&INK),
    ))?;
    Ok(())
}

/// Names along both sides of a map.
fn label_names(area: Area<'_, '_>, c: &Correlation, cell: i32, side: i32) -> Result<(), Box<dyn std::error::Error>> {
    use plotters::style::text_anchor::{HPos, Pos, VPos};
    let row = TextStyle::from(("sans-serif", 11).into_font())
        .color(&INK)
        .pos(Pos::new(HPos::Right, VPos::Center));
    let column = TextStyle::from(("sans-serif", 11).into_font().transform(FontTransform::Rotate270))
        .color(&INK)
        .pos(Pos::new(HPos::Left, VPos::Center));
    for (k, name) in c.names.iter().enumerate() {
        let at = side + cell * k as i32 + cell / 2;
        area.draw(&Text::new(name.clone(), (side - 6, at), row.clone()))?;
        area.draw(&Text::new(name.clone(), (at, side - 6), column.clone()))?;
    }
    Ok(())
}
