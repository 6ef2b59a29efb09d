//! `spherecal commission`: the first run on a robot, step by step, with a person at the robot.

use std::io::IsTerminal as _;

use clap::Args;
use spherecal_campaign::CampaignObserver;
use spherecal_campaign::commission::{Attendant, CommissioningStep, Figure, Judgement, StepReport};
use spherecal_job::{self as job, Commissioning, JobError, Link};
use spherecal_link::JournalError;

use super::args::RunArgs;
use super::exit::{CliError, Exit, interrupt, unwritten};
use super::features;
use super::out::{errln, outln};
use super::progress::{Entered, TerminalOperator};

/// Commission a robot: its first run, in five steps, with a person at the robot.
///
/// 1 read only: angles, sign of the torques, gravity of each joint, load at the flange; nothing is commanded.
/// 2 zero stiffness: the arm is held against gravity without springs.
/// 3 soft hold: it holds its place with soft springs.
/// 4 free motion: each joint turns by about 6 degrees and back, at a tenth of the speed.
/// 5 one contact: the nest touches sphere 1, couples, and leaves it.
///
/// Each step says what to expect, states what it measured beside its limit, and begins only after a typed yes. A step
/// that fails or cannot tell, or a no, ends the procedure; the arm then holds, or its brakes are closed. Keep your hand on the emergency
/// stop from step 2 on. The reports are kept in the database. It has not been tried on a robot yet.
#[derive(Args, Clone, Debug)]
#[command(
    after_help = "Examples: spherecal commission --link franka:172.16.0.2 --config cell.toml --out cell-4\n          \
    spherecal commission --show --out cell-4\n          \
    spherecal commission --link sim      to see what it asks, without a robot\n\n\
    Exit codes: 0 every step passed; 1 a step failed, could not tell or was declined, or the link failed; 2 wrong input, or nobody at the \
    terminal."
)]
pub struct CommissionArgs {
    #[command(flatten)]
    pub(super) run: RunArgs,
    /// Print the commissionings that the database holds (those of --arm, if it is given), and do nothing else.
    #[arg(long)]
    pub(super) show: bool,
}

#[derive(Default)]
struct Person {
    operator: TerminalOperator,
    question: String,
}

impl Attendant for Person {
    fn tell(&mut self, text: &str) {
        errln!("{text}");
    }

    fn ask(&mut self, question: &str) {
        // What was typed before the question is no answer to it.
        while self.operator.entered() {}
        question.clone_into(&mut self.question);
        errln!("{question} Type yes or no, and press Enter:");
    }

    fn answer(&mut self) -> Option<bool> {
        let text = match self.operator.line() {
            Entered::Nothing => return None,
            // A terminal that was closed agrees to nothing.
            Entered::Closed => return Some(false),
            Entered::Line(text) => text,
        };
        match text.trim().to_lowercase().as_str() {
            "yes" => Some(true),
            "no" | "n" => Some(false),
            _ => {
                errln!("{} Type yes or no, and press Enter:", self.question);
                None
            }
        }
    }

    fn done(&mut self, report: &StepReport) -> Result<(), JournalError> {
        for line in lines(report) {
            errln!("{line}");
        }
        errln!("");
        Ok(())
    }
}

/// Remarks of the campaign, on stderr.
struct Remarks;

impl CampaignObserver for Remarks {
    fn note(&mut self, text: &str) {
        errln!("  {text}");
    }
}

fn lines(report: &StepReport) -> Vec<String> {
    let number = CommissioningStep::ALL
        .iter()
        .position(|s| *s == report.step)
        .unwrap_or_default()
        + 1;
    let mut lines = vec![format!(
        "Step {number} of {}, {}: {}",
        CommissioningStep::ALL.len(),
        report.step.name(),
        report.verdict.words()
    )];
    if !report.ended_utc.is_empty() {
        lines[0] += &format!(" ({})", report.ended_utc);
    }
    lines.extend(report.figures.iter().map(figure));
    lines.extend(report.remarks.iter().map(|remark| format!("  {remark}")));
    lines
}

fn figure(figure: &Figure) -> String {
    let value = match figure.value {
        Some(value) if value.fract() == 0.0 => format!("{value:.0}"),
        Some(value) => format!("{value:.2}"),
        None => "cannot tell".to_owned(),
    };
    let unit = if figure.value.is_some() {
        figure.unit.as_str()
    } else {
        ""
    };
    let limit = figure.limit.map_or(String::new(), |l| format!("  (limit {l:.2})"));
    let beyond = if figure.judgement() == Judgement::Beyond {
        "  BEYOND THE LIMIT"
    } else {
        ""
    };
    format!("  {:52} {value:>11} {unit:5}{limit}{beyond}", figure.name)
        .trim_end()
        .to_owned()
}

fn show(args: &RunArgs) -> Result<Exit, CliError> {
    let mut store = job::open_store(&args.database(), false)?;
    let found = job::commissionings(store.as_mut(), args.arm.as_deref().unwrap_or_default())?;
    if args.json {
        outln!(
            "{:#}",
            serde_json::json!({"command": "commission", "commissionings": found})
        );
        return Ok(Exit::Done);
    }
    if found.is_empty() {
        outln!("{} holds no commissioning", store.path().display());
    }
    for one in &found {
        let run = one.run.unwrap_or_default();
        let (arm, simulated) = (if one.arm.is_empty() { "-" } else { &one.arm }, simulated(one));
        outln!(
            "Run {run}, {}: {} (arm {arm}) over {}{simulated}",
            one.created_utc,
            one.robot,
            one.link
        );
        one.steps.iter().flat_map(lines).for_each(|line| outln!("{line}"));
        outln!("{}\n", outcome(one));
    }
    Ok(Exit::Done)
}

fn simulated(found: &Commissioning) -> &'static str {
    if found.simulated { ", SIMULATED" } else { "" }
}

fn outcome(found: &Commissioning) -> &'static str {
    if found.passed() {
        "Every step passed."
    } else {
        "Not commissioned: not every step passed."
    }
}

pub(super) fn run(args: &CommissionArgs) -> Result<Exit, CliError> {
    let show_only = args.show;
    let args = &args.run;
    if show_only {
        return show(args);
    }
    if args.resume {
        return Err(CliError::input(
            "--resume: `spherecal commission` always begins with its first step: leave the option out",
        ));
    }
    if !matches!(
        args.link,
        Link::Sim | Link::Tcp(_) | Link::Franka { .. } | Link::Fri(_) | Link::Ur { .. }
    ) {
        return Err(JobError::NotCommissioned {
            link: args.link.to_string(),
        }
        .into());
    }
    if !std::io::stdin().is_terminal() {
        return Err(CliError::input(
            "`spherecal commission` needs a person at the robot, and the standard input is not a terminal: run it in a \
             terminal beside the robot. No option answers in the person's place",
        ));
    }
    features::check_run(args)?;
    let interrupt = interrupt()?;
    let prepared = args.prepare()?;
    std::fs::create_dir_all(&args.out).map_err(unwritten(&args.out))?;
    let mut store = job::open_store(&args.database(), true)?;
    errln!(
        "Commissioning of {} over {}: five steps. The first commands nothing.\n",
        prepared.robot.name,
        args.link
    );
    if matches!(args.link, Link::Fri(_)) {
        errln!(
            "Start the application on the cabinet now. Answer the question on its smartPAD only after your yes to step 2: you \
             have 45 s then.\n"
        );
    }
    let found = job::commission(
        &prepared,
        &args.link,
        &args.out,
        store.as_mut(),
        &mut Person::default(),
        &mut Remarks,
        &interrupt,
    )?;
    if args.json {
        let document = serde_json::json!({"command": "commission", "passed": found.passed(), "commissioning": found});
        outln!("{document:#}");
    } else {
        let simulated = if found.simulated { " The arm is SIMULATED." } else { "" };
        outln!("{}{simulated}", outcome(&found));
        if found.passed() {
            outln!(
                "\nNext: spherecal run --link {} --out {}",
                args.link,
                args.out.display()
            );
        }
    }
    Ok(if found.passed() { Exit::Done } else { Exit::Failed })
}
