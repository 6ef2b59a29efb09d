//! `spherecal certificate`: the certificate of an accepted result, as a document.

use std::path::PathBuf;

use clap::Args;
use serde::Deserialize;
use spherecal_job::CertificateSection;
use spherecal_model::{read_text, write_file};
use spherecal_report::Certificate;
use spherecal_store::time::now_utc;

use super::exit::{CliError, Exit};
use super::out::outln;

/// Largest `summary.json`, in bytes.
const MOST_BYTES: u64 = 1 << 28;
/// Where the refusal says what a field is.
const FIELDS: &str = "docs/certificate.md";

/// Write the certificate of an accepted result, with the names and numbers that ISO/IEC 17025 asks for.
///
/// The figures are those of summary.json in the folder of the result. Names and numbers come from the block [certificate]
/// of the configuration, and from --names. A refused result has no certificate.
#[derive(Args, Clone, Debug)]
#[command(
    after_help = "Example: spherecal certificate cell/tracker --names cell/cell.toml\n\n\
    Exit codes: 0 written; 1 failed; 2 a name is missing, or wrong input; 3 the result must not be used."
)]
pub struct CertificateArgs {
    /// Folder of the result.
    #[arg(value_name = "RESULT_DIR", default_value = "spherecal-out")]
    pub result: PathBuf,
    /// File with the block [certificate]. What it states replaces what the result says.
    #[arg(long, value_name = "FILE.toml")]
    pub names: Option<PathBuf>,
    /// Write a draft, which may lack names, or be of a simulated arm: certificate-draft.html.
    #[arg(long)]
    pub draft: bool,
}

/// What is read of `summary.json`.
#[derive(Deserialize)]
struct Summary {
    certificate: Certificate,
}

pub(super) fn run(args: &CertificateArgs) -> Result<Exit, CliError> {
    let path = args.result.join("summary.json");
    let name = path.display();
    if !path.exists() {
        return Err(CliError::input(format!(
            "{name}: there is no such file: give the folder that `run`, `identify` or `report` wrote"
        )));
    }
    let text = read_text(&path, MOST_BYTES, "a summary has some hundred kilobytes").map_err(CliError::input)?;
    let Summary { mut certificate } = serde_json::from_str(&text).map_err(|e| {
        CliError::input(format!(
            "{name}: it is no summary of this version ({e}): write the result again, with `identify` or `report`"
        ))
    })?;
    if let Some(path) = &args.names {
        CertificateSection::read(path)?.state(&mut certificate);
    }
    if !certificate.may_be_used {
        return Err(CliError::refused(format!(
            "{name}: the result must not be used, so it has no certificate: {}",
            certificate.reasons.first().map_or("see its report", String::as_str)
        )));
    }
    if !args.draft {
        if certificate.simulated {
            return Err(CliError::input(format!(
                "{name}: the arm was a simulation, so it has no certificate; --draft writes a page that says so"
            )));
        }
        let missing = certificate.missing();
        if !missing.is_empty() {
            return Err(CliError::input(format!(
                "the certificate does not state {}: give them in a block [certificate] with --names FILE.toml ({FIELDS}), or \
                 write a draft with --draft",
                missing.join(", ")
            )));
        }
    }
    let today: String = now_utc().chars().take("2026-11-28".len()).collect();
    let (file, next) = if args.draft {
        (
            "certificate-draft.html",
            "A draft is to read, not to sign: state what it lacks, and leave --draft out.",
        )
    } else {
        ("certificate.html", "Print it from a browser, and sign it.")
    };
    let out = args.result.join(file);
    write_file(&out, certificate.document(&today, args.draft))
        .map_err(|e| CliError::job(format!("{}: {e}", out.display())))?;
    outln!("{}\n\nNext: {next}", out.display());
    Ok(Exit::Done)
}
