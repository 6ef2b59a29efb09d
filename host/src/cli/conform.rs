//! `spherecal conform`: asks a foreign drive or controller for what the documents promise of it.

use clap::Args;

use super::exit::Exit;
use super::out::outln;
use spherecal_link::tcp::conform::{Finding, of_controller, of_drive};

/// Arguments of `conform`.
#[derive(Args, Clone, Debug)]
pub struct ConformArgs {
    /// A drive of the drive link: a simulator or a gateway. It is never enabled.
    #[arg(
        long,
        value_name = "HOST:PORT",
        required_unless_present = "controller",
        conflicts_with = "controller"
    )]
    pub drive: Option<String>,
    /// A controller process, by its host link. It is told to stop, and nothing else.
    #[arg(long, value_name = "HOST:PORT")]
    pub controller: Option<String>,
    /// Print one JSON document on stdout and nothing else.
    #[arg(long)]
    pub json: bool,
}

pub(super) fn run(args: &ConformArgs) -> Exit {
    let findings = match (&args.drive, &args.controller) {
        (Some(address), _) => of_drive(address),
        (None, Some(address)) => of_controller(address),
        // The parser demands one of them.
        (None, None) => Vec::new(),
    };
    let failed = findings.iter().filter(|finding| !finding.holds()).count();
    if args.json {
        let sentences: Vec<_> = findings.iter().map(document).collect();
        outln!(
            "{:#}",
            serde_json::json!({ "conforms": failed == 0, "sentences": sentences })
        );
    } else {
        for finding in &findings {
            let word = if finding.holds() { "holds" } else { "FAILS" };
            outln!("{word}  {}: {}", finding.document, finding.sentence);
            if let Some(seen) = &finding.seen {
                outln!("       seen: {seen}");
            }
        }
        outln!("{} of {} sentences hold", findings.len() - failed, findings.len());
    }
    if failed == 0 { Exit::Done } else { Exit::Failed }
}

fn document(finding: &Finding) -> serde_json::Value {
    serde_json::json!({
        "document": finding.document,
        "sentence": finding.sentence,
        "holds": finding.holds(),
        "seen": finding.seen,
    })
}
