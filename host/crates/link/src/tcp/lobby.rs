//! Peers that have connected and have not earned their place yet.
//!
//! ```text
//!   connection ─▶ greeted, waits ─▶ first valid frame ─▶ served
//!                     └ noise: closed   └ silence: keeps nobody out
//! ```
//!
//! A listener has one place. Whoever waits is greeted at once, and the first that sends a valid frame gets the place. So
//! a peer that connects and says nothing keeps nobody out, and one that sends noise costs its own connection alone.

use std::collections::VecDeque;
use std::io::Write as _;
use std::net::{SocketAddr, TcpListener, TcpStream};

use spherecal_shared::protocol::frame::MAX_FRAME;

use super::TcpError;
use super::progress::FrameWatch;
use super::stream::read_some;
use spherecal_budget::link::{WAITING, WAITING_FRAMES};

/// A peer that waits.
pub(super) struct Candidate {
    pub(super) stream: TcpStream,
    pub(super) address: SocketAddr,
    pub(super) bytes: Vec<u8>,
    watch: FrameWatch,
}

/// What a look at the waiting peers came to.
#[expect(clippy::large_enum_variant, reason = "it lives on the stack for one look")]
pub(super) enum Look {
    /// Nothing that matters.
    Nothing,
    /// One has sent a valid frame.
    Spoke(Candidate),
    /// One is gone; the reason if it did not close the connection itself.
    Left(Option<TcpError>),
}

/// The peers that wait at one listener.
pub(super) struct Lobby {
    who: &'static str,
    /// Key of the message that a peer is to send.
    key: Option<[u8; 8]>,
    waiting: VecDeque<Candidate>,
}

impl Lobby {
    /// Nobody waits. `who` names the peers; `key` is that of the message that they are to send, if it matters here.
    pub(super) fn new(who: &'static str, key: Option<[u8; 8]>) -> Self {
        Self {
            who,
            key,
            waiting: VecDeque::new(),
        }
    }

    /// Reads what those who wait have sent, and greets whoever has connected. Waits for nothing. In this order, a flood of
    /// connections does not close that of a peer whose frame has come.
    /// Errors: the listener fails.
    pub(super) fn look(&mut self, listener: &TcpListener, greeting: &[u8]) -> Result<Look, TcpError> {
        for number in 0..self.waiting.len() {
            let Some(candidate) = self.waiting.get_mut(number) else {
                break;
            };
            match candidate.read(self.who) {
                Ok(false) => {}
                Ok(true) => {
                    if let Some(candidate) = self.waiting.remove(number) {
                        return Ok(Look::Spoke(candidate));
                    }
                }
                Err(reason) => {
                    self.waiting.remove(number);
                    return Ok(Look::Left((!reason.is_closed()).then_some(reason)));
                }
            }
        }
        self.accept(listener, greeting)?;
        Ok(Look::Nothing)
    }

    /// The peer that has sent bytes for the longest time, although none of them is a valid frame.
    pub(super) fn first_that_sent(&mut self) -> Option<Candidate> {
        let number = self.waiting.iter().position(|one| !one.bytes.is_empty())?;
        self.waiting.remove(number)
    }

    /// The peer that has waited longest.
    pub(super) fn first(&mut self) -> Option<Candidate> {
        self.waiting.pop_front()
    }

    /// Closes the connections of all who wait: what they were greeted with is no longer true.
    pub(super) fn dismiss(&mut self) {
        self.waiting.clear();
    }

    fn accept(&mut self, listener: &TcpListener, greeting: &[u8]) -> Result<(), TcpError> {
        let failed = |error| TcpError::of(self.who, error);
        listener.set_nonblocking(true).map_err(failed)?;
        // So many in one look at most: a flood of connections must not keep the caller.
        for _ in 0..WAITING {
            // Nobody, a peer that is gone already, or no descriptor is free: the next look tries again.
            let Ok((mut stream, address)) = listener.accept() else {
                break;
            };
            // A fresh connection has room for a greeting.
            let greeted = stream
                .set_nonblocking(true)
                .and_then(|()| stream.set_nodelay(true))
                .and_then(|()| stream.write_all(greeting));
            if greeted.is_err() {
                continue;
            }
            if self.waiting.len() >= WAITING {
                self.waiting.pop_front();
            }
            self.waiting.push_back(Candidate::new(stream, address, self.key));
        }
        Ok(())
    }
}

impl Candidate {
    /// A peer that has been greeted and has sent nothing.
    pub(super) fn new(stream: TcpStream, address: SocketAddr, key: Option<[u8; 8]>) -> Self {
        Self {
            stream,
            address,
            bytes: Vec::new(),
            watch: FrameWatch::for_key(key),
        }
    }

    /// Reads what came; whether a valid frame is among it.
    fn read(&mut self, who: &str) -> Result<bool, TcpError> {
        let peer = || format!("{who} at {}", self.address);
        let mut buffer = [0; MAX_FRAME];
        let mut spoke = false;
        while !spoke {
            let count = read_some(&mut self.stream, &mut buffer).map_err(|e| TcpError::of(&peer(), e))?;
            if count == 0 {
                break;
            }
            let came = buffer.get(..count).unwrap_or_default();
            self.bytes.extend_from_slice(came);
            spoke = self.watch.look(came);
            if !spoke && self.bytes.len() > WAITING_FRAMES * MAX_FRAME {
                return Err(self.watch.progress.babble(&peer()));
            }
        }
        // A look that finds nothing allocates nothing: a controller in real time looks in every period.
        if self.watch.progress.is_babble() {
            return Err(self.watch.progress.babble(&peer()));
        }
        Ok(spoke)
    }
}

#[cfg(test)]
#[path = "lobby_tests.rs"]
mod tests;
