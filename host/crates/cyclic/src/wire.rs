//! A robot side's connection with one client.

use std::io::ErrorKind;

use super::Stream;
use spherecal_budget::robot::{TAKEN_BYTES, WAITING_BYTES};

/// A robot side's connection with one client: both directions without waiting, and with a bounded memory.
#[derive(Debug)]
pub struct Wire {
    stream: Box<dyn Stream>,
    /// What has come and was not taken.
    pub received: Vec<u8>,
    waiting: Vec<u8>,
    alive: bool,
    /// The connection ends when everything is sent.
    ends: bool,
}

impl Wire {
    /// A connection with nothing sent or received.
    pub fn new(stream: Box<dyn Stream>) -> Self {
        Self {
            stream,
            received: Vec::new(),
            waiting: Vec::new(),
            alive: true,
            ends: false,
        }
    }

    /// Takes what has come and sends what waits. Whether the connection still stands.
    pub fn poll(&mut self) -> bool {
        self.flush();
        let mut part = [0; 4096];
        while self.alive && self.received.len() < TAKEN_BYTES {
            match self.stream.read(&mut part) {
                Ok(0) => self.alive = false,
                Ok(count) => self.received.extend_from_slice(&part[..count]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => self.alive = false,
            }
        }
        if self.ends && self.waiting.is_empty() {
            self.close();
        }
        self.alive
    }

    /// Sends these bytes as soon as the client takes them. A client that does not loses its connection.
    pub fn send(&mut self, bytes: &[u8]) {
        self.waiting.extend_from_slice(bytes);
        self.flush();
        if self.waiting.len() > WAITING_BYTES {
            self.close();
        }
    }

    fn flush(&mut self) {
        while self.alive && !self.waiting.is_empty() {
            match self.stream.write(&self.waiting) {
                Ok(0) => self.alive = false,
                Ok(count) => drop(self.waiting.drain(..count)),
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => self.alive = false,
            }
        }
    }

    /// Ends the connection as soon as everything is sent.
    pub fn finish(&mut self) {
        self.ends = true;
    }

    /// Whether it is about to end.
    pub fn ends(&self) -> bool {
        self.ends
    }

    /// Ends the connection now.
    pub fn close(&mut self) {
        self.alive = false;
        self.stream.close();
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Result, Write};
    use std::time::Duration;

    use super::*;

    /// A client that reads `room` more bytes and sends what is in `sent`.
    #[derive(Debug)]
    struct Slow {
        room: usize,
        sent: usize,
    }

    impl Read for Slow {
        fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
            let count = self.sent.min(buffer.len());
            self.sent -= count;
            if count == 0 {
                return Err(ErrorKind::WouldBlock.into());
            }
            Ok(count)
        }
    }

    impl Write for Slow {
        fn write(&mut self, bytes: &[u8]) -> Result<usize> {
            let count = self.room.min(bytes.len());
            self.room -= count;
            if count == 0 {
                return Err(ErrorKind::WouldBlock.into());
            }
            Ok(count)
        }

        fn flush(&mut self) -> Result<()> {
            Ok(())
        }
    }

    impl Stream for Slow {
        fn set_wait(&self, _: Option<Duration>) -> Result<()> {
            Ok(())
        }

        fn is_closed(&self) -> bool {
            false
        }

        fn close(&self) {}
    }

    // Fails if a client that does not read, or one that sends without end, makes the robot keep ever more bytes.
    #[test]
    fn a_slow_client_costs_a_bounded_memory() {
        let mut wire = Wire::new(Box::new(Slow {
            room: 1000,
            sent: usize::MAX,
        }));
        assert!(wire.poll());
        assert!((TAKEN_BYTES..TAKEN_BYTES + 4096).contains(&wire.received.len()));
        let mut sent = 0;
        while wire.alive {
            wire.send(&[0; 500]);
            sent += 500;
            assert!(sent <= WAITING_BYTES + 2000);
        }
        assert!(sent > WAITING_BYTES && !wire.poll());
    }
}
