//! A study from a request to its files, for one chain or for each of several.

use std::path::{Path, PathBuf};

use spherecal_identify::study::{Sources, Study, StudyError, StudyRequest, StudyStep, assemble, study_from};
use spherecal_model::write_file;
use spherecal_report::{Certificate, render, study_report};
use spherecal_results::write_files;
use spherecal_store::time::now_utc;

use super::bag::POSES;
use super::exit::CliError;
use super::explain;
use super::out::errln;
use super::study_progress::StudyProgress;

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
        .map_or(Ok(Vec::new()), |loaded| explain::looked_at(&request.data, loaded));
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
        if !explain::may_explain(&error) {
            return refuse(error);
        }
        let found = explain::explained(request, sources).ok();
        CliError::input(explain::with_reason(&error, found.as_ref(), notes))
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
