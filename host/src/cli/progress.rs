//! Live progress on stderr: a bar on a terminal, otherwise a line at intervals. And what a person enters there.

use std::io::IsTerminal as _;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use spherecal_campaign::{CampaignObserver, CampaignStage, Moved, Progress};
use spherecal_services::live::eta_s;
use spherecal_shared::protocol::host::Phase;

use super::out::errln;

/// Interval of the lines if there is no terminal.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// Says that the poses are being planned, from the first moment until it is dropped: on a terminal with
/// the time so far, otherwise in one line.
pub(super) struct Planning(ProgressBar);

impl Planning {
    /// Says so, unless `quiet`.
    pub(super) fn show(quiet: bool) -> Self {
        const WORDS: &str = "planning the poses";
        let bar = ProgressBar::hidden();
        if !quiet && std::io::stderr().is_terminal() {
            bar.set_draw_target(ProgressDrawTarget::stderr_with_hz(10));
            // The template is a constant that is known to parse.
            if let Ok(style) = ProgressStyle::with_template("{spinner:.cyan} {msg}  {elapsed}") {
                bar.set_style(style);
            }
            bar.set_message(WORDS);
            bar.enable_steady_tick(Duration::from_millis(200));
        } else if !quiet {
            errln!("{WORDS}");
        }
        Self(bar)
    }
}

impl Drop for Planning {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

/// Shows a campaign's progress.
pub struct ProgressView {
    bar: ProgressBar,
    terminal: bool,
    begun: Instant,
    last_line: Instant,
    last_draw: Option<Instant>,
    device_s: f64,
    /// What is counted: "pose".
    unit: &'static str,
    /// The operator who can move the plate, if someone is at the terminal.
    person: Option<TerminalOperator>,
    asked: Option<u32>,
}

impl ProgressView {
    /// A view of a campaign that counts its poses. It has shown nothing yet.
    pub fn new() -> Self {
        Self::of("pose")
    }

    /// A view of work that counts something else than poses: `unit`, in the singular.
    pub fn of(unit: &'static str) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let target = if terminal {
            ProgressDrawTarget::stderr_with_hz(10)
        } else {
            ProgressDrawTarget::hidden()
        };
        let bar = ProgressBar::with_draw_target(Some(0), target);
        // The template is a constant that is known to parse.
        if let Ok(style) = ProgressStyle::with_template(&format!(
            "{{prefix:.bold.cyan}} {{bar:24.cyan/dim}} {unit} {{pos}}/{{len}}  {{msg}}"
        )) {
            bar.set_style(style.progress_chars("━╸─"));
        }
        let now = Instant::now();
        Self {
            bar,
            terminal,
            begun: now,
            last_line: now,
            last_draw: None,
            device_s: 0.0,
            unit,
            person: std::io::stdin().is_terminal().then(TerminalOperator::default),
            asked: None,
        }
    }

    /// Takes the bar away.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }

    fn message(&self, p: &Progress) -> String {
        let wall = self.begun.elapsed().as_secs_f64();
        let factor = if wall > 0.1 { p.device_s / wall } else { 0.0 };
        let sphere = if p.sphere > 0 {
            format!("sphere {}, ", p.sphere)
        } else {
            String::new()
        };
        let faults = match p.faults {
            0 => String::new(),
            1 => ", 1 fault".to_owned(),
            n => format!(", {n} faults"),
        };
        let force = if p.force_is_vague {
            "force unknown near a singular posture".to_owned()
        } else {
            format!("{:.1} N", p.force_n)
        };
        format!(
            "{sphere}{}, {force}, {factor:.0}x real time, {}{faults}",
            phase_name(p.phase),
            remaining(p, wall)
        )
    }
}

impl Default for ProgressView {
    fn default() -> Self {
        Self::new()
    }
}

/// Time to go, from the poses done in this session.
fn remaining(p: &Progress, wall_s: f64) -> String {
    let Some(left) = eta_s(p, wall_s) else {
        return "ETA -:--".to_owned();
    };
    let seconds = left.ceil() as u64;
    format!("ETA {}:{:02}", seconds / 60, seconds % 60)
}

fn stage_name(stage: CampaignStage) -> &'static str {
    match stage {
        CampaignStage::Connect => "connect",
        CampaignStage::Home => "home",
        CampaignStage::Plate => "plate",
        CampaignStage::Teach => "teach",
        CampaignStage::Approach => "approach",
        CampaignStage::Couple => "couple",
        CampaignStage::Poses => "record",
        CampaignStage::Decouple => "decouple",
        CampaignStage::Recover => "recover",
        CampaignStage::Done => "done",
    }
}

fn phase_name(phase: Phase) -> &'static str {
    match phase {
        Phase::Idle => "idle",
        Phase::Moving => "moving",
        Phase::Taring => "taring",
        Phase::Approaching => "descending",
        Phase::Coupling => "coupling",
        Phase::Verifying => "test pull",
        Phase::Coupled => "coupled",
        Phase::Turning => "turning",
        Phase::Recording => "recording",
        Phase::Decoupling => "decoupling",
        Phase::HandGuiding => "hand-guiding",
        Phase::Impedance => "impedance",
        Phase::Fault => "fault",
    }
}

impl CampaignObserver for ProgressView {
    fn progress(&mut self, p: &Progress) {
        self.device_s = p.device_s;
        let now = Instant::now();
        if self.terminal {
            if self
                .last_draw
                .is_some_and(|last| now - last < Duration::from_millis(80))
            {
                return;
            }
            self.last_draw = Some(now);
            self.bar.set_length(p.poses as u64);
            self.bar.set_position(p.done as u64);
            self.bar.set_prefix(format!("{:8}", stage_name(p.stage)));
            self.bar.set_message(self.message(p));
        } else if now - self.last_line >= LINE_EVERY {
            self.last_line = now;
            errln!(
                "{}: {} {} of {}, {}",
                stage_name(p.stage),
                self.unit,
                p.done,
                p.poses,
                self.message(p)
            );
        }
    }

    fn plate(&mut self, place: u32) -> Moved {
        let Some(person) = &mut self.person else {
            return Moved::Nobody;
        };
        if self.asked != Some(place) {
            self.asked = Some(place);
            while person.entered() {}
            self.bar.suspend(|| {
                errln!(
                    "The arm holds at home. Move the plate to placement {} and press Enter.",
                    place + 1
                );
            });
            return Moved::NotYet;
        }
        if person.entered() { Moved::Yes } else { Moved::NotYet }
    }

    fn note(&mut self, text: &str) {
        if self.terminal {
            self.bar.println(text);
        } else {
            errln!("{text}");
        }
    }
}

/// What the terminal gave since the last call.
pub(super) enum Entered {
    /// No line.
    Nothing,
    /// A line, with its line end.
    Line(String),
    /// The terminal is closed: no line will follow.
    Closed,
}

/// The operator at this terminal. A separate thread reads the keyboard, so that the control of the
/// arm never waits for it.
#[derive(Default)]
pub(super) struct TerminalOperator {
    lines: Option<Receiver<String>>,
}

impl TerminalOperator {
    /// Whether a line was entered since the last call.
    pub(super) fn entered(&mut self) -> bool {
        matches!(self.line(), Entered::Line(_))
    }

    pub(super) fn line(&mut self) -> Entered {
        let lines = self.lines.get_or_insert_with(|| {
            let (told, lines) = channel();
            std::thread::spawn(move || {
                let mut line = String::new();
                // A closed stdin is not a confirmation.
                while std::io::stdin().read_line(&mut line).is_ok_and(|count| count > 0) {
                    if told.send(std::mem::take(&mut line)).is_err() {
                        break;
                    }
                }
            });
            lines
        });
        match lines.try_recv() {
            Ok(line) => Entered::Line(line),
            Err(TryRecvError::Empty) => Entered::Nothing,
            Err(TryRecvError::Disconnected) => Entered::Closed,
        }
    }
}
