//! One client of the robot side: what it sent, and what waits for it.

use std::sync::Arc;

use spherecal_cyclic::{Stream, Wire};

use crate::wire::{Answer, FieldType, Recipe};

pub(super) struct Wanted {
    pub(super) fields: Vec<(String, FieldType)>,
    /// Periods between two data packages.
    pub(super) every: u64,
}

/// A client of RTDE.
pub(super) struct Session {
    pub(super) number: u64,
    pub(super) wire: Wire,
    /// Protocol 2 is agreed.
    pub(super) agreed: bool,
    pub(super) outputs: Option<Wanted>,
    pub(super) inputs: Vec<Arc<Recipe>>,
    pub(super) started: bool,
}

impl Session {
    pub(super) fn new(number: u64, stream: Box<dyn Stream>) -> Self {
        Self {
            number,
            wire: Wire::new(stream),
            agreed: false,
            outputs: None,
            inputs: Vec::new(),
            started: false,
        }
    }

    pub(super) fn answer(&mut self, answer: &Answer) {
        self.wire.send(&answer.encode());
    }
}
