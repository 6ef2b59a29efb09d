//! The operator at this terminal, who leads the arm or moves the plate and confirms with the Enter
//! key.

use std::sync::mpsc::{Receiver, TryRecvError, channel};

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
