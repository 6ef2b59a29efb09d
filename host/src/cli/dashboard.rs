//! `spherecal run --dashboard`: shows the run on the whole terminal, ten times per second.
//!
//! ```text
//!   ┌ iiwa7 · record · recording ──────────────────────────────┐
//!   │ poses  ████████████░░░░░░░░ 84 of 150, ETA 0:12          │
//!   │ force  ██████░░░░░░░░░░░░░░ 3.1 N of 7.5 N               │
//!   ├ joints ──────────────────────────────────────────────────┤
//!   │ 1  -12.4°  ·····█···········   0.8°/s   12.1 N m         │
//!   ├ so far ──────────────────────────────────────────────────┤
//! ```
//!
//! It draws on the alternate screen of stderr and restores the terminal at the end. Keys keep their
//! usual meaning, so Ctrl-C stops the run.

use std::collections::VecDeque;
use std::io::{IsTerminal as _, Stderr, stderr};
use std::time::{Duration, Instant};

use ratatui::Terminal;
use ratatui::backend::CrosstermBackend;
use ratatui::buffer::Buffer;
use ratatui::crossterm::cursor::{Hide, Show};
use ratatui::crossterm::execute;
use ratatui::crossterm::terminal::{EnterAlternateScreen, LeaveAlternateScreen};
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Style, Stylize as _};
use ratatui::text::Line;
use ratatui::widgets::{Block, Gauge, Paragraph, Sparkline, Widget, Wrap};
use spherecal_shared::protocol::host::{Event, Sample};
use spherecal_shared::robot::{Robot, Tool};

use super::progress::{phase_name, remaining, stage_name};
use spherecal_campaign::{CampaignObserver, Progress};
use spherecal_link::Arrival;
use spherecal_services::live::Scatter;

/// Time between two pictures.
const PERIOD: Duration = Duration::from_millis(100);
/// Forces kept for the curve.
const FORCES: usize = 240;
/// Width of a joint's line without the bar.
const JOINT_NUMBERS: u16 = 35;
/// Width of the labels of the force's axis.
const FORCE_LABELS: u16 = 8;
/// What the keys do.
const KEYS: &str = " Ctrl-C ends the run where --resume continues it; a second Ctrl-C ends at once";
/// Remarks kept.
const NOTES: usize = 6;

/// What is on the screen.
struct Screen {
    robot: Robot,
    trigger_n: f64,
    progress: Progress,
    wall_s: f64,
    sample: Option<Sample>,
    /// Newest last, in tenths of a newton.
    forces: VecDeque<u64>,
    scatter: Scatter,
    notes: VecDeque<String>,
    coloured: bool,
}

impl Screen {
    fn style(&self, colour: Color) -> Style {
        if self.coloured {
            Style::new().fg(colour)
        } else {
            Style::new()
        }
    }

    /// One line per joint, `width` wide: angle, position in its range, speed, torque.
    fn joint(&self, number: usize, sample: &Sample, width: u16) -> Line<'static> {
        let at = |values: &[f32]| values.get(number).map_or(0.0, |v| f64::from(*v));
        let (q, dq, tau) = (at(&sample.q), at(&sample.dq), at(&sample.tau));
        let range = self.robot.joints.get(number).map(|j| &j.limits);
        let share = range.map_or(0.5, |l| (q - l.min_rad) / (l.max_rad - l.min_rad));
        let cells = usize::from(width.saturating_sub(JOINT_NUMBERS)).clamp(1, 60);
        let last = (cells - 1) as f64;
        let cell = (share * last).round().max(0.0).min(last) as usize;
        let bar: String = (0..cells).map(|k| if k == cell { '█' } else { '·' }).collect();
        Line::from(format!(
            " {} {:7.1}° {bar} {:6.1}°/s {:7.1} N m",
            number + 1,
            q.to_degrees(),
            dq.to_degrees(),
            tau
        ))
    }
}

impl Screen {
    /// The force over time with its axes: newest at the right, up to the larger of twice the trigger and what was seen.
    fn force_curve(&self, area: Rect, buffer: &mut Buffer) {
        let block = Block::bordered()
            .title(" contact force ")
            .title_bottom(Line::from(" earlier ").left_aligned())
            .title_bottom(Line::from(" now, 10 columns a second ").right_aligned());
        let inner = block.inner(area);
        block.render(area, buffer);
        let [labels, curve] = Layout::horizontal([Constraint::Length(FORCE_LABELS), Constraint::Min(1)]).areas(inner);
        let newest: Vec<u64> = self
            .forces
            .iter()
            .rev()
            .take(usize::from(curve.width))
            .rev()
            .copied()
            .collect();
        let trigger = if self.trigger_n.is_finite() {
            self.trigger_n
        } else {
            0.0
        };
        // In tenths of a newton, as the forces are.
        let most = newest
            .iter()
            .copied()
            .max()
            .unwrap_or(0)
            .max((20.0 * trigger).round() as u64)
            .max(1);
        let rows = usize::from(labels.height);
        let label = |row: usize| match row {
            0 => format!("{:5.1} N", most as f64 / 10.0),
            _ if row + 1 == rows => "  0.0 N".to_owned(),
            _ => String::new(),
        };
        Paragraph::new((0..rows).map(|row| Line::from(label(row))).collect::<Vec<_>>()).render(labels, buffer);
        Sparkline::default()
            .style(self.style(Color::Green))
            .max(most)
            .data(newest)
            .render(curve, buffer);
    }
}

/// A ratio within the range that a gauge accepts.
fn ratio(part: f64, whole: f64) -> f64 {
    let ratio = part / whole;
    if ratio.is_finite() {
        ratio.max(0.0).min(1.0)
    } else {
        0.0
    }
}

impl Widget for &Screen {
    fn render(self, area: Rect, buffer: &mut Buffer) {
        let p = &self.progress;
        let joints = self.robot.dof() as u16;
        let keys = if area.width > KEYS.len() as u16 { 1 } else { 2 };
        let [top, middle, curve, bottom, hints] = Layout::vertical([
            Constraint::Length(4),
            Constraint::Length(joints + 2),
            Constraint::Length(6),
            Constraint::Min(3),
            Constraint::Length(keys),
        ])
        .areas(area);
        Paragraph::new(KEYS)
            .wrap(Wrap { trim: true })
            .dim()
            .render(hints, buffer);
        let sphere = if p.sphere > 0 {
            format!(" · sphere {}", p.sphere)
        } else {
            String::new()
        };
        let title = format!(
            " {} · {} · {}{sphere} ",
            self.robot.name,
            stage_name(p.stage),
            phase_name(p.phase)
        );
        let block = Block::bordered().title(title.bold());
        let [poses, force] = Layout::vertical([Constraint::Length(1); 2]).areas(block.inner(top));
        block.render(top, buffer);
        Gauge::default()
            .gauge_style(self.style(Color::Cyan))
            .ratio(ratio(p.done as f64, p.poses as f64))
            .label(format!(
                "{} of {} poses, {}",
                p.done,
                p.poses,
                remaining(p, self.wall_s)
            ))
            .render(poses, buffer);
        let near = p.force_n > 0.8 * self.trigger_n;
        Gauge::default()
            .gauge_style(self.style(if near { Color::Yellow } else { Color::Green }))
            .ratio(ratio(p.force_n, 2.0 * self.trigger_n))
            .label(format!("{:.1} N of {:.1} N", p.force_n, self.trigger_n))
            .render(force, buffer);
        let lines: Vec<Line<'_>> = match &self.sample {
            Some(sample) => (0..self.robot.dof())
                .map(|k| self.joint(k, sample, middle.width.saturating_sub(2)))
                .collect(),
            None => vec![Line::from(" waiting for the controller")],
        };
        Paragraph::new(lines)
            .block(Block::bordered().title(" joints "))
            .render(middle, buffer);
        self.force_curve(curve, buffer);
        let residual = self
            .scatter
            .residual_mm()
            .map_or_else(|| "-".to_owned(), |mm| format!("{mm:.3} mm"));
        let mut lines = vec![Line::from(format!(
            " {} contacts, {} faults; residual of the nominal model {residual} (rms); {:.0} s of robot time, {:.0}x",
            self.scatter.contacts(),
            p.faults,
            p.device_s,
            if self.wall_s > 0.1 {
                p.device_s / self.wall_s
            } else {
                0.0
            }
        ))];
        lines.extend(self.notes.iter().map(|note| Line::from(format!(" {note}"))));
        Paragraph::new(lines)
            .wrap(Wrap { trim: true })
            .block(Block::bordered().title(" so far "))
            .render(bottom, buffer);
    }
}

/// The dashboard as an observer of a campaign.
pub(super) struct Dashboard {
    terminal: Option<Terminal<CrosstermBackend<Stderr>>>,
    screen: Screen,
    begun: Instant,
    drawn: Option<Instant>,
}

impl Dashboard {
    /// Takes the terminal; `None` if stderr is not a terminal.
    pub(super) fn start(robot: &Robot, tool: &Tool, trigger_n: f64) -> Option<Self> {
        if !stderr().is_terminal() {
            return None;
        }
        execute!(stderr(), EnterAlternateScreen, Hide).ok()?;
        let mut terminal = Terminal::new(CrosstermBackend::new(stderr())).ok();
        if let Some(terminal) = &mut terminal {
            // A terminal without an alternate screen still shows the earlier text.
            let _ = terminal.clear();
        }
        Some(Self {
            terminal,
            screen: screen(robot, tool, trigger_n),
            begun: Instant::now(),
            drawn: None,
        })
    }

    fn draw(&mut self) {
        let now = Instant::now();
        if self.drawn.is_some_and(|last| now - last < PERIOD) {
            return;
        }
        self.drawn = Some(now);
        let force = (self.screen.progress.force_n * 10.0).round().max(0.0) as u64;
        self.screen.forces.push_back(force);
        while self.screen.forces.len() > FORCES {
            self.screen.forces.pop_front();
        }
        self.screen.wall_s = self.begun.elapsed().as_secs_f64();
        if let Some(terminal) = &mut self.terminal {
            let screen = &self.screen;
            // A lost terminal does not stop a robot.
            let _ = terminal.draw(|frame| frame.render_widget(screen, frame.area()));
        }
    }

    /// Gives the terminal back.
    pub(super) fn finish(&mut self) {
        if self.terminal.take().is_some() {
            let _ = execute!(stderr(), LeaveAlternateScreen, Show);
        }
    }
}

fn screen(robot: &Robot, tool: &Tool, trigger_n: f64) -> Screen {
    Screen {
        robot: robot.clone(),
        trigger_n,
        progress: Progress::default(),
        wall_s: 0.0,
        sample: None,
        forces: VecDeque::new(),
        scatter: Scatter::new(robot, tool),
        notes: VecDeque::new(),
        coloured: std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty()),
    }
}

impl Drop for Dashboard {
    /// Also when a run fails.
    fn drop(&mut self) {
        self.finish();
    }
}

impl CampaignObserver for Dashboard {
    fn event(&mut self, _now_us: u64, arrival: &Arrival) {
        match &arrival.body {
            Event::Telemetry(samples) => self.screen.sample = samples.last().copied().or(self.screen.sample),
            Event::Contact(_) => self.screen.scatter.contact(),
            Event::Recording(recording) => self.screen.scatter.record(recording),
            _ => {}
        }
    }

    fn progress(&mut self, progress: &Progress) {
        self.screen.progress = *progress;
        self.draw();
    }

    fn note(&mut self, text: &str) {
        self.screen.notes.push_front(text.to_owned());
        self.screen.notes.truncate(NOTES);
        self.drawn = None;
        self.draw();
    }
}

#[cfg(test)]
#[path = "dashboard_tests.rs"]
mod tests;
