//! Changes the messages between controller and drive while faults are active: commands down, states
//! up.

use rand::RngExt;
use spherecal_shared::protocol::drive::{DriveCommand, DriveMessage, DriveState, DriveStatus};
use spherecal_shared::protocol::frame::{MAX_FRAME, encode};

use super::fault::{InjectedFault, NotReadyStatus};
use super::faulty_cell::{FaultyCell, PATIENCE};

impl FaultyCell {
    /// The command that reaches the motors; none while the brakes are closed.
    pub(super) fn delivered(&self) -> Option<DriveCommand> {
        if self.unanswered > PATIENCE {
            return None;
        }
        let mut command = self.command.clone()?;
        for what in &self.active {
            match *what {
                InjectedFault::DriveStatus { .. } => return None,
                InjectedFault::TorqueSaturation { joint, nm } => {
                    if let Some(tau) = command.tau.get_mut(joint - 1) {
                        *tau = tau.max(-nm).min(nm);
                    }
                }
                _ => {}
            }
        }
        Some(command)
    }

    /// The drive's state that the controller receives; `None` if it receives none.
    pub(super) fn heard(&mut self) -> Option<DriveState> {
        let mut state = self.state.clone();
        let mut arrives = true;
        let mut late = false;
        for k in 0..self.active.len() {
            match self.active[k] {
                InjectedFault::StateFrozen => {
                    if let Some(told) = &self.told {
                        state = DriveState {
                            tick: state.tick,
                            ..told.clone()
                        };
                    }
                }
                InjectedFault::StateRepeated => state = self.told.clone().unwrap_or(state),
                InjectedFault::StateLate { ticks } => {
                    late = true;
                    self.queue.push_back(state);
                    let due = self.queue.len() > ticks as usize;
                    let front = due.then(|| self.queue.pop_front()).flatten();
                    arrives &= front.is_some();
                    state = front.unwrap_or_else(|| self.state.clone());
                }
                InjectedFault::StateDropped => arrives = false,
                InjectedFault::StateNan { joint } => {
                    if let Some(q) = state.q.get_mut(joint - 1) {
                        *q = f64::NAN;
                    }
                }
                InjectedFault::PositionJump { joint, rad } => {
                    if let Some(q) = state.q.get_mut(joint - 1) {
                        *q += rad;
                    }
                }
                InjectedFault::DriveStatus { status } => {
                    state.status = match status {
                        NotReadyStatus::Disabled => DriveStatus::Disabled,
                        NotReadyStatus::EmergencyStop => DriveStatus::EmergencyStop,
                        NotReadyStatus::Failed => DriveStatus::Failed,
                    }
                }
                InjectedFault::StateBits { bits } => match self.over_the_wire(&state, bits) {
                    Some(received) => state = received,
                    None => arrives = false,
                },
                _ => {}
            }
        }
        if !late {
            self.queue.clear();
        }
        arrives.then_some(state)
    }

    /// A state as a frame with a number of flipped bits, and what a receiver decodes from it.
    fn over_the_wire(&mut self, state: &DriveState, bits: u32) -> Option<DriveState> {
        let mut bytes = [0; MAX_FRAME];
        let length = encode(state, self.frames, 0, &mut bytes).ok()?;
        self.frames = self.frames.wrapping_add(1);
        let frame = bytes.get_mut(..length)?;
        for _ in 0..bits {
            let at = self.rng.random_range(0..frame.len());
            frame[at] ^= 1 << self.rng.random_range(0..8);
        }
        let mut received = None;
        self.receiver.receive(frame, &mut |message| {
            if let DriveMessage::State { state, .. } = message {
                received = Some(state);
            }
        });
        received
    }
}
