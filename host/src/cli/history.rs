//! `spherecal history` and `spherecal trend`: past calibrations.

use std::path::PathBuf;

use clap::Args;

use super::args::BadValue;
use super::exit::{CliError, Exit};
use super::out::{out, outln};
use spherecal_job::open_store;
use spherecal_model::printable;
use spherecal_store::StoreLocation;
use spherecal_store::history::{self, Past, Trend};

/// Arguments of `history`.
#[derive(Args, Clone, Debug)]
pub struct HistoryArgs {
    /// Folder with calibration.db. Used if --store is not given.
    #[arg(long, value_name = "DIR", default_value = "spherecal-out")]
    pub out: PathBuf,
    /// Database: a file, postgres://USER@HOST/DATABASE or grpc:HOST:PORT.
    #[arg(long, value_name = "STORE", value_parser = super::args::StoreParser)]
    pub store: Option<StoreLocation>,
    /// Only this arm.
    #[arg(long, value_name = "NAME", default_value = "")]
    pub arm: String,
    /// Print one JSON document on stdout and nothing else.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `trend`.
#[derive(Args, Clone, Debug)]
pub struct TrendArgs {
    #[command(flatten)]
    history: HistoryArgs,
    /// How far an arm may move, in mm, before it must be calibrated again.
    #[arg(long, value_name = "MM", default_value_t = history::LIMIT_MM, value_parser = positive)]
    limit_mm: f64,
}

fn positive(text: &str) -> Result<f64, BadValue> {
    let value: f64 = text.parse().map_err(|_| BadValue("give a number of mm"))?;
    if value > 0.0 && value.is_finite() {
        Ok(value)
    } else {
        Err(BadValue("give a positive number of mm"))
    }
}

fn past(args: &HistoryArgs) -> Result<Vec<Past>, CliError> {
    let file = StoreLocation::File(args.out.join("calibration.db"));
    let mut store = open_store(args.store.as_ref().unwrap_or(&file), false)?;
    Ok(history::read(store.as_mut(), &args.arm)?)
}

/// A number, or a dash.
fn number(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |v| format!("{v:.3}"))
}

/// `spherecal history`
pub(super) fn history(args: &HistoryArgs) -> Result<Exit, CliError> {
    let past = past(args)?;
    if args.json {
        outln!("{:#}", serde_json::json!({ "runs": past }));
        return Ok(Exit::Done);
    }
    outln!(
        "{:>5}  {:20}  {:10}  {:12}  {:8}  {:>7}  {:>6}  {:>8}  {:>8}  {:>8}",
        "run",
        "begun",
        "robot",
        "arm",
        "state",
        "trusted",
        "poses",
        "rms/mm",
        "before",
        "after/mm"
    );
    for p in &past {
        let trusted = p.trusted.map_or("-", |t| if t { "yes" } else { "no" });
        outln!(
            "{:>5}  {:20}  {:10}  {:12}  {:8}  {trusted:>7}  {:>6}  {:>8}  {:>8}  {:>8}",
            p.run,
            p.created_utc,
            p.robot,
            if p.arm.is_empty() {
                "-".into()
            } else {
                printable(&p.arm)
            },
            p.state,
            p.recorded.map_or_else(|| "-".to_owned(), |n| n.to_string()),
            number(p.residual_rms_mm),
            number(p.nominal_mm),
            number(p.calibrated_mm),
        );
    }
    Ok(Exit::Done)
}

/// `spherecal trend`
pub(super) fn trend(args: &TrendArgs) -> Result<Exit, CliError> {
    let past = past(&args.history)?;
    let trends: Vec<Trend> = history::by_arm(past)
        .iter()
        .filter_map(|own| history::trend(own, args.limit_mm))
        .collect();
    if args.history.json {
        outln!("{:#}", serde_json::json!({ "trends": trends }));
    } else if trends.is_empty() {
        outln!("No trusted calibration is stored yet: run `spherecal run --arm NAME`.");
    } else {
        for trend in &trends {
            out!("{}", text(trend));
        }
    }
    Ok(Exit::Done)
}

fn text(trend: &Trend) -> String {
    let arm = if trend.arm.is_empty() {
        "(not named)".into()
    } else {
        printable(&trend.arm)
    };
    let mut out = format!("{} {arm}: {} calibrations\n", trend.robot, trend.steps.len());
    for step in &trend.steps {
        out.push_str(&format!(
            "  run {:>4}, day {:8.2}: moved {:.3} mm since the first (1 sigma {:.3}), {:.3} mm since the last\n",
            step.run, step.days, step.moved_mm, step.sigma_mm, step.moved_since_last_mm
        ));
    }
    if let Some(run) = trend.clock_back_at {
        out.push_str(&format!(
            "  Run {run} is dated before the run that was measured before it: the clock of a computer was wrong. No speed \
             and no date are stated; set the clock, and measure again to state them.\n"
        ));
    }
    let sigma_mm = trend.steps.last().map_or(0.0, |step| step.sigma_mm);
    out.push_str(&match (trend.drifting, trend.can_tell) {
        (true, _) => "  It is drifting".to_owned(),
        (false, true) => "  No drift beyond the uncertainty of the calibrations".to_owned(),
        (false, false) if trend.steps.len() < 2 => {
            "  Cannot tell yet whether it drifts: this is the first calibration".to_owned()
        }
        (false, false) => format!(
            "  Cannot tell yet whether it drifts: 3 sigma of the calibrations is {:.3} mm, more than the limit; give more \
             poses",
            3.0 * sigma_mm
        ),
    });
    if let (true, Some(speed)) = (trend.drifting, trend.mm_per_year) {
        out.push_str(&format!(", {speed:.2} mm a year"));
    }
    if trend.due_utc.is_none() {
        out.push_str(".\n");
    }
    if let Some(due) = &trend.due_utc {
        out.push_str(&format!(
            ". Next calibration due {} (limit {} mm, after one year at most).\n",
            due.split('T').next().unwrap_or(due),
            trend.limit_mm
        ));
    }
    out
}
