//! A report of a calibration from files.

use super::calibration::{correlation, group_table, identifiability_words, outliers, parameter_rows, residual_points};
use super::headline::{Error, compared, files, regions};
use super::input::{Headline, ReportInput, SimpleTable};
use super::judged::{self, DRAWN};
use spherecal_identify::Calibration;
use spherecal_identify::evaluate::{Errors, JudgedModel, millimetres};
use spherecal_identify::study::Study;

/// The report of a study; `created` is its date, in words.
pub fn study_report(study: &Study, created: &str) -> ReportInput {
    let evaluation = &study.evaluation;
    let calibration = &evaluation.calibration;
    let recordings = &study.recordings;
    let judged = evaluation.judged.as_ref();
    let errors = |name: &str| -> Error {
        let model = judged.and_then(|j| j.model(name));
        let errors: Errors = model.map(JudgedModel::errors).unwrap_or_default();
        Error {
            mean_mm: errors.mean_mm,
            max_mm: errors.max_mm,
        }
    };
    let v = &evaluation.verdict;
    let name = study.model.robot.name.as_str();
    let comparison = match judged {
        None => format!("The {name} was calibrated, but nothing judged the result."),
        // A cross-validation knows no more than where the data are: the expected errors of the files say more.
        Some(_) if evaluation.cross_validated => String::new(),
        Some(_) => compared(
            &format!("The calibrated {name}"),
            name,
            errors("nominal"),
            errors("calibrated"),
        ),
    };
    let place = |p: u32| recordings.places.name(p).to_owned();
    let residuals = residual_points(evaluation, recordings);
    let mut notes = study.notes.clone();
    if calibration.residual.rows.len() > residuals.len() {
        notes.push(format!(
            "the figures by row show every {}th of {} rows; tables and histograms use all rows",
            calibration.residual.rows.len().div_ceil(DRAWN),
            calibration.residual.rows.len()
        ));
    }
    ReportInput {
        title: format!("{name}: calibration report"),
        subtitle: format!(
            "{created} · {} data, {} recordings · {} joints",
            if recordings.closed_loop() {
                "closed-loop"
            } else {
                "absolute"
            },
            recordings.samples.len(),
            study.model.robot.dof()
        ),
        headline: Headline {
            trusted: v.may_be_used,
            sentence: v.headline.clone(),
            reasons: v.reasons.clone(),
            next: v.next.clone(),
            files: files(evaluation),
            figures: Vec::new(),
        },
        comparison,
        error_tables: judged::tables(evaluation),
        errors: judged.map(judged::series).unwrap_or_default(),
        workspace: judged.map(judged::workspace).unwrap_or_default(),
        parameters: parameter_rows(calibration),
        identifiability: identifiability_words(calibration),
        residuals,
        outliers: outliers(evaluation, recordings),
        correlation: correlation(calibration),
        regions: regions(evaluation),
        prediction: judged::prediction(evaluation, recordings),
        fit_tables: [group_table(&calibration.groups, place)]
            .into_iter()
            .chain(targets_table(study))
            .collect(),
        notes,
        provenance: provenance(study, created),
        ..ReportInput::default()
    }
}

/// Targets of the tool and measured orientations; none where rows have one point each.
fn targets_table(study: &Study) -> Option<SimpleTable> {
    let calibration = &study.evaluation.calibration;
    let judged = study.evaluation.judged.as_ref().and_then(|j| j.model("calibrated"));
    let stated = |n: usize, text: String| if n > 0 { text } else { "not judged".to_owned() };
    let mut rows: Vec<Vec<String>> = calibration
        .targets
        .iter()
        .map(|target| {
            let errors = judged.map_or_else(Errors::default, |model| model.target_errors(target.number));
            vec![
                format!("target {}", target.number),
                target.rows.to_string(),
                millimetres(&study.model.tcp_in_flange(target.place_m)),
                target.noise_words(),
                format!("{:.3} mm", target.rms_mm),
                stated(errors.n, format!("{:.3} mm", errors.mean_mm)),
            ]
        })
        .collect();
    rows.extend(calibration.orientation.map(|orientation| {
        let turns = judged.and_then(JudgedModel::turns).unwrap_or_default();
        vec![
            "orientation".to_owned(),
            orientation.rows.to_string(),
            String::new(),
            format!("{:.3} mrad", orientation.noise_mrad),
            format!("{:.3} mrad", orientation.rms_mrad),
            stated(turns.n, format!("{:.3} mrad", turns.mean_mrad)),
        ]
    }));
    (!rows.is_empty()).then(|| SimpleTable {
        title: "Targets on the tool".to_owned(),
        caption:
            "The noise of each axis is that of the instrument alone, found from the data; the joints' deviation of a \
                  row is common to all its targets. The mean error is that of rows that the fit has not seen."
                .to_owned(),
        columns: [
            "target",
            "rows",
            "place in the flange frame, mm",
            "noise",
            "residual, rms",
            "mean error",
        ]
        .map(str::to_owned)
        .to_vec(),
        rows,
    })
}

fn provenance(study: &Study, created: &str) -> Vec<(String, String)> {
    let evaluation = &study.evaluation;
    let recordings = &study.recordings;
    let judged_by = evaluation.judged.as_ref().map_or("nothing", |j| j.by.as_str());
    let mut out = vec![
        ("program".to_owned(), format!("spherecal {}", env!("CARGO_PKG_VERSION"))),
        ("written".to_owned(), created.to_owned()),
        (
            "robot".to_owned(),
            format!("{} ({} joints)", study.model.robot.name, study.model.robot.dof()),
        ),
        (
            "frames".to_owned(),
            format!(
                "root {}, flange {}",
                study.model.frame_names.0, study.model.frame_names.1
            ),
        ),
        ("data".to_owned(), recordings.file.clone()),
        ("judged by".to_owned(), judged_by.to_owned()),
        (
            "estimator".to_owned(),
            format!(
                "{}, {} model",
                evaluation.calibration.method, evaluation.calibration.model
            ),
        ),
        ("noise found".to_owned(), noise_words(&evaluation.calibration)),
        ("time taken".to_owned(), format!("{:.2} s", study.wall_s)),
    ];
    if let Ok(options) = toml::to_string(&evaluation.options) {
        let words: Vec<&str> = options.lines().filter(|l| !l.trim().is_empty()).collect();
        out.push(("options".to_owned(), words.join("; ")));
    }
    out
}

/// The noise that the data have, in words.
fn noise_words(calibration: &Calibration) -> String {
    let noise = &calibration.noise;
    let contacts = calibration.groups.iter().any(|g| g.sphere.is_some());
    let (of, own) = if contacts {
        ("seat", noise.seating_m)
    } else {
        ("instrument", noise.point_m)
    };
    format!(
        "joints {:.0} µrad, {of} {:.0} µm (1 sigma, each axis)",
        noise.joint_rad * 1e6,
        own * 1e6
    )
}
