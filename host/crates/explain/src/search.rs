//! The search: screens all hypotheses with few rows, and judges the best with more.

use nalgebra::Vector3;
use spherecal_model::input::Adjustments;
use spherecal_model::robots::{JointPath, built_in};
use spherecal_model::statistics::median;
use spherecal_shared::robot::BUILT_IN;

use crate::fit::{Effort, Fitted, fit};
use crate::hypotheses::{Change, Hypothesis, pairs, singles};
use crate::rows::{Row, adjusted, rows, some};
use crate::{CLEAR, Explanation, Finding, GOOD_M, READOUT_M, STILL_RAD, Subject, TIE};

/// Fewest rows that are searched.
const FEWEST: usize = 10;
/// Rows of the first screening, of the second, and of the judgement.
const ROWS: [usize; 3] = [24, 48, 200];
/// Hypotheses that come through the screening of singles and of pairs.
const THROUGH: [usize; 2] = [10, 24];
/// Standard deviation of a TCP that the user gave, in m.
const TOOL_M: f64 = 0.02;
/// That of a TCP that nobody gave, in m.
const FREE_TOOL_M: f64 = 0.3;

/// Largest step of a joint (rad) between rows that follow each other in a stream: at 0.5 m from the axis 50 mm.
const STREAM_RAD: f64 = 0.1;
/// Delays that are tried first, in rows: at 1 kHz up to 0.1 s, at 10 Hz from 30 ms.
const DELAYS: [f64; 6] = [0.3, 1.0, 3.0, 10.0, 30.0, 100.0];
/// Width in which a delay is found, in rows: at [`STREAM_RAD`] per row 1 mrad.
const DELAY_ROWS: f64 = 0.01;

/// A subject with all that a fit needs.
struct Search<'a> {
    subject: &'a Subject<'a>,
    rows: Vec<Row>,
    given_tool: bool,
    robots: Vec<(&'static str, JointPath)>,
}

struct Scored {
    hypothesis: Hypothesis,
    fitted: Fitted,
}

impl Search<'_> {
    /// Fits a hypothesis to at most `most` rows.
    fn fit(&self, change: &Change, most: usize, origins: bool, iterations: usize) -> Fitted {
        let nothing = Adjustments::default();
        let (adjust, path, given) = match change {
            Change::Table(adjust) => (adjust, &self.subject.path, self.given_tool),
            Change::Tool => (&nothing, &self.subject.path, false),
            Change::Robot(name) => {
                let known = self.robots.iter().find(|r| r.0 == *name);
                (&nothing, known.map_or(&self.subject.path, |r| &r.1), self.given_tool)
            }
        };
        let rows = adjusted(&self.rows, adjust, most);
        let effort = Effort {
            offsets: true,
            origins,
            tool_m: if given { TOOL_M } else { FREE_TOOL_M },
            iterations,
        };
        let mut fitted = fit(path, &self.subject.tool, &rows, effort);
        // Many rows outweigh the prior: a TCP far from the given one is no fit of the given one.
        let moved = (fitted.tool - self.subject.tool).norm();
        if given && moved > 3.0 * TOOL_M {
            fitted.median_m = fitted.median_m.max(moved);
        }
        fitted
    }

    /// The best hypotheses, screened with few rows and fitted with more.
    fn judged(&self, mut all: Vec<Hypothesis>, screens: &[(usize, usize, usize)]) -> Vec<Scored> {
        for &(most, iterations, through) in screens {
            let mut scored: Vec<(f64, Hypothesis)> = all
                .into_iter()
                .map(|h| (self.fit(&h.change, most, false, iterations).median_m, h))
                .collect();
            scored.sort_by(|a, b| a.0.total_cmp(&b.0));
            scored.truncate(through);
            all = scored.into_iter().map(|s| s.1).collect();
        }
        let mut out: Vec<Scored> = all
            .into_iter()
            .map(|hypothesis| Scored {
                fitted: self.fit(&hypothesis.change, ROWS[2], true, 30),
                hypothesis,
            })
            .collect();
        out.sort_by(|a, b| a.fitted.median_m.total_cmp(&b.fitted.median_m));
        out
    }

    /// The hypotheses that win clearly over a score of the table as it is.
    fn winners(&self, own_m: f64, scored: Vec<Scored>) -> Vec<Finding> {
        let best = scored.first().map_or(f64::INFINITY, |s| s.fitted.median_m);
        if !(best < CLEAR * own_m && best < GOOD_M) {
            return Vec::new();
        }
        let near = |s: &Scored| s.fitted.median_m <= TIE * best;
        scored.into_iter().filter(near).map(|s| self.finding(s)).collect()
    }

    fn finding(&self, scored: Scored) -> Finding {
        let Scored { hypothesis, fitted } = scored;
        let score_m = fitted.median_m;
        let nothing = Adjustments::default();
        match hypothesis.change {
            Change::Table(adjust) => Finding {
                words: hypothesis.words,
                options: adjust.options(),
                adjust,
                tool: None,
                robot: None,
                score_m,
            },
            Change::Tool => {
                let (words, options) = crate::words::tool(&self.subject.tool, &fitted.tool);
                Finding {
                    words,
                    options,
                    adjust: nothing,
                    tool: Some(fitted.tool.into()),
                    robot: None,
                    score_m,
                }
            }
            Change::Robot(name) => Finding {
                words: hypothesis.words,
                options: format!("--robot {name}"),
                adjust: nothing,
                tool: None,
                robot: Some(name),
                score_m,
            },
        }
    }
}

/// Joints that hardly move.
fn still(rows: &[Row]) -> Vec<(usize, f64)> {
    let n = rows.first().map_or(0, |r| r.q.len());
    let range = |k: usize| {
        let values = || rows.iter().filter_map(move |r| r.q.get(k)).copied();
        values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
    };
    (0..n).map(|k| (k, range(k))).filter(|r| r.1 < STILL_RAD).collect()
}

/// Whether the rows follow each other in small steps: an arm that was recorded while it moved.
fn is_stream(rows: &[Row]) -> bool {
    let step = |pair: &[Row]| match pair {
        [a, b] => a.q.iter().zip(&b.q).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max),
        _ => 0.0,
    };
    let steps: Vec<f64> = rows.windows(2).map(step).collect();
    rows.len() >= ROWS[1] && median(steps) < STREAM_RAD
}

/// What needs no search: a controller's readout, joints that hardly move, and the delay of a stream. `None` in place of a search
/// for too few rows.
fn looked_at<'a>(subject: &'a Subject<'a>) -> (Explanation, Option<Search<'a>>) {
    let rows = rows(subject.observations, subject.spheres);
    let n = subject.path.columns.len();
    let mut out = Explanation {
        own_m: f64::NAN,
        readout: false,
        found: Vec::new(),
        tried: 0,
        still: still(&rows),
    };
    if rows.len() < FEWEST || rows.iter().any(|r| r.q.len() != n) {
        return (out, None);
    }
    let search = Search {
        subject,
        given_tool: subject.tool.norm() > 1e-6,
        robots: Vec::new(),
        rows,
    };
    // Distances between spheres say nothing of where the numbers come from.
    out.readout = search.measures_points() && search.is_readout();
    if is_stream(&search.rows) && search.measures_points() {
        out.own_m = search
            .fit(&Change::Table(Adjustments::default()), ROWS[2], true, 30)
            .median_m;
        let delays = search.delay().map(crate::hypotheses::delay);
        let scored = search.judged(delays.into_iter().collect(), &[]);
        out.found = search.winners(out.own_m, scored);
    }
    (out, Some(search))
}

/// What needs no search.
pub(crate) fn look(subject: &Subject<'_>) -> Explanation {
    looked_at(subject).0
}

pub(crate) fn search(subject: &Subject<'_>) -> Explanation {
    let (mut out, Some(mut search)) = looked_at(subject) else {
        return look(subject);
    };
    let n = subject.path.columns.len();
    let others = BUILT_IN.iter().copied().filter(|name| *name != subject.robot);
    let others = others.filter_map(|name| Some((name, built_in(name)?.table_path())));
    search.robots = others.filter(|r| r.1.columns.len() == n).collect();
    let nothing = Change::Table(Adjustments::default());
    if !out.own_m.is_finite() {
        out.own_m = search.fit(&nothing, ROWS[2], true, 30).median_m;
    }
    let points = search.measures_points();
    let poses = search.rows.iter().any(|r| r.turn.is_some());
    let names: Vec<&'static str> = search.robots.iter().map(|r| r.0).collect();
    let mut singles = singles(n, points, poses, search.given_tool, &names);
    singles.extend(
        out.found
            .iter()
            .map(|found| crate::hypotheses::delay(found.adjust.shift)),
    );
    out.tried = singles.len();
    let scored = search.judged(singles.clone(), &[(ROWS[1], 8, THROUGH[0])]);
    let best = scored.first().map_or(f64::INFINITY, |s| s.fitted.median_m);
    out.found = search.winners(out.own_m, scored);
    // A table that fits better than any pair could show is left alone.
    if out.found.is_empty() && out.own_m.min(best) > GOOD_M * CLEAR {
        let pairs = pairs(&singles);
        out.tried += pairs.len();
        let scored = search.judged(pairs, &[(ROWS[0], 3, 4 * THROUGH[1]), (ROWS[1], 8, THROUGH[1] / 2)]);
        out.found = search.winners(out.own_m, scored);
    }
    out
}

impl Search<'_> {
    /// Whether an instrument measured points: not contacts with spheres alone.
    fn measures_points(&self) -> bool {
        let contact = |o: &spherecal_model::Observation| matches!(o.target, spherecal_model::Target::Sphere { .. });
        !self.subject.observations.iter().all(contact)
    }

    /// The delay (in rows) with which the rows of a stream fit best, between those of [`DELAYS`]: the score falls towards it
    /// from both sides. `None` where it is that of the table as it is.
    fn delay(&self) -> Option<f64> {
        let most = self.rows.len() as f64 / 4.0;
        let score = |shift: f64| {
            let adjust = Adjustments {
                shift,
                ..Adjustments::default()
            };
            self.fit(&Change::Table(adjust), ROWS[1], false, 8).median_m
        };
        let both = DELAYS.iter().rev().map(|d| -d).chain([0.0]).chain(DELAYS);
        let tried: Vec<f64> = both.filter(|d| d.abs() < most).collect();
        let scores: Vec<f64> = tried.iter().map(|d| score(*d)).collect();
        let best = (0..tried.len()).min_by(|a, b| scores[*a].total_cmp(&scores[*b]))?;
        let (mut low, mut high) = (*tried.get(best.checked_sub(1)?)?, *tried.get(best + 1)?);
        while high - low > DELAY_ROWS {
            let (a, b) = (low + 0.382 * (high - low), low + 0.618 * (high - low));
            if score(a) < score(b) {
                high = b;
            } else {
                low = a;
            }
        }
        let found = (0.5 * (low + high) / DELAY_ROWS).round() * DELAY_ROWS;
        (found != 0.0).then_some(found)
    }

    /// Whether the targets are the nominal model's own: only base and TCP are fitted.
    fn is_readout(&self) -> bool {
        let rows = some(&self.rows, ROWS[2]);
        let effort = Effort {
            offsets: false,
            origins: false,
            tool_m: FREE_TOOL_M,
            iterations: 20,
        };
        let tool: Vector3<f64> = self.subject.tool;
        fit(&self.subject.path, &tool, &rows, effort).median_m < READOUT_M
    }
}
