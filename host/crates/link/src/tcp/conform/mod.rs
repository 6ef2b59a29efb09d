//! Asks a foreign drive or controller for what the documents promise of it, sentence by sentence.
//!
//! Nothing here gives torque: every command to a drive has `enable` 0, and a controller is only told to stop. Each
//! sentence gets a connection of its own, so that one that does not hold spoils no other.

mod controller;
mod drive;
mod probe;
#[cfg(test)]
pub(super) mod tests;

pub use controller::of_controller;
pub use drive::of_drive;

/// A sentence of a document, and whether it holds for a peer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The document that has it.
    pub document: &'static str,
    /// The sentence.
    pub sentence: &'static str,
    /// What was seen, with bytes, where it does not hold.
    pub seen: Option<String>,
}

impl Finding {
    /// Whether it holds.
    pub fn holds(&self) -> bool {
        self.seen.is_none()
    }
}

/// A sentence, and how it is asked for. The error is what was seen in its place.
type Sentence = (&'static str, fn(&str) -> Result<(), String>);

fn ask(document: &'static str, sentences: &[Sentence], address: &str) -> Vec<Finding> {
    let one = |(sentence, ask): &Sentence| Finding {
        document,
        sentence,
        seen: ask(address).err(),
    };
    sentences.iter().map(one).collect()
}
