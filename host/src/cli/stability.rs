//! `spherecal stability`: how still the seated arm holds; the paper's stability analysis.

use std::path::Path;

use clap::Args;

use super::args::RunArgs;
use super::exit::{CliError, Exit, interrupt, unwritten};
use super::features;
use super::out::{out, outln};
use super::progress::ProgressView;
use spherecal_job::PreparedRun;
use spherecal_job::stability::{Held, Stillness, analyse, hold, holds_report};
use spherecal_model::chain::Chain;
use spherecal_model::robots;
use spherecal_report as report;
use spherecal_results::Files;
use spherecal_store::time::now_utc;

/// Arguments of `stability`.
#[derive(Args, Clone, Debug)]
pub struct StabilityArgs {
    /// The cell, and the plan from which the places are taken.
    #[command(flatten)]
    pub run: RunArgs,
    /// Length of each hold, in s.
    #[arg(long, value_name = "S", default_value_t = 30, value_parser = clap::value_parser!(u8).range(2..=120))]
    pub hold_s: u8,
    /// Places to hold at, spread over the plan.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u8).range(1..=100))]
    pub places: u8,
}

/// Averaging time of a recording, in s, as in the paper.
const WINDOW_S: f64 = 1.0;
/// Samples of a second of holding on a drive of 1 kHz. A slower drive holds
/// longer; the windows are cut by the drive's own period.
const SAMPLES_PER_S: u32 = 1000;

/// Holds, judges, and writes the report.
pub(super) fn run(args: &StabilityArgs) -> Result<Exit, CliError> {
    let run = &args.run;
    if run.resume {
        return Err(CliError::input(
            "--resume: `spherecal stability` always starts a new measurement: leave the option out",
        ));
    }
    features::check_run(run)?;
    let interrupt = interrupt()?;
    let prepared = run.prepare()?;
    std::fs::create_dir_all(&run.out).map_err(unwritten(&run.out))?;
    let (model, chain) = model(&prepared, &run.out)?;
    let ticks = u32::from(args.hold_s) * SAMPLES_PER_S;
    let places = usize::from(args.places);
    let mut view = ProgressView::new();
    let held = hold(&prepared, &run.link, &run.out, (places, ticks), &mut view, &interrupt);
    view.finish();
    let (holds, outcome) = held?;
    let holds: Vec<Held> = holds
        .iter()
        .map(|hold| analyse(hold, &chain, WINDOW_S))
        .collect::<Result<_, _>>()
        .map_err(CliError::job)?;
    if holds.is_empty() {
        return Err(CliError::job(
            "no hold was recorded: remedy the faults above and run the command again",
        ));
    }
    let within = holds.iter().all(|h| h.within_noise);
    let still = holds.iter().all(Held::is_still);
    let document = serde_json::json!({
        "command": "stability",
        "version": env!("CARGO_PKG_VERSION"),
        "robot": prepared.robot.name,
        "seed": prepared.config.seed,
        "link": run.link.to_string(),
        "model": model,
        "hold_s": args.hold_s,
        "window_s": WINDOW_S,
        "within_noise": within,
        "still": still,
        "holds": holds,
        "faults": outcome.faults,
    });
    let robot = prepared.robot.name.as_str();
    let about = format!("{} · link {} · seed {}", now_utc(), run.link, prepared.config.seed);
    let provenance = vec![
        ("program".to_owned(), format!("spherecal {}", env!("CARGO_PKG_VERSION"))),
        ("kinematic model".to_owned(), model.clone()),
        ("faults".to_owned(), outcome.faults.len().to_string()),
    ];
    let input = holds_report(robot, &about, &model, &holds, WINDOW_S, provenance);
    let page = report::render(&input).map_err(CliError::job)?;
    let mut files = Files::default();
    files.put(&run.out, "stability.json", &format!("{document:#}\n"))?;
    files.put(&run.out, "stability.html", &page)?;
    if run.json {
        outln!("{document:#}");
    } else {
        let said = [&[input.headline.sentence.clone()][..], &input.headline.reasons].concat();
        out!("{}", text(&said.join("\n"), &holds));
        outln!("\nFiles:");
        for path in &files.paths {
            outln!("  {}", path.display());
        }
    }
    Ok(if still { Exit::Done } else { Exit::NotTrusted })
}

/// The model from which the TCP is computed: the one that a run left in `out`, else the nominal
/// one.
fn model(prepared: &PreparedRun, out: &Path) -> Result<(String, Chain), CliError> {
    let path = out.join("calibrated.toml");
    if path.exists() {
        let model = robots::load(&path.display().to_string()).map_err(CliError::input)?;
        if model.robot.dof() == prepared.robot.dof() {
            let chain = Chain::new(&model.robot, &model.tool_in_table())?;
            return Ok(("calibrated".to_owned(), chain));
        }
    }
    Ok(("nominal".to_owned(), Chain::new(&prepared.robot, &prepared.tool)?))
}

/// The result for people.
fn text(sentence: &str, holds: &[Held]) -> String {
    let mut out = format!("{sentence}\n\n");
    out += "                      worst joint, 1 s mean (µrad)        TCP, 1 s mean (µm)\n";
    out += "  sphere pose  windows   noise   first  largest     noise   first  largest   drift/s  TCP within\n";
    for h in holds {
        let ratio = |j: &Stillness| j.first.abs() / j.noise.max(1e-12);
        let joint = h.joints_urad.iter().max_by(|a, b| ratio(a).total_cmp(&ratio(b)));
        let joint = joint.copied().unwrap_or_default();
        out += &format!(
            "  {:6} {:4}  {:7}  {:6.3}  {:6.3}  {:7.3}    {:6.3}  {:6.3}  {:7.3}  {:8.4}  {}\n",
            h.sphere,
            h.pose,
            h.windows,
            joint.noise,
            joint.first,
            joint.largest,
            h.tcp_um.noise,
            h.tcp_um.first,
            h.tcp_um.largest,
            h.tcp_um.drift_per_s,
            if h.within_noise { "yes" } else { "no" }
        );
    }
    out
}
