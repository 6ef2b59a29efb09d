//! A study from a request to its files, for one chain or for each of several.

use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use spherecal_explain::{Explanation, Subject, explain, look};
use spherecal_identify::evaluate::{EvaluateError, UNLIKE};
use spherecal_identify::study::{Loaded, Sources, Study, StudyError, StudyRequest, StudyStep, assemble, study_from};
use spherecal_identify::{IdentifyError, evaluate};
use spherecal_model::input::InputError;
use spherecal_model::write_file;
use spherecal_report::{Certificate, render, study_report};
use spherecal_results::write_files;
use spherecal_store::time::now_utc;

use super::bag::POSES;
use super::exit::CliError;
use super::out::errln;

/// A refusal by whose fault it is.
pub(super) fn refuse(error: StudyError) -> CliError {
    if error.is_input() {
        CliError::input(error)
    } else {
        CliError::job(error)
    }
}

/// Identifies what a request names, and says first what can be told of its table; `notes` are on how it was read.
/// Errors: a table that cannot be used, with what is wrong with it where that can be told.
pub(super) fn identified(
    request: &StudyRequest,
    sources: Sources<'_>,
    notes: &[String],
    mut view: StudyProgress,
) -> Result<Study, CliError> {
    let loaded = assemble(request, sources.clone(), &mut |p| view.show(StudyStep::Reading(p)));
    let remarks = loaded
        .as_ref()
        .map_or(Ok(Vec::new()), |loaded| looked_at(&request.data, loaded));
    let remarks = remarks.inspect_err(|_| view.finish())?;
    if !remarks.is_empty() {
        view.finish();
        for remark in &remarks {
            errln!("spherecal: {remark}");
        }
        view = StudyProgress::new();
    }
    let study = loaded.and_then(|loaded| study_from(request, loaded, &mut |step| view.show(step)));
    view.finish();
    let mut study = study.map_err(|error| {
        if !may_explain(&error) {
            return refuse(error);
        }
        let found = explained(request, sources).ok();
        CliError::input(with_reason(&error, found.as_ref(), notes))
    })?;
    study.notes.extend(remarks);
    Ok(study)
}

/// Writes the files of a study, with the poses that were made of a bag. Returns their paths.
/// Errors: a file that cannot be written.
pub(super) fn write_study(
    study: &Study,
    folder: &Path,
    certificate: &Certificate,
    from_bag: Option<&str>,
) -> Result<Vec<PathBuf>, CliError> {
    let report = render(&study_report(study, &now_utc()))?;
    let files = write_files(study, folder, certificate, Some(&report))?;
    if let Some(moved) = &files.moved {
        errln!("spherecal: {moved}");
    }
    let mut paths = files.paths;
    if let Some(csv) = from_bag {
        let poses = folder.join(POSES);
        write_file(&poses, csv.as_bytes()).map_err(|e| CliError::job(format!("{}: {e}", poses.display())))?;
        paths.push(poses);
    }
    Ok(paths)
}

/// Interval of the lines if there is no terminal.
const LINE_EVERY: Duration = Duration::from_secs(5);
/// Number of rows above which the fit takes long enough to be announced.
const MANY: usize = 10_000;

/// Shows how far a calibration from files has come.
pub(super) struct StudyProgress {
    bar: ProgressBar,
    terminal: bool,
    last_line: Instant,
}

impl StudyProgress {
    /// A view that has shown nothing yet.
    pub(super) fn new() -> Self {
        let terminal = std::io::stderr().is_terminal();
        let target = if terminal {
            ProgressDrawTarget::stderr_with_hz(10)
        } else {
            ProgressDrawTarget::hidden()
        };
        let bar = ProgressBar::with_draw_target(None, target);
        // The template is a constant that is known to parse.
        if let Ok(style) = ProgressStyle::with_template("{spinner:.cyan} {msg}  {elapsed}") {
            bar.set_style(style);
        }
        bar.enable_steady_tick(Duration::from_millis(200));
        Self {
            bar,
            terminal,
            last_line: Instant::now(),
        }
    }

    pub(super) fn show(&mut self, step: StudyStep) {
        let (words, now) = match step {
            StudyStep::Reading(p) => {
                let share = match p.total_bytes {
                    0 => String::new(),
                    total => format!(", {:.0} %", 100.0 * p.bytes as f64 / total as f64),
                };
                (format!("reading: {} rows{share}", p.rows), false)
            }
            StudyStep::Evaluating(evaluate::EvaluationStep::Fitting { rows }) => {
                (format!("fitting {rows} rows"), rows >= MANY)
            }
            StudyStep::Evaluating(evaluate::EvaluationStep::Comparing { name }) => {
                (format!("comparing with {name}"), false)
            }
            StudyStep::Evaluating(evaluate::EvaluationStep::Judging { fits, rows }) => {
                let fits = if fits == 1 {
                    "the fit".to_owned()
                } else {
                    format!("{fits} fits")
                };
                (format!("judging {fits} by {rows} rows"), rows >= MANY)
            }
        };
        if !self.terminal && (now || self.last_line.elapsed() >= LINE_EVERY) {
            errln!("{words}");
            self.last_line = Instant::now();
        }
        self.bar.set_message(words);
    }

    /// Takes the bar away, as does dropping it.
    pub(super) fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

impl Drop for StudyProgress {
    fn drop(&mut self) {
        self.finish();
    }
}

/// Whether a refusal may come from a mistake in the table as a whole.
pub(super) fn may_explain(error: &StudyError) -> bool {
    match error {
        StudyError::Input(InputError::Field { field, .. }) => UNLIKE.contains(&field.as_str()),
        StudyError::Evaluate(e) => matches!(
            e,
            EvaluateError::NotThisRobot { .. } | EvaluateError::NotThisOrientation { .. }
        ),
        StudyError::Identify(e) => matches!(e, IdentifyError::Diverged { .. } | IdentifyError::Singular { .. }),
        _ => false,
    }
}

/// Searches for what is wrong with the table of a request.
/// Errors: a table that cannot be read.
pub(super) fn explained(request: &StudyRequest, sources: Sources<'_>) -> Result<Explanation, StudyError> {
    let loaded = assemble(request, sources, &mut |_| {})?;
    // The options that correct a table count its columns, the search the hinges.
    if loaded.model.joint_path()?.odd_joint().is_some() {
        return Err(InputError::Field {
            file: "command line".to_owned(),
            field: "--explain".to_owned(),
            value: format!("\"{}\"", loaded.model.robot.name),
            remedy: "joints that slide or follow others cannot be searched: check the table by hand".to_owned(),
        }
        .into());
    }
    let experiment = &loaded.recordings.experiment;
    Ok(explain(&Subject::new(
        &loaded.model,
        &experiment.observations,
        &experiment.spheres,
    )))
}

/// What is told of a table before its fit, without a search.
/// Errors: a table that a delay spoils, with the option that corrects it.
pub(super) fn looked_at(file: &Path, loaded: &Loaded) -> Result<Vec<String>, CliError> {
    let experiment = &loaded.recordings.experiment;
    let found = look(&Subject::new(
        &loaded.model,
        &experiment.observations,
        &experiment.spheres,
    ));
    let sentences = found.sentences();
    if found.found.is_empty() {
        return Ok(sentences);
    }
    Err(CliError::input(format!(
        "{}: {}",
        file.display(),
        sentences.join("\n  ")
    )))
}

/// A refusal with what the search says to it, and with the notes on how the tables were read.
pub(super) fn with_reason(error: &StudyError, found: Option<&Explanation>, notes: &[String]) -> String {
    let mut lines = vec![error.to_string()];
    if let Some(found) = found {
        if found.found.is_empty() && found.own_m.is_finite() {
            lines.push(found.none_of_these());
        }
        lines.extend(found.sentences());
    }
    lines.extend(notes.iter().cloned());
    lines.join("\n  ")
}
