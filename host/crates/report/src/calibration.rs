//! The parts of every report about a calibration: its parameters, what the data determine, and the
//! fit by group.

use spherecal_identify::{Calibration, GroupFit, Reference, Unit};

use super::input::{Correlation, ParameterRow, SimpleTable};

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
