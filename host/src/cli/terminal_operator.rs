//! The person at this terminal, who leads the arm or moves the plate and says
//! so by the Enter key.

use std::sync::mpsc::{Receiver, channel};

/// A person at this terminal. The keyboard is read in a thread of its own, so
/// that the arm's time never waits for it.
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
                // A closed stdin is no word of the operator.
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
