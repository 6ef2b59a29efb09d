//! The dashboard on screens of several sizes.

use super::*;
use ratatui::backend::TestBackend;
use spherecal_shared::protocol::host::Phase;
use spherecal_shared::robot::{iiwa7, iiwa7_tool};

fn shown(screen: &Screen, width: u16, height: u16) -> String {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).expect("a terminal");
    terminal
        .draw(|frame| frame.render_widget(screen, frame.area()))
        .expect("drawn");
    let buffer = terminal.backend().buffer().clone();
    let rows = buffer.content.chunks(usize::from(width));
    rows.map(|row| row.iter().map(ratatui::buffer::Cell::symbol).collect::<String>() + "\n")
        .collect()
}

fn busy() -> Screen {
    let mut screen = screen(&iiwa7(), &iiwa7_tool(), 7.5);
    screen.progress = Progress {
        phase: Phase::Recording,
        sphere: 2,
        spheres: 3,
        done: 84,
        poses: 150,
        force_n: 3.12,
        device_s: 300.0,
        ..Progress::default()
    };
    screen.wall_s = 10.0;
    let mut sample = Sample::default();
    sample.q[2] = 0.5;
    sample.tau[2] = 12.25;
    screen.sample = Some(sample);
    screen.notes.push_front("sphere 2: recovering".to_owned());
    screen
}

// Fails if phase, poses, remaining time, force, a joint, or a remark is missing on the screen.
#[test]
fn everything_is_on_the_screen() {
    let text = shown(&busy(), 100, 30);
    for words in [
        "iiwa7",
        "recording",
        "sphere 2",
        "84 of 150 poses, ETA 0:08",
        "3.1 N of 7.5 N",
        "28.6°",
        "12.2 N m",
        "0 contacts, 0 faults",
        "30x",
        "recovering",
    ] {
        assert!(text.contains(words), "no \"{words}\" in\n{text}");
    }
}

// Fails if a line is cut at 60 columns, a remark is not wrapped at a word, or the force has no scale and the keys no
// hint.
#[test]
fn nothing_is_cut_at_sixty_columns() {
    let mut screen = busy();
    screen.notes.clear();
    screen
        .notes
        .push_front("sphere 2: the nest was not seated, and it is touched again from its waypoint".to_owned());
    screen.forces.extend([10, 40, 120]);
    let text = shown(&screen, 60, 30);
    for words in [
        "12.2 N m │",
        "15.0 N",
        "0.0 N",
        "earlier",
        "now",
        "touched again",
        "its waypoint",
        "(rms)",
        "at once",
    ] {
        assert!(text.contains(words), "no \"{words}\" in\n{text}");
    }
    let plain = text.replace(['│', '\n'], " ");
    let words = plain.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(
        words.contains("the nest was not seated, and it is touched again from its waypoint"),
        "{text}"
    );
}

// Fails if a small terminal, or one of no size, ends the run.
#[test]
fn any_terminal_will_do() {
    for (width, height) in [(1, 1), (20, 5), (40, 12), (300, 80)] {
        shown(&busy(), width, height);
    }
    let mut empty = busy();
    empty.progress = Progress::default();
    empty.progress.force_n = f64::NAN;
    shown(&empty, 80, 24);
}
