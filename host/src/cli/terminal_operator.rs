//! The operator at this terminal, who leads the arm or moves the plate and confirms with the Enter
//! key.

use std::sync::mpsc::{Receiver, channel};

/// The operator at this terminal. A separate thread reads the keyboard, so that the control of the
/// arm never waits for it.
#[derive(Default)]
pub(super) struct TerminalOperator {
    lines: Option<Receiver<()>>,
}

impl TerminalOperator {
    /// Whether a line was entered since the last call.
    pub(super) fn entered(&mut self) -> bool {
        let lines = self.lines.get_or_insert_with(|| {
            let (told, lines) = channel();
            std::thread::spawn(move || {
                let mut line = String::new();
                // A closed stdin is not a confirmation.
                while std::io::stdin().read_line(&mut line).is_ok_and(|count| count > 0) {
                    if told.send(()).is_err() {
                        break;
                    }
                }
            });
            lines
        });
        lines.try_recv().is_ok()
    }
}
