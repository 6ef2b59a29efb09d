//! What is wrong with a table that does not fit its robot.

use std::path::Path;

use super::exit::CliError;
use spherecal_explain::{Explanation, Subject, explain, look};
use spherecal_identify::IdentifyError;
use spherecal_identify::evaluate::{EvaluateError, UNLIKE};
use spherecal_identify::study::{Loaded, Sources, StudyError, StudyRequest, assemble};
use spherecal_model::input::InputError;

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
