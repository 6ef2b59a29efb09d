//! Progress of an identification on stderr: a bar on a terminal, otherwise a line at intervals.

use std::io::IsTerminal as _;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use spherecal_identify::evaluate;
use spherecal_identify::study::StudyStep;

use super::out::errln;

/// Interval of the lines if there is no terminal.
const LINE_EVERY: Duration = Duration::from_secs(5);
/// Number of rows above which the fit takes long enough to be announced.
const MANY: usize = 10_000;

/// Shows how far a calibration from files has come.
pub(super) struct StudyProgress {
    bar: ProgressBar,
    terminal: bool,
    last_line: Instant,
}

impl StudyProgress {
    /// A view that has shown nothing yet.
    pub(super) fn new() -> Self {
        let terminal = std::io::stderr().is_terminal();
        let target = if terminal {
            ProgressDrawTarget::stderr_with_hz(10)
        } else {
            ProgressDrawTarget::hidden()
        };
        let bar = ProgressBar::with_draw_target(None, target);
        // The template is a constant that is known to parse.
        if let Ok(style) = ProgressStyle::with_template("{spinner:.cyan} {msg}  {elapsed}") {
            bar.set_style(style);
        }
        bar.enable_steady_tick(Duration::from_millis(200));
        Self {
            bar,
            terminal,
            last_line: Instant::now(),
        }
    }

    pub(super) fn show(&mut self, step: StudyStep) {
        let (words, now) = match step {
            StudyStep::Reading(p) => {
                let share = match p.total_bytes {
                    0 => String::new(),
                    total => format!(", {:.0} %", 100.0 * p.bytes as f64 / total as f64),
                };
                (format!("reading: {} rows{share}", p.rows), false)
            }
            StudyStep::Evaluating(evaluate::EvaluationStep::Fitting { rows }) => {
                (format!("fitting {rows} rows"), rows >= MANY)
            }
            StudyStep::Evaluating(evaluate::EvaluationStep::Comparing { estimator }) => {
                (format!("comparing with {estimator}"), false)
            }
            StudyStep::Evaluating(evaluate::EvaluationStep::Judging { fits, rows }) => {
                let fits = if fits == 1 {
                    "the fit".to_owned()
                } else {
                    format!("{fits} fits")
                };
                (format!("judging {fits} by {rows} rows"), rows >= MANY)
            }
        };
        if !self.terminal && (now || self.last_line.elapsed() >= LINE_EVERY) {
            errln!("{words}");
            self.last_line = Instant::now();
        }
        self.bar.set_message(words);
    }

    /// Takes the bar away, as does dropping it.
    pub(super) fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

impl Drop for StudyProgress {
    fn drop(&mut self) {
        self.finish();
    }
}
