//! Certificates with what the configuration states.

use spherecal_identify::study::Study;
use spherecal_report::Certificate;
use spherecal_results::{CertificateSubject, certificate};

use crate::{CertificateSection, Evaluation, JobError, Measurements};

/// The certificate of a study, with what the user stated. A table of poses does not say when it
/// was measured and whether its arm was simulated.
pub fn study_certificate(study: &Study, stated: &CertificateSection) -> Certificate {
    spherecal_results::study_certificate(study, &|certificate| stated.state(certificate))
}

/// The certificate of a run; `created` says when it was measured.
/// Errors: a configuration that cannot be written as TOML.
pub(crate) fn run_certificate(
    m: &Measurements,
    e: &Evaluation,
    created: &str,
    recordings_sha256: &str,
) -> Result<Certificate, JobError> {
    let about = CertificateSubject {
        robot: m.robot.name.as_str(),
        arm: &m.config.arm,
        measured: Some(created),
        simulated: m.simulated(),
        campaign: true,
        configuration: Some(m.config.to_toml()?),
        recordings_sha256: recordings_sha256.to_owned(),
    };
    let state = |certificate: &mut Certificate| m.config.certificate.state(certificate);
    Ok(certificate(&state, about, &m.to_recordings(), e))
}
