//! The hypotheses: each a correction, what would be wrong in words, and the options that correct it.

use std::f64::consts::{FRAC_PI_2, PI};

use spherecal_model::input::Adjustments;

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Change {
    /// The table.
    Table(Adjustments),
    /// The TCP: it is fitted freely.
    Tool,
    /// The robot: a built-in one.
    Robot(&'static str),
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Hypothesis {
    pub(crate) words: String,
    pub(crate) change: Change,
}

/// One degree, in rad.
const DEGREE: f64 = PI / 180.0;

/// Factors of points, and what the table would hold then.
const POINTS: [(f64, &str); 6] = [
    (25.4, "the points are in inches, not in mm"),
    (0.0254, "the points are in inches, not in m"),
    (1e3, "the points are in m, not in mm"),
    (1e-3, "the points are in mm, not in m"),
    (10.0, "the points are in cm, not in mm"),
    (0.01, "the points are in cm, not in m"),
];

/// Single hypotheses on the joint columns of an arm with `n` joints.
fn of_joints(n: usize) -> Vec<(String, Adjustments)> {
    let plain = Adjustments::default;
    let mut out = Vec::new();
    for k in 0..n {
        let joint = k + 1;
        out.push((
            format!("joint {joint} counts the other way"),
            Adjustments {
                flips: vec![k],
                ..plain()
            },
        ));
        for (angle, words) in [(FRAC_PI_2, "90"), (-FRAC_PI_2, "-90"), (PI, "180")] {
            out.push((
                format!("the zero of joint {joint} is {words} degrees away"),
                Adjustments {
                    zeros: vec![(k, angle)],
                    ..plain()
                },
            ));
        }
        for (factor, is, not) in [(DEGREE, "degrees", "rad"), (1.0 / DEGREE, "rad", "degrees")] {
            let units = (0..n).map(|j| if j == k { factor } else { 1.0 }).collect();
            out.push((
                format!("the column of joint {joint} is in {is}, not in {not}"),
                Adjustments { units, ..plain() },
            ));
        }
        for other in k + 1..n {
            let mut order: Vec<usize> = (0..n).collect();
            order.swap(k, other);
            out.push((
                format!("the columns of joints {joint} and {} are swapped", other + 1),
                Adjustments { order, ..plain() },
            ));
        }
        if k > 0 {
            for (factor, sign) in [(1.0, '+'), (-1.0, '-')] {
                out.push((
                    format!("joint {joint} is coupled: it stands at q{joint} {sign} q{k}"),
                    Adjustments {
                        couples: vec![(k, vec![(k, 1.0), (k - 1, factor)])],
                        ..plain()
                    },
                ));
            }
        }
    }
    if n > 2 {
        out.push((
            "the joint columns stand in reverse order".to_owned(),
            Adjustments {
                order: (0..n).rev().collect(),
                ..plain()
            },
        ));
        out.push((
            "all joints count the other way".to_owned(),
            Adjustments {
                flips: (0..n).collect(),
                ..plain()
            },
        ));
    }
    out
}

/// The hypothesis of a stream whose measurements lag behind by so many rows.
pub(crate) fn delay(rows: f64) -> Hypothesis {
    Hypothesis {
        words: format!(
            "the arm moved while it was measured, and the measurements are {:.3} rows {} for their joint angles",
            rows.abs(),
            if rows > 0.0 { "late" } else { "early" }
        ),
        change: Change::Table(Adjustments {
            shift: rows,
            ..Adjustments::default()
        }),
    }
}

/// All single hypotheses. `points` are measured in an instrument's frame, `poses` have orientations.
pub(crate) fn singles(n: usize, points: bool, poses: bool, tool: bool, robots: &[&'static str]) -> Vec<Hypothesis> {
    let plain = Adjustments::default;
    let mut tables = of_joints(n);
    if points {
        for (point_factor, words) in POINTS {
            tables.push((
                words.to_owned(),
                Adjustments {
                    point_factor,
                    ..plain()
                },
            ));
        }
        tables.push((
            "the points are in a left-handed (mirrored) frame".to_owned(),
            Adjustments {
                mirror: true,
                ..plain()
            },
        ));
    }
    if poses {
        tables.push((
            "the poses are inverted: the instrument as the tool sees it".to_owned(),
            Adjustments {
                invert: true,
                ..plain()
            },
        ));
    }
    for (shift, words) in [(1.0, "a row late"), (-1.0, "a row early")] {
        tables.push((
            format!("the measurements stand {words} beside their joint angles"),
            Adjustments { shift, ..plain() },
        ));
    }
    let mut out: Vec<Hypothesis> = tables
        .into_iter()
        .map(|(words, adjust)| Hypothesis {
            words,
            change: Change::Table(adjust),
        })
        .collect();
    if tool {
        out.push(Hypothesis {
            words: String::new(),
            change: Change::Tool,
        });
    }
    out.extend(robots.iter().map(|name| Hypothesis {
        words: format!("these are data of the built-in {name}"),
        change: Change::Robot(name),
    }));
    out
}

/// Whether two corrections say something of the same thing, so that both together mean nothing of their own.
fn overlap(a: &Adjustments, b: &Adjustments) -> bool {
    let same = |k: usize, adjust: &Adjustments| {
        adjust.flips.contains(&k) || adjust.zeros.iter().any(|z| z.0 == k) && adjust.flips.is_empty()
    };
    let zeros = |x: &Adjustments, y: &Adjustments| x.zeros.iter().any(|z| y.zeros.iter().any(|w| w.0 == z.0));
    (!a.order.is_empty() && !b.order.is_empty())
        || (!a.units.is_empty() && !b.units.is_empty())
        || a.flips.iter().any(|k| same(*k, b) && b.zeros.is_empty())
        || zeros(a, b)
        || a.couples.iter().any(|c| b.couples.iter().any(|d| d.0 == c.0))
        || (a.point_factor != 1.0 && b.point_factor != 1.0)
        || (a.shift != 0.0 && b.shift != 0.0)
}

/// Pairs of single hypotheses on the table.
pub(crate) fn pairs(singles: &[Hypothesis]) -> Vec<Hypothesis> {
    let tables: Vec<(&str, &Adjustments)> = singles
        .iter()
        .filter_map(|h| match &h.change {
            Change::Table(adjust) => Some((h.words.as_str(), adjust)),
            _ => None,
        })
        .collect();
    let mut out = Vec::new();
    for (k, (words, adjust)) in tables.iter().enumerate() {
        for (more, other) in &tables[k + 1..] {
            // Two units at once are rare, and many.
            let units = !adjust.units.is_empty() || !other.units.is_empty();
            if units || overlap(adjust, other) {
                continue;
            }
            out.push(Hypothesis {
                words: format!("{words}, and {more}"),
                change: Change::Table(adjust.and(other)),
            });
        }
    }
    out
}
