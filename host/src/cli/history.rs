//! `spherecal history` and `spherecal trend`: past calibrations.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::args::BadValue;
use super::exit::{CliError, Exit};
use super::out::{out, outln};
use spherecal_job::open_store;
use spherecal_model::printable;
use spherecal_store::StoreLocation;
use spherecal_store::history::{self, Past, Trend};
use spherecal_store::time::now_utc;

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
    /// Only arms whose next calibration is due.
    #[arg(long)]
    due: bool,
    /// Only arms that drift.
    #[arg(long)]
    drifting: bool,
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

fn number(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |v| format!("{v:.3}"))
}

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

#[derive(Serialize)]
struct TrendOfArm {
    #[serde(flatten)]
    trend: Trend,
    /// Whether the next calibration is due now.
    due: bool,
}

pub(super) fn trend(args: &TrendArgs) -> Result<Exit, CliError> {
    let now_utc = now_utc();
    let trends = history::trends(past(&args.history)?, args.limit_mm).into_iter();
    let all: Vec<TrendOfArm> = trends
        .map(|trend| TrendOfArm {
            due: trend.is_due(&now_utc),
            trend,
        })
        .collect();
    let count = |counts: fn(&TrendOfArm) -> bool| all.iter().filter(|arm| counts(arm)).count();
    let (arms, due, drifting) = (all.len(), count(|arm| arm.due), count(|arm| arm.trend.drifting));
    let wanted = |arm: &TrendOfArm| (arm.due || !args.due) && (arm.trend.drifting || !args.drifting);
    let shown: Vec<TrendOfArm> = all.into_iter().filter(wanted).collect();
    if args.history.json {
        let document = serde_json::json!({ "arms": arms, "due": due, "drifting": drifting, "trends": shown });
        outln!("{document:#}");
    } else if let ([one], 1) = (shown.as_slice(), arms) {
        out!("{}", text(&one.trend));
    } else if arms == 0 {
        outln!("No trusted calibration is stored yet: run `spherecal run --arm NAME`.");
    } else {
        outln!("Arms: {arms}; calibration due: {due}; drifting: {drifting}.");
        out!("{}", page(shown));
    }
    Ok(Exit::Done)
}

/// Arms of a page: as many as a terminal of 50 lines shows.
const ROWS: usize = 40;

/// The arms that a calibration is due of first, as a table.
fn page(mut arms: Vec<TrendOfArm>) -> String {
    if arms.is_empty() {
        return String::new();
    }
    // Arms without a date come first.
    arms.sort_by(|a, b| a.trend.due_utc.cmp(&b.trend.due_utc));
    let mut out = format!(
        "{:10}  {:16}  {:12}  {:>4}  {:>8}  {:>10}  {:>9}\n",
        "due", "arm", "robot", "runs", "moved/mm", "1 sigma/mm", "mm a year"
    );
    for TrendOfArm { trend, .. } in arms.iter().take(ROWS) {
        let last = trend.steps.last();
        let state = match (trend.clock_back_at, trend.drifting, trend.can_tell) {
            (Some(_), ..) => "  a clock was wrong",
            (_, true, _) => "  drifts",
            (_, _, false) => "  cannot tell yet",
            _ => "",
        };
        out.push_str(&format!(
            "{:10}  {:16}  {:12}  {:>4}  {:>8}  {:>10}  {:>9}{state}\n",
            trend
                .due_utc
                .as_deref()
                .map_or("-", |due| due.split('T').next().unwrap_or(due)),
            if trend.arm.is_empty() {
                "(not named)".into()
            } else {
                printable(&trend.arm)
            },
            trend.robot,
            trend.steps.len(),
            number(last.map(|step| step.moved_mm)),
            number(last.map(|step| step.sigma_mm)),
            number(trend.mm_per_year),
        ));
    }
    if arms.len() > ROWS {
        out.push_str(&format!(
            "and {} more: --due, --drifting and --arm NAME choose, --json prints all.\n",
            arms.len() - ROWS
        ));
    }
    out
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

#[cfg(test)]
mod tests {
    use super::*;

    fn arm(name: &str, due_utc: Option<&str>, drifting: bool) -> TrendOfArm {
        TrendOfArm {
            due: true,
            trend: Trend {
                robot: "iiwa7".to_owned(),
                arm: name.to_owned(),
                steps: Vec::new(),
                drifting,
                can_tell: true,
                mm_per_year: None,
                limit_mm: 0.3,
                due_utc: due_utc.map(str::to_owned),
                clock_back_at: due_utc.is_none().then_some(7),
            },
        }
    }

    // Fails if a fleet fills more than a page, if an arm that is due later stands before one that is due earlier or whose
    // date is unknown, or if it is not told that arms are left out.
    #[test]
    fn a_fleet_is_a_page_with_the_due_arms_first() {
        let date = |day: u32| format!("2026-{:02}-{:02}T00:00:00Z", day / 28 + 1, day % 28 + 1);
        let mut arms: Vec<TrendOfArm> = (0..100)
            .map(|k| arm(&format!("A-{k}"), Some(&date((k * 37) % 100)), k == 0))
            .collect();
        arms.push(arm("B", None, false));
        let text = page(arms);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), ROWS + 2);
        assert!(
            lines[1].contains(" B ") && lines[1].ends_with("a clock was wrong"),
            "{text}"
        );
        assert!(lines[2].contains("A-0 ") && lines[2].ends_with("drifts"), "{text}");
        assert!(lines[2..=ROWS].is_sorted_by_key(|line| &line[..10]), "{text}");
        assert!(lines[ROWS + 1].starts_with("and 61 more"), "{text}");
        assert_eq!(page(Vec::new()), "");
    }
}
