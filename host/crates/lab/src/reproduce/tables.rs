//! The paper's tables, with the published numbers beside ours.

use std::fmt;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use spherecal_shared::robot::Tool;

use super::Reproduction;
use super::published::{TABLE_1_MM, TABLE_2_REDUNDANT, TABLE_3_MM, TABLE_4_MM, TABLE_5_MM, TABLE_6};
use crate::Estimator;
use spherecal_identify::algorithm1::{Columns, Scaling, position_jacobian, reduce};
use spherecal_identify::validate::{Alignment, ValidationTable};
use spherecal_identify::{Calibration, Experiment, Target, halton_configurations};
use spherecal_plan::laser::Spread;

/// One number, published and ours.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ComparedNumber {
    /// The published value; `None` if the paper has none.
    pub published: Option<f64>,
    /// From these recordings.
    pub ours: f64,
}

/// A table of the paper.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PaperTable {
    /// Its number in the paper.
    pub number: u32,
    /// What it shows.
    pub title: String,
    /// Headings of the columns.
    pub columns: Vec<String>,
    /// Rows: a name, and a number for each column.
    pub rows: Vec<(String, Vec<ComparedNumber>)>,
    /// Decimals to print.
    pub decimals: usize,
    /// What to know when reading it.
    pub note: String,
}

impl fmt::Display for PaperTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let decimals = self.decimals;
        writeln!(f, "Table {}. {} (published | ours)", self.number, self.title)?;
        if !self.rows.is_empty() {
            let wide = decimals + 5;
            write!(f, "{:16}", "")?;
            for column in &self.columns {
                write!(f, "  {column:^width$}", width = 2 * wide + 3)?;
            }
            writeln!(f)?;
            for (name, sides) in &self.rows {
                write!(f, "{name:16}")?;
                for side in sides {
                    let published = side.published.map_or("-".to_owned(), |p| format!("{p:.decimals$}"));
                    write!(f, "  {published:>wide$} | {:>wide$.decimals$}", side.ours)?;
                }
                writeln!(f)?;
            }
        }
        if !self.note.is_empty() {
            writeln!(f, "{}", self.note)?;
        }
        Ok(())
    }
}

/// The paper's redundancy analysis, and how the real tool changes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Redundancy {
    /// Rank of 24 link columns with the TCP on the flange axis.
    pub rank_on_axis: usize,
    /// Columns.
    pub columns: usize,
    /// What the deterministic form of Algorithm 1 removes with the TCP on the axis.
    pub removed_on_axis: Vec<String>,
    /// Names that are left.
    pub kept: Vec<String>,
    /// Condition number of what is left, lengths in mm.
    pub condition: f64,
    /// Rank with the tool as it is.
    pub rank_with_tool: usize,
    /// What it removes with the tool as it is.
    pub removed_with_tool: Vec<String>,
}

impl fmt::Display for Redundancy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "Redundancy (Algorithm 1, 29 configurations): TCP on the flange axis: rank {} of {}, removed {} \
             (published: {}), condition {:.1}. With the tool as it is: rank {} of {}, removed {}.",
            self.rank_on_axis,
            self.columns,
            listed(&self.removed_on_axis),
            TABLE_2_REDUNDANT.join(", "),
            self.condition,
            self.rank_with_tool,
            self.columns,
            listed(&self.removed_with_tool),
        )
    }
}

fn listed(names: &[String]) -> String {
    if names.is_empty() {
        "none".to_owned()
    } else {
        names.join(", ")
    }
}

/// The analysis of Section 3.1 on the nominal robot.
pub(super) fn redundancy(experiment: &Experiment) -> Redundancy {
    let draws = halton_configurations(&experiment.robot, 29);
    let links = Columns {
        first_row: false,
        tool: false,
        base: false,
    };
    let on_axis = Tool {
        tcp_m: [0.0; 3],
        ..experiment.tool
    };
    let of = |tool: &Tool| {
        let jacobian = position_jacobian(&experiment.robot, tool, &draws, links);
        reduce(&jacobian, Scaling::Millimetre)
    };
    let (flange, eccentric) = (of(&on_axis), of(&experiment.tool));
    Redundancy {
        rank_on_axis: flange.rank,
        columns: flange.columns,
        removed_on_axis: flange.removed,
        kept: flange.kept,
        condition: flange.condition,
        rank_with_tool: eccentric.rank,
        removed_with_tool: eccentric.removed,
    }
}

/// Table 1: the certificate, and the sphere centres by the calibrated robot.
pub(super) fn spheres(experiment: &Experiment, calibration: &Calibration) -> PaperTable {
    let rows = experiment.spheres.iter().zip(TABLE_1_MM).map(|(sphere, published)| {
        let here = |at: &Target| matches!(at, Target::Sphere { sphere: id, place: 0 } if *id == sphere.id);
        let own = experiment.observations.iter().filter(|o| here(&o.target));
        let (mut sum, mut count) = (Vector3::zeros(), 0.0);
        for observation in own {
            sum += calibration.tcp_world_m(&observation.q, observation.tau.as_deref());
            count += 1.0;
        }
        let mean = sum * (1e3 / f64::max(count, 1.0));
        let sides = (0..3).map(|k| ComparedNumber {
            published: Some(published[k]),
            ours: mean[k],
        });
        (format!("sphere {}", sphere.id), sides.collect())
    });
    PaperTable {
        number: 1,
        title: "Centres of the spheres in the world frame, mm".to_owned(),
        columns: ["X", "Y", "Z"].map(str::to_owned).to_vec(),
        rows: rows.collect(),
        decimals: 3,
        note: "Ours: where the calibrated robot finds them, mean over all contacts.".to_owned(),
    }
}

/// Table 2: which parameters are considered.
pub(super) fn parameters(redundancy: &Redundancy) -> PaperTable {
    let mut removed = redundancy.removed_on_axis.clone();
    removed.sort();
    let mut published = TABLE_2_REDUNDANT.map(str::to_owned).to_vec();
    published.sort();
    let verdict = if removed == published {
        "the same"
    } else {
        "not the same"
    };
    PaperTable {
        number: 2,
        title: format!("Considered parameters: {} of 28", redundancy.kept.len()),
        columns: Vec::new(),
        rows: Vec::new(),
        decimals: 0,
        note: format!(
            "published: 21, redundant {} and the first row's four | ours: {}, redundant {}: {verdict}.",
            published.join(", "),
            redundancy.kept.len(),
            listed(&removed),
        ),
    }
}

/// Tables 3 and 4: statistics of TCP coordinates (m, F0).
pub(super) fn spread(number: u32, points: &[Vector3<f64>]) -> PaperTable {
    let (published, use_of) = if number == 3 {
        (TABLE_3_MM, "calibration")
    } else {
        (TABLE_4_MM, "validation")
    };
    let s = Spread::of(points);
    let rows = ["x", "y", "z"].into_iter().enumerate().map(|(k, axis)| {
        let ours = [s.mean_m[k], s.std_m[k], s.min_m[k], s.max_m[k]];
        let sides = ours.iter().zip(published[k]).map(|(ours, published)| ComparedNumber {
            published: Some(published),
            ours: ours * 1e3,
        });
        (axis.to_owned(), sides.collect())
    });
    PaperTable {
        number,
        title: format!(
            "Statistics of the {} configurations used for laser {use_of}, mm",
            points.len()
        ),
        columns: ["mean", "std", "min", "max"].map(str::to_owned).to_vec(),
        rows: rows.collect(),
        decimals: 3,
        note: String::new(),
    }
}

/// Table 5: validation with the arc-measured base.
pub(super) fn table_5(validation: &ValidationTable) -> PaperTable {
    let shown = [
        Estimator::LaserNelderMead,
        Estimator::PaperNelderMead,
        Estimator::Nominal,
        Estimator::Laser,
        Estimator::GaussNewton,
        Estimator::LaserFull,
        Estimator::Sphere,
    ];
    let rows = shown.into_iter().filter_map(|name| {
        let s = validation.model(name.name())?.statistics(Alignment::Arcs);
        let published = TABLE_5_MM.iter().find(|(n, _)| *n == name).map(|(_, v)| *v);
        let ours = [s.mean_mm, s.std_mm, s.min_mm, s.max_mm];
        let sides = ours.into_iter().enumerate().map(|(k, ours)| ComparedNumber {
            published: published.map(|p| p[k]),
            ours,
        });
        Some((name.name().to_owned(), sides.collect()))
    });
    PaperTable {
        number: 5,
        title: "Validation errors, base measured by arcs, mm".to_owned(),
        columns: ["mean", "std", "min", "max"].map(str::to_owned).to_vec(),
        rows: rows.collect(),
        decimals: 3,
        note: "*_nelder_mead: the paper's stopped simplex; gauss_newton, laser: the same fitness, minimised; \
               sphere, laser_full: the full model from the same recordings."
            .to_owned(),
    }
}

/// Table 6: the calibrated table by the paper's simplex, and by the better estimator.
pub(super) fn calibrated(simplex: &Calibration, full: &Calibration) -> PaperTable {
    let row = |calibration: &Calibration, i: usize| {
        calibration
            .robot
            .joints
            .get(i)
            .map_or([0.0; 4], |j| [j.mdh.alpha, j.mdh.a * 1e3, j.mdh.theta, j.mdh.d * 1e3])
    };
    let mut rows = Vec::new();
    for i in 0..simplex.robot.dof() {
        let published = TABLE_6.get(i).copied();
        let side = |ours: [f64; 4], published: Option<[f64; 4]>| -> Vec<ComparedNumber> {
            let sides = ours.into_iter().enumerate().map(|(k, ours)| ComparedNumber {
                published: published.map(|p| p[k]),
                ours,
            });
            sides.collect()
        };
        rows.push((format!("{i} simplex"), side(row(simplex, i), published)));
        rows.push((format!("{i} full"), side(row(full, i), None)));
    }
    PaperTable {
        number: 6,
        title: "Calibrated table: alpha and theta in rad, a and d in mm".to_owned(),
        columns: ["alpha", "a", "theta", "d"].map(str::to_owned).to_vec(),
        rows,
        decimals: 6,
        note: "This is another robot than the paper's: signs and sizes differ, but the frozen values agree.".to_owned(),
    }
}

/// Conclusions of the study, in words.
pub(super) fn findings(r: &Reproduction) -> Vec<String> {
    let zeros = r.simplex.zeros().len();
    let mean = |name: Estimator| {
        r.validation
            .model(name.name())
            .map_or((f64::NAN, f64::NAN), |m| (m.arcs.mean_mm, m.arcs.max_mm))
    };
    let fitted = |name: Estimator| r.validation.model(name.name()).map_or(f64::NAN, |m| m.best_fit.mean_mm);
    let evaluations: usize = r.simplex.searches.iter().map(|s| s.0).sum();
    let (sphere, laser) = (mean(Estimator::Sphere), mean(Estimator::Laser));
    let gap_um = (sphere.1 - laser.1) * 1e3;
    vec![
        format!(
            "The simplex froze: {} of {zeros} parameters that start at zero stand at 6.1e-5 +- 0.3e-5 (published: \
             11 of 12 at 5.6e-5 to 6.3e-5), after {evaluations} evaluations in {} mini-batches; they were never identified.",
            r.frozen,
            r.simplex.searches.len(),
        ),
        format!(
            "Its fitness is {:.1} times the optimum; with first steps of prior size the same simplex reaches {:.4} times.",
            r.simplex_over_optimum, r.scaled_over_optimum
        ),
        format!(
            "The same contacts, full model: {:.3} mm mean, {:.3} max (paper's sphere {:.3}, nominal {:.3}).",
            sphere.0,
            sphere.1,
            mean(Estimator::PaperNelderMead).0,
            mean(Estimator::Nominal).0
        ),
        format!(
            "Maximum error of spheres (full model) over that of the laser's geometry model, paper's protocol: {gap_um:+.0} um \
             (published: +58 um)."
        ),
        format!(
            "An equally well modelled laser calibration has {:.3} mm against {:.3} from spheres (base fitted): {} ahead by {:.3} mm.",
            fitted(Estimator::LaserFull),
            fitted(Estimator::Sphere),
            if fitted(Estimator::LaserFull) < fitted(Estimator::Sphere) {
                "the laser stays"
            } else {
                "the spheres are"
            },
            (fitted(Estimator::Sphere) - fitted(Estimator::LaserFull)).abs(),
        ),
    ]
}
