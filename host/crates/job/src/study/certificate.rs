//! The certificate of a calibration from files.

use spherecal_identify::study::Study;
use spherecal_report::Certificate;

use super::summary::recordings_sha256;
use crate::CertificateSection;
use crate::certificate::{CertificateSubject, certificate};

/// The certificate of a study, with what the user stated. A table of poses does not say when it
/// was measured and whether its arm was simulated.
pub fn study_certificate(study: &Study, stated: &CertificateSection) -> Certificate {
    let about = CertificateSubject {
        robot: study.model.robot.name.as_str(),
        arm: "",
        measured: None,
        simulated: false,
        campaign: false,
        configuration: toml::to_string(&study.evaluation.options).ok(),
        recordings_sha256: recordings_sha256(study),
    };
    certificate(stated, about, &study.recordings, &study.evaluation)
}
