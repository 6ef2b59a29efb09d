//! Makes the certificate of a result: what the user stated, and what the evaluation knows.

use sha2::{Digest, Sha256};
use spherecal_identify::evaluate::repeatability;
use spherecal_identify::{Evaluation, Recordings, Source};
use spherecal_report::{BudgetLine, COVERAGE, Certificate, Conformity, PositionError, Uncertainty};

/// Commit of the sources, where the build states it.
const COMMIT: Option<&str> = option_env!("SPHERECAL_COMMIT");

/// Bytes as hexadecimal digits.
pub fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

/// Hash of a text, in hexadecimal digits.
fn sha256(text: &str) -> String {
    hexadecimal(&Sha256::digest(text.as_bytes()))
}

/// What a certificate says that is neither in the user's block nor in the evaluation.
pub struct CertificateSubject<'a> {
    /// Robot.
    pub robot: &'a str,
    /// Name of this very arm; empty if none was given.
    pub arm: &'a str,
    /// When it was measured; none if nobody said.
    pub measured: Option<&'a str>,
    /// Whether the arm was a simulation.
    pub simulated: bool,
    /// Whether the robot itself recorded the data, in a campaign.
    pub campaign: bool,
    /// Configuration or options, as TOML.
    pub configuration: Option<String>,
    /// Hash of the recordings.
    pub recordings_sha256: String,
}

/// The certificate of an evaluation; `state` writes onto it what the user stated.
pub fn certificate(
    state: &dyn Fn(&mut Certificate),
    about: CertificateSubject<'_>,
    recordings: &Recordings,
    evaluation: &Evaluation,
) -> Certificate {
    let verdict = &evaluation.verdict;
    let calibration = &evaluation.calibration;
    let closed_loop = recordings.closed_loop();
    let method = match (closed_loop, about.campaign) {
        (true, true) => "contacts with the spheres of a plate, recorded in a run",
        (true, false) => "contacts with the spheres of a plate, from a table",
        (false, _) => "points measured by an instrument, from a table",
    };
    let (uncertainty, budget) = budget(recordings, evaluation);
    let mut certificate = Certificate {
        simulated: about.simulated,
        contacts: closed_loop,
        robot: about.robot.to_owned(),
        serial: Some(about.arm.to_owned()).filter(|arm| !arm.is_empty()),
        measured: about.measured.map(str::to_owned),
        method: method.to_owned(),
        estimator: estimator(&calibration.method.to_string(), &calibration.model.to_string()),
        program: concat!("spherecal ", env!("CARGO_PKG_VERSION")).to_owned(),
        commit: COMMIT.map(str::to_owned).filter(|commit| !commit.is_empty()),
        configuration_sha256: about.configuration.as_deref().map(sha256),
        recordings: evaluation.used.len(),
        recordings_sha256: about.recordings_sha256,
        expected_error_mm: verdict.expected_error_mm.map(|e| e.work),
        geometry_alone_mm: verdict.file_error_mm.map(|e| e.work),
        nominal_error_mm: verdict.nominal_error_mm.map(|e| e.work),
        uncertainty,
        budget,
        position_errors: position_errors(recordings, evaluation, about.simulated),
        repeatability: repeatability(recordings, evaluation),
        conformity: conformity(evaluation),
        may_be_used: verdict.may_be_used,
        reasons: verdict.reasons.clone(),
        ..Certificate::default()
    };
    state(&mut certificate);
    certificate
}

/// Conformity with the accuracy that was asked for, by the check that the verdict made of it.
fn conformity(evaluation: &Evaluation) -> Option<Conformity> {
    let check = |name: &str| evaluation.verdict.checks.iter().find(|c| c.name == name);
    let asked = check("asked_accuracy")?;
    let (decides, rule) = match check("asked_accuracy_sure") {
        Some(sure) => (
            sure,
            "Decision rule: the robot conforms if its mean error over the work region is below that with a probability of at \
             least 95 %.",
        ),
        None => (
            asked,
            "Decision rule: the robot conforms if the mean of the measured errors is at most that (simple acceptance).",
        ),
    };
    Some(Conformity {
        asked_mm: asked.limit?,
        rule: rule.to_owned(),
        conforms: asked.passed && decides.passed,
        words: decides.words.clone(),
    })
}

/// The uncertainty with its budget: every source that such data have, with its figure or the
/// reason why there is none.
fn budget(recordings: &Recordings, evaluation: &Evaluation) -> (Option<Uncertainty>, Vec<BudgetLine>) {
    let budget = evaluation.error_budget();
    let closed_loop = recordings.closed_loop();
    let unknown = "not known: the residuals could not be tested (see the notes)";
    let line = |source: &str, of: Source, name: &str, holds: &str, without: &str| {
        let term = budget
            .as_ref()
            .and_then(|b| b.terms.iter().find(|t| t.source == of))
            .map(|t| t.rms_mm);
        BudgetLine {
            source: source.to_owned(),
            name: name.to_owned(),
            rms_mm: term,
            remark: match (&budget, term) {
                (_, Some(_)) => holds,
                (Some(_), None) => without,
                (None, None) => unknown,
            }
            .to_owned(),
        }
    };
    let no_plate = "points were measured: there is no plate";
    let mut lines = vec![
        line(
            "plate",
            Source::Plate,
            "Plate",
            "certified coordinates of the spheres, by their stated uncertainty",
            if closed_loop {
                "the certificate states no uncertainty"
            } else {
                no_plate
            },
        ),
        line(
            "seating",
            Source::Seating,
            "Seating",
            "scatter of each contact, and of each coupling as a whole",
            no_plate,
        ),
    ];
    if !closed_loop {
        let scatter = "scatter of each measured point";
        lines.push(line("instrument", Source::Instrument, "Instrument", scatter, unknown));
    }
    lines.extend([
        line(
            "encoder_noise",
            Source::EncoderNoise,
            "Encoder noise",
            "white errors of the joint angles, of the recordings and of one pose in use",
            unknown,
        ),
        line(
            "other_joints",
            Source::OtherJoints,
            "Other joints",
            "errors of the joint angles that depend on other joints' angles, as far as the residuals tell",
            unknown,
        ),
        line(
            "open_parameters",
            Source::OpenParameters,
            "Open parameters",
            "parameters of the robot that the data leave open, by their priors",
            unknown,
        ),
        line(
            "model_discrepancy",
            Source::ModelDiscrepancy,
            "Model discrepancy",
            "what the model leaves out, as far as the residuals tell",
            unknown,
        ),
    ]);
    let uncertainty = budget.map(|b| Uncertainty {
        standard_mm: b.total_mm,
        k: COVERAGE,
        expanded_mm: COVERAGE * b.total_mm,
        noise_by_data: evaluation.options.noise.estimate,
    });
    (uncertainty, lines)
}

/// What was measured at poses outside of the fit; a cross-validation is none of it.
fn position_errors(recordings: &Recordings, evaluation: &Evaluation, simulated: bool) -> Vec<PositionError> {
    if let Some(table) = evaluation.table()
        && let (Some(nominal), Some(sphere)) = (table.model("nominal"), table.model("sphere"))
    {
        let tracker = if simulated {
            "simulated laser tracker"
        } else {
            "laser tracker"
        };
        let frames = [
            ("base measured by arcs", &nominal.arcs, &sphere.arcs),
            ("base fitted to the points", &nominal.best_fit, &sphere.best_fit),
        ];
        return frames
            .map(|(frame, nominal, own)| PositionError {
                by: format!("{tracker}, {frame}"),
                n: table.n,
                mean_mm: own.mean_mm,
                max_mm: own.max_mm,
                nominal_mean_mm: nominal.mean_mm,
            })
            .to_vec();
    }
    let judged = evaluation.judged.as_ref().filter(|_| !evaluation.cross_validated);
    let Some(judged) = judged else { return Vec::new() };
    let (Some(nominal), Some(own)) = (judged.model("nominal"), judged.model("calibrated")) else {
        return Vec::new();
    };
    let (nominal, own) = (nominal.errors(), own.errors());
    let frame = if recordings.closed_loop() {
        "contacts in the plate's frame"
    } else {
        "points in the frame of the data"
    };
    vec![PositionError {
        by: format!("{}; {frame}", judged.by),
        n: own.n,
        mean_mm: own.mean_mm,
        max_mm: own.max_mm,
        nominal_mean_mm: nominal.mean_mm,
    }]
}

/// Estimator and model, once where they have one name.
fn estimator(method: &str, model: &str) -> String {
    if method == model {
        format!("{model} model")
    } else {
        format!("{method}, {model} model")
    }
}
