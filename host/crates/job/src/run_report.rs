//! A report of a run: sphere contacts measured, laser measurements judging.

use crate::{Evaluation, Link, Measurements, Summary};
use spherecal_campaign::telemetry::Trace;
use spherecal_identify::validate::{Alignment, ValidationTable};
use spherecal_link::qemu::LOG_FILE;
use spherecal_model::LaserShot;
use spherecal_report::calibration::{correlation, group_table, identifiability_words, parameter_rows};
use spherecal_report::{
    ContactTrace, ErrorSeries, ErrorTable, Headline, Histogram, ModelRow, Prediction, ReportInput, ResidualPoint,
    SimpleTable, WorkspacePoint,
};

fn strings(words: &[&str]) -> Vec<String> {
    words.iter().map(|w| (*w).to_owned()).collect()
}

/// The report of a run; `traces` are the forces of its contacts, `created` says
/// when it was measured.
pub fn run_report(m: &Measurements, e: &Evaluation, s: &Summary, traces: &[Trace], created: &str) -> ReportInput {
    ReportInput {
        title: format!(
            "{}{}: calibration report",
            if s.simulated { "SIMULATED: " } else { "" },
            s.robot
        ),
        subtitle: format!(
            "{created} · {} recordings on {} spheres · link {} · seed {}",
            s.poses.recorded,
            m.spheres.len(),
            s.link_name,
            s.seed
        ),
        headline: headline(e, s),
        error_tables: e.table().map(error_tables).unwrap_or_default(),
        errors: e.table().map(errors).unwrap_or_default(),
        workspace: e.table().map(|t| workspace(m, e, t)).unwrap_or_default(),
        contacts: traces
            .iter()
            .map(|t| ContactTrace {
                title: format!("Sphere {}", t.sphere),
                samples: t.samples.clone(),
                trigger_s: Some(t.trigger_s),
                threshold_n: m.config.procedure.approach.trigger_n,
            })
            .collect(),
        triggers: triggers(m),
        stillness: Vec::new(),
        stillness_tables: Vec::new(),
        parameters: parameter_rows(&e.calibration),
        identifiability: identifiability_words(&e.calibration),
        residuals: residuals(m, e),
        outliers: e
            .calibration
            .residual
            .outliers
            .iter()
            .filter_map(|o| {
                let r = m.recordings.get(o.index)?;
                Some((format!("sphere {}, pose {}", r.sphere, r.pose), o.why.clone()))
            })
            .collect(),
        correlation: correlation(&e.calibration),
        prediction: e.table().map(|t| prediction(m, e, t)),
        fit_tables: vec![
            group_table(&e.calibration.groups, |p| {
                if p == 0 { String::new() } else { format!("place {p}") }
            }),
            contacts(m),
            seating(m),
        ],
        health_tables: health(m, s),
        notes: s.remarks.clone(),
        provenance: provenance(m, s, created),
    }
}

fn headline(e: &Evaluation, s: &Summary) -> Headline {
    let of = |name: &str| s.validation.models.get(name).map(|m| m.arcs);
    let mut figures = Vec::new();
    let mut sentence = match (of("nominal"), of("sphere")) {
        (Some(n), Some(c)) => {
            figures.push((
                "Mean error".to_owned(),
                format!("{:.3} mm", c.mean_mm),
                format!("nominally {:.3} mm", n.mean_mm),
            ));
            figures.push((
                "Largest error".to_owned(),
                format!("{:.3} mm", c.max_mm),
                format!("nominally {:.3} mm", n.max_mm),
            ));
            let gain = 1.0 - c.mean_mm / n.mean_mm.max(1e-12);
            if gain > 0.0 {
                format!(
                    "Calibrated by touching spheres, the {} is {:.0} % more accurate: its mean position error fell from \
                     {:.3} mm to {:.3} mm, the largest from {:.3} mm to {:.3} mm.",
                    s.robot,
                    gain * 100.0,
                    n.mean_mm,
                    c.mean_mm,
                    n.max_mm,
                    c.max_mm
                )
            } else {
                format!(
                    "The calibrated {} is no better than the nominal one: mean position error {:.3} mm, nominally {:.3} mm.",
                    s.robot, c.mean_mm, n.mean_mm
                )
            }
        }
        _ => format!(
            "The {} was calibrated by touching spheres; no laser tracker judged the result. The recordings agree with the \
             model within {:.3} mm (rms).",
            s.robot, s.residual.rms_mm
        ),
    };
    sentence += &against_the_laser(s);
    figures.push((
        "Recordings".to_owned(),
        s.poses.recorded.to_string(),
        format!("{} given up, {} outliers", s.poses.rejected, s.residual.outliers),
    ));
    if let Some(e) = s.verdict.expected_error_mm {
        figures.push((
            "Expected error".to_owned(),
            format!("{:.3} mm", e.mean),
            format!(
                "mean over the workspace, as far as the model knows; 95 % interval {:.3} to {:.3} mm",
                e.interval[0], e.interval[1]
            ),
        ));
    }
    let identified = e.calibration.parameters.iter().filter(|p| p.identified).count();
    figures.push((
        "Parameters".to_owned(),
        identified.to_string(),
        "determined by the data".to_owned(),
    ));
    figures.push((
        "Robot time".to_owned(),
        format!("{:.0} min", s.simulated_s / 60.0),
        format!("{} contacts, {} faults", s.contacts.len(), s.faults.len()),
    ));
    Headline {
        trusted: s.verdict.may_be_used,
        sentence,
        reasons: s.verdict.reasons.clone(),
        next: s.verdict.next.clone(),
        figures,
    }
}

/// How the spheres do against a laser tracker, modelled as the paper does and
/// modelled as well as they are: which is ahead, and by how much.
fn against_the_laser(s: &Summary) -> String {
    let mean = |name: &str| s.validation.models.get(name).map(|m| m.arcs.mean_mm);
    let Some(sphere) = mean("sphere") else {
        return String::new();
    };
    let ahead = |laser: f64| {
        let difference = (laser - sphere).abs();
        if sphere <= laser {
            format!("is behind by {difference:.3} mm ({laser:.3} mm)")
        } else {
            format!("stays ahead by {difference:.3} mm ({laser:.3} mm)")
        }
    };
    let paper = mean("laser").map(|laser| {
        format!(
            " A laser calibration of the geometry alone, as the paper's, {} in the mean.",
            ahead(laser)
        )
    });
    let equal = mean("laser_full").map(|laser| {
        format!(
            " One that models the robot as fully as the spheres do {}.",
            ahead(laser)
        )
    });
    [paper, equal].into_iter().flatten().collect()
}

fn error_tables(table: &ValidationTable) -> Vec<ErrorTable> {
    Alignment::ALL
        .into_iter()
        .map(|alignment| ErrorTable {
            title: match alignment {
                Alignment::Arcs => format!("Table 5: position errors on {} laser measurements", table.n),
                other => {
                    let title = other.title();
                    title[..1].to_uppercase() + &title[1..]
                }
            },
            caption: match alignment {
                Alignment::Arcs => {
                    "Base and tool frames were measured by arcs for all models, as in the paper.".to_owned()
                }
                Alignment::BestFit => "What is left when only the arm's shape counts.".to_owned(),
                Alignment::Own => "Where each model itself says that its base stands.".to_owned(),
            },
            rows: table
                .models
                .iter()
                .map(|m| {
                    let v = m.statistics(alignment);
                    ModelRow {
                        name: m.name.clone(),
                        mean_mm: v.mean_mm,
                        std_mm: v.std_mm,
                        min_mm: v.min_mm,
                        max_mm: v.max_mm,
                    }
                })
                .collect(),
        })
        .collect()
}

fn errors(table: &ValidationTable) -> Vec<ErrorSeries> {
    table
        .models
        .iter()
        .filter(|m| ["nominal", "sphere", "laser"].contains(&m.name.as_str()))
        .map(|m| ErrorSeries {
            name: m.name.clone(),
            errors_mm: m.errors_mm[0].clone(),
        })
        .collect()
}

fn workspace(m: &Measurements, e: &Evaluation, table: &ValidationTable) -> Vec<WorkspacePoint> {
    let of = |name: &str| table.models.iter().find(|m| m.name == name).map(|m| &m.errors_mm[0]);
    let (Some(nominal), Some(sphere)) = (of("nominal"), of("sphere")) else {
        return Vec::new();
    };
    m.shots(LaserShot::VALIDATE)
        .iter()
        .zip(nominal.iter().zip(sphere))
        .map(|(shot, (n, c))| WorkspacePoint {
            at_m: e.calibration.tcp_m(&shot.q, None).into(),
            nominal_mm: *n,
            calibrated_mm: *c,
        })
        .collect()
}

/// Predicted errors against those found with the base aligned.
fn prediction(m: &Measurements, e: &Evaluation, table: &ValidationTable) -> Prediction {
    let found = table
        .models
        .iter()
        .find(|m| m.name == "sphere")
        .map(|m| m.errors_mm[1].as_slice());
    let pairs_mm: Vec<(f64, f64)> = m
        .shots(LaserShot::VALIDATE)
        .iter()
        .zip(found.unwrap_or_default())
        .map(|(shot, error)| {
            let variance = e.calibration.tcp_covariance_in_base(&shot.q).trace().max(0.0);
            (variance.sqrt() * 1e3, *error)
        })
        .collect();
    let n = pairs_mm.len().max(1) as f64;
    Prediction {
        mean_mm: pairs_mm.iter().map(|p| p.0).sum::<f64>() / n,
        max_mm: pairs_mm.iter().map(|p| p.0).fold(0.0, f64::max),
        pairs_mm,
    }
}

fn residuals(m: &Measurements, e: &Evaluation) -> Vec<ResidualPoint> {
    let residual = &e.calibration.residual;
    residual
        .rows
        .iter()
        .filter_map(|row| {
            Some(ResidualPoint {
                group: format!("sphere {}", m.recordings.get(row.index)?.sphere),
                distance_mm: row.error_mm.iter().map(|x| x * x).sum::<f64>().sqrt(),
                outlier: residual.outliers.iter().any(|o| o.index == row.index),
            })
        })
        .collect()
}

/// Latency and overshoot of the trigger; nothing for a run without contact.
fn triggers(m: &Measurements) -> Vec<Histogram> {
    if m.contacts.is_empty() {
        return Vec::new();
    }
    let approach = &m.config.procedure.approach;
    let dwell_ms = approach.dwell_s * 1e3;
    let histogram = |what: &str, caption: String, values: Vec<f64>| Histogram {
        what: what.to_owned(),
        of: "contacts".to_owned(),
        caption,
        values,
    };
    vec![
        histogram(
            "latency of the trigger (ms)",
            format!(
                "Latency of the trigger: control periods from the crossing of {:.1} N that lasted to the declaration; \
                 {dwell_ms:.0} ms are asked for.",
                approach.trigger_n
            ),
            m.contacts.iter().map(|c| f64::from(c.latency_ticks)).collect(),
        ),
        histogram(
            "overshoot of the trigger (N)",
            format!(
                "Overshoot: how far the estimated force had risen above {:.1} N by the declaration, impacts that did \
                 not last included.",
                approach.trigger_n
            ),
            m.contacts.iter().map(|c| c.peak_n - approach.trigger_n).collect(),
        ),
    ]
}

fn contacts(m: &Measurements) -> SimpleTable {
    SimpleTable {
        title: "Contacts and triggers".to_owned(),
        caption: "Latency runs from the crossing of the threshold that lasted to the declaration.".to_owned(),
        columns: strings(&[
            "sphere",
            "trigger (N)",
            "peak (N)",
            "travel (mm)",
            "latency (ms)",
            "early crossings",
        ]),
        rows: m
            .contacts
            .iter()
            .map(|c| {
                vec![
                    c.sphere.to_string(),
                    format!("{:.2}", c.force_n),
                    format!("{:.2}", c.peak_n),
                    format!("{:.2}", c.travel_m * 1e3),
                    c.latency_ticks.to_string(),
                    c.early_crossings.to_string(),
                ]
            })
            .collect(),
    }
}

fn seating(m: &Measurements) -> SimpleTable {
    SimpleTable {
        title: "Seating".to_owned(),
        caption: "The test pull shows that the magnet holds; a seated nest does not move under it.".to_owned(),
        columns: strings(&["sphere", "contact to seat (mm)", "under the test pull (mm)"]),
        rows: m
            .couplings
            .iter()
            .map(|c| {
                vec![
                    c.sphere.to_string(),
                    format!("{:.3}", c.shift_m * 1e3),
                    format!("{:.3}", c.test_m * 1e3),
                ]
            })
            .collect(),
    }
}

fn health(m: &Measurements, s: &Summary) -> Vec<SimpleTable> {
    let gaps: u32 = m.recordings.iter().map(|r| r.gaps).sum();
    let samples: u64 = m.recordings.iter().map(|r| u64::from(r.count)).sum();
    let mut tables = vec![SimpleTable {
        title: "Link and recorder".to_owned(),
        caption: "Both directions together; what was lost was sent again.".to_owned(),
        columns: strings(&[
            "frames",
            "bad checksums",
            "lost",
            "sent again",
            "duplicates dropped",
            "commands late",
            "samples recorded",
            "gaps",
        ]),
        rows: vec![vec![
            s.link.frames.to_string(),
            s.link.crc_errors.to_string(),
            s.link.lost.to_string(),
            s.link.resent.to_string(),
            s.link.duplicates.to_string(),
            s.link.late.to_string(),
            samples.to_string(),
            gaps.to_string(),
        ]],
    }];
    let injected = &s.link.injected;
    if injected.frames > 0 {
        tables.push(SimpleTable {
            title: "What was done to the host link on purpose".to_owned(),
            caption: "Frames of both directions, by [host_link] of the configuration.".to_owned(),
            columns: strings(&["frames", "lost", "sent twice", "held back", "with a flipped bit"]),
            rows: vec![
                [
                    injected.frames,
                    injected.lost,
                    injected.duplicated,
                    injected.reordered,
                    injected.flipped,
                ]
                .map(|count| count.to_string())
                .to_vec(),
            ],
        });
    }
    if s.faults.is_empty() {
        tables[0].caption.push_str(" No fault occurred.");
    } else {
        tables.insert(
            0,
            SimpleTable {
                title: "Faults".to_owned(),
                caption: "All were recovered from; poses that were given up are not used.".to_owned(),
                columns: strings(&["fault", "phase", "time (s)", "joint", "value", "limit"]),
                rows: s
                    .faults
                    .iter()
                    .map(|f| {
                        vec![
                            format!("{:?}", f.fault),
                            format!("{:?}", f.phase),
                            format!("{:.3}", f.time_us as f64 * 1e-6),
                            if f.joint == 0 {
                                "–".to_owned()
                            } else {
                                f.joint.to_string()
                            },
                            format!("{:.4}", f.value),
                            format!("{:.4}", f.limit),
                        ]
                    })
                    .collect(),
            },
        );
    }
    tables
}

fn provenance(m: &Measurements, s: &Summary, created: &str) -> Vec<(String, String)> {
    let mut out = vec![
        ("program".to_owned(), format!("spherecal {}", s.version)),
        ("measured".to_owned(), created.to_owned()),
        ("robot".to_owned(), format!("{} ({} joints)", s.robot, m.robot.dof())),
        ("seed".to_owned(), s.seed.to_string()),
        ("link".to_owned(), s.link_name.clone()),
        (
            "poses".to_owned(),
            format!(
                "{} planned, {} reachable, {} recorded, {} given up",
                s.poses.planned, s.poses.reachable, s.poses.recorded, s.poses.rejected
            ),
        ),
        (
            "estimator".to_owned(),
            format!("{}, {} model", m.config.identify.method, m.config.identify.model),
        ),
        ("recordings' SHA-256".to_owned(), s.recordings_sha256.clone()),
    ];
    if s.link_name == Link::Qemu.to_string() {
        let log = format!("{LOG_FILE}, beside this report");
        out.push(("controller's log".to_owned(), log));
    }
    if let Ok(text) = toml::to_string(&m.config) {
        let words: Vec<&str> = text.lines().filter(|l| !l.trim().is_empty()).collect();
        out.push(("configuration".to_owned(), words.join("; ")));
    }
    out
}
