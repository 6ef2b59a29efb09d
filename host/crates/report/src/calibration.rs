//! The parts of every report about a calibration: its parameters, what the data determine, and the
//! fit by group and by row.

use std::collections::HashSet;

use spherecal_identify::{Calibration, Evaluation, GroupFit, Recordings, Reference, ResidualRow, Target, Unit};

use super::input::{Correlation, ParameterRow, ResidualPoint, SimpleTable};
use super::judged::thinned;

/// Most outliers of a kind in the table.
const LISTED: usize = 200;

/// Parameters of a correlation map at most.
const MAP: usize = 45;

/// The rows of Table 6: lengths in mm, the rest in SI.
pub fn parameter_rows(calibration: &Calibration) -> Vec<ParameterRow> {
    calibration
        .parameters
        .iter()
        .map(|p| {
            let (scale, unit) = match p.unit {
                Unit::Metre => (1e3, "mm"),
                other => (1.0, other.symbol()),
            };
            ParameterRow {
                name: p.name.clone(),
                unit: unit.to_owned(),
                nominal: p.nominal * scale,
                estimate: p.estimate * scale,
                sigma: p.sigma * scale,
                prior_sigma: p.prior_sigma * scale,
                free: p.free,
                identified: p.identified,
            }
        })
        .collect()
}

/// Correlations of the parameters of links, tool and compliance, without effects and frames.
pub fn correlation(calibration: &Calibration) -> Option<Correlation> {
    let all = calibration.correlation();
    let names = calibration.free_names();
    let wanted = |n: &str| {
        ["alpha", "a", "d", "beta", "theta", "tool", "compliance"]
            .iter()
            .any(|k| {
                n.strip_prefix(k)
                    .is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_digit() || c == '_'))
            })
    };
    let picked: Vec<usize> = (0..names.len()).filter(|&k| wanted(names[k])).take(MAP).collect();
    (picked.len() > 1 && all.nrows() == names.len()).then(|| Correlation {
        names: picked.iter().map(|&k| names[k].to_owned()).collect(),
        values: picked
            .iter()
            .map(|&i| picked.iter().map(|&j| all[(i, j)]).collect())
            .collect(),
    })
}

/// What the data could determine, in sentences.
pub fn identifiability_words(calibration: &Calibration) -> Vec<String> {
    let i = &calibration.identifiability;
    let mut words = vec![format!(
        "The geometric columns have rank {} of {}; condition number {:.0} (mm and mrad).",
        i.rank, i.columns, i.condition
    )];
    words.extend(i.dependencies.iter().map(|d| format!("{d}.")));
    words
}

/// Goodness of fit by group.
pub fn group_table(groups: &[GroupFit], place: impl Fn(u32) -> String) -> SimpleTable {
    SimpleTable {
        title: "Goodness of fit".to_owned(),
        caption: "Chi-square per degree of freedom is about 1 where the model explains a group as well as the others."
            .to_owned(),
        columns: ["group", "recordings", "rms (mm)", "chi-square per freedom"]
            .map(str::to_owned)
            .to_vec(),
        rows: groups
            .iter()
            .map(|g| {
                vec![
                    group_name(g, &place),
                    g.count.to_string(),
                    format!("{:.3}", g.rms_mm),
                    format!("{:.2}", g.per_freedom),
                ]
            })
            .collect(),
    }
}

fn group_name(g: &GroupFit, place: impl Fn(u32) -> String) -> String {
    let mut sphere = g.sphere.map_or(String::new(), |s| format!("sphere {s}"));
    if let Some(seat) = g.seat {
        sphere += &format!(", seat {seat}");
    }
    match g.reference {
        Reference::Tracker => "tracker".to_owned(),
        Reference::Place(p) => match place(p) {
            name if name.is_empty() => sphere,
            name => format!("{sphere}, {name}"),
        },
    }
}

/// The residuals of the rows that the fit used, for the figure by row.
pub fn residual_points(evaluation: &Evaluation, recordings: &Recordings) -> Vec<ResidualPoint> {
    let residual = &evaluation.calibration.residual;
    let named: HashSet<usize> = residual.outliers.iter().map(|o| o.index).collect();
    let point = |r: &ResidualRow| {
        let observation = recordings.experiment.observations.get(*evaluation.used.get(r.index)?)?;
        let group = match observation.target {
            Target::Sphere { sphere, place } => match recordings.places.name(place) {
                "" => format!("sphere {sphere}"),
                place => format!("sphere {sphere}, {place}"),
            },
            _ => "tracker".to_owned(),
        };
        Some(ResidualPoint {
            group,
            distance_mm: r.error_mm.iter().map(|e| e * e).sum::<f64>().sqrt(),
            outlier: named.contains(&r.index),
        })
    };
    thinned(&residual.rows).into_iter().filter_map(point).collect()
}

/// The outliers by the names that remarks have for them: those that were left out, then those that hardly count.
pub fn outliers(evaluation: &Evaluation, recordings: &Recordings) -> Vec<(String, String)> {
    let left_out = evaluation.rejected.iter().map(|(i, mm)| {
        let why = format!("left out: {mm:.1} mm from where any calibration could bring it");
        (recordings.describe(*i), why)
    });
    let found = &evaluation.calibration.residual.outliers;
    let doubted = found.iter().filter_map(|o| {
        let row = recordings.describe(*evaluation.used.get(o.index)?);
        Some((row, o.why.clone()))
    });
    let mut listed: Vec<(String, String)> = left_out.take(LISTED).chain(doubted.take(LISTED)).collect();
    for count in [evaluation.rejected.len(), found.len()] {
        if let Some(more) = count.checked_sub(LISTED).filter(|more| *more > 0) {
            listed.push((format!("and {more} more"), "listed up to 200 of each kind".to_owned()));
        }
    }
    listed
}
