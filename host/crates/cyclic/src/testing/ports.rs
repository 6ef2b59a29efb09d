//! Ports and connections of a [`World`].

use std::cell::Cell;
use std::collections::VecDeque;
use std::io::{Error, ErrorKind, Read, Result, Write};
use std::net::SocketAddr;
use std::time::{Duration, Instant};

use super::world::{Connection, Event, State, World, local};
use crate::machine::{Datagrams, Listener, Machine, Process, Running, Stream};

#[derive(Debug)]
pub(super) struct Port {
    world: World,
    at: SocketAddr,
    wait: Cell<Option<Duration>>,
}

impl Port {
    pub(super) fn new(world: World, at: SocketAddr) -> Self {
        let wait = Cell::new(None);
        Self { world, at, wait }
    }
}

impl Datagrams for Port {
    fn address(&self) -> Result<SocketAddr> {
        Ok(self.at)
    }

    fn send(&self, bytes: &[u8], to: SocketAddr) -> Result<()> {
        self.world.send(self.at.port(), to.port(), bytes);
        Ok(())
    }

    fn set_wait(&self, wait: Option<Duration>) -> Result<()> {
        self.wait.set(wait);
        Ok(())
    }

    fn receive(&self, buffer: &mut [u8]) -> Result<(usize, SocketAddr)> {
        let port = self.at.port();
        // Without a wait, what is due now still comes.
        let wait = self.wait.get().unwrap_or_default();
        let ready = |state: &State| state.inboxes.get(&port).is_some_and(|inbox| !inbox.is_empty());
        self.world.wait(wait, ready);
        let mut state = self.world.state();
        let come = state.inboxes.get_mut(&port).and_then(VecDeque::pop_front);
        let (from, bytes) = come.ok_or(ErrorKind::WouldBlock)?;
        let size = bytes.len().min(buffer.len());
        buffer[..size].copy_from_slice(&bytes[..size]);
        Ok((size, local(from)))
    }

    fn busy_poll(&self, _us: u32) -> Result<()> {
        Err(ErrorKind::Unsupported.into())
    }
}

impl Drop for Port {
    fn drop(&mut self) {
        self.world.state().inboxes.remove(&self.at.port());
    }
}

/// A port for connections.
#[derive(Debug)]
pub(super) struct VirtualListener {
    world: World,
    at: SocketAddr,
}

impl VirtualListener {
    pub(super) fn new(world: World, at: SocketAddr) -> Self {
        Self { world, at }
    }
}

impl Listener for VirtualListener {
    fn address(&self) -> Result<SocketAddr> {
        Ok(self.at)
    }

    fn accept(&self) -> Result<(Box<dyn Stream>, SocketAddr)> {
        let mut state = self.world.state();
        let waiting = state.listeners.get_mut(&self.at.port()).and_then(VecDeque::pop_front);
        let connection = waiting.ok_or(ErrorKind::WouldBlock)?;
        drop(state);
        let stream = VirtualStream::server(self.world.clone(), connection);
        Ok((Box::new(stream), local(0)))
    }
}

impl Drop for VirtualListener {
    fn drop(&mut self) {
        let mut state = self.world.state();
        for connection in state.listeners.remove(&self.at.port()).unwrap_or_default() {
            if let Some(connection) = state.connections.get_mut(&connection) {
                connection.open = false;
            }
        }
    }
}

/// One end of a connection.
#[derive(Debug)]
pub(super) struct VirtualStream {
    world: World,
    connection: u64,
    end: usize,
    wait: Cell<Option<Duration>>,
}

impl VirtualStream {
    /// The end that has connected. Its reads wait.
    pub(super) fn client(world: World, connection: u64) -> Self {
        let wait = Cell::new(Some(Duration::MAX));
        let end = 0;
        Self {
            world,
            connection,
            end,
            wait,
        }
    }

    fn server(world: World, connection: u64) -> Self {
        let wait = Cell::new(None);
        let end = 1;
        Self {
            world,
            connection,
            end,
            wait,
        }
    }
}

impl Read for VirtualStream {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        let ready = |state: &State| {
            let connection = &state.connections[&self.connection];
            !self.world.is_out() && (!connection.open || connection.ready(self.end, state.now) > 0)
        };
        self.world.wait(self.wait.get().unwrap_or_default(), ready);
        let mut state = self.world.state();
        if !ready(&state) {
            return Err(ErrorKind::WouldBlock.into());
        }
        let now = state.now;
        let Some(connection) = state.connections.get_mut(&self.connection) else {
            return Ok(0);
        };
        let most = connection.ready(self.end, now).min(buffer.len());
        // A connection that was closed has lost what was on its way.
        let most = if connection.open { most } else { buffer.len() };
        connection.late[self.end].retain(|(due, _)| *due > now);
        connection.bytes[self.end].read(&mut buffer[..most])
    }
}

impl Write for VirtualStream {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        let mut state = self.world.state();
        let (now, to) = (state.now, 1 - self.end);
        let late = self.world.lateness(&mut state);
        let Some(connection) = state.connections.get_mut(&self.connection).filter(|one| one.open) else {
            return Err(Error::from(ErrorKind::BrokenPipe));
        };
        let behind = connection.late[to].back().map(|(due, _)| *due).filter(|due| *due > now);
        let due = late.max(behind);
        let count = connection.bytes[to].write(bytes)?;
        if let Some(due) = due {
            connection.late[to].push_back((due, count));
            // A reader that waits wakes up.
            state.plan(due, Event::Action(Box::new(|| ())));
        }
        Ok(count)
    }

    fn flush(&mut self) -> Result<()> {
        Ok(())
    }
}

impl Stream for VirtualStream {
    fn set_wait(&self, wait: Option<Duration>) -> Result<()> {
        self.wait.set(wait);
        Ok(())
    }

    fn is_closed(&self) -> bool {
        let state = self.world.state();
        let connection = &state.connections[&self.connection];
        !self.world.is_out() && !connection.open && connection.bytes[self.end].is_empty()
    }

    fn close(&self) {
        if let Some(connection) = self.world.state().connections.get_mut(&self.connection) {
            connection.open = false;
        }
    }
}

impl Drop for VirtualStream {
    fn drop(&mut self) {
        self.close();
    }
}

impl Machine for World {
    fn now(&self) -> Instant {
        self.state().now
    }

    fn sleep(&self, time: Duration) {
        self.wait(time, |_| false);
    }

    fn pause(&self) {
        self.sleep(Duration::from_micros(1));
    }

    fn datagrams(&self, at: SocketAddr) -> Result<Box<dyn Datagrams>> {
        let mut state = self.state();
        let at = state.free(at)?;
        state.inboxes.insert(at.port(), VecDeque::new());
        Ok(Box::new(Port::new(self.clone(), at)))
    }

    fn listen(&self, at: SocketAddr) -> Result<Box<dyn Listener>> {
        let mut state = self.state();
        let at = state.free(at)?;
        state.listeners.insert(at.port(), VecDeque::new());
        Ok(Box::new(VirtualListener::new(self.clone(), at)))
    }

    fn connect(&self, to: SocketAddr, timeout: Duration) -> Result<Box<dyn Stream>> {
        if self.is_out() {
            self.sleep(timeout);
            return Err(Error::new(ErrorKind::TimedOut, "the cable is out"));
        }
        let mut state = self.state();
        let number = state.number();
        let refused = || Error::from(ErrorKind::ConnectionRefused);
        state
            .listeners
            .get_mut(&to.port())
            .ok_or_else(refused)?
            .push_back(number);
        state.connections.insert(number, Connection::default());
        drop(state);
        Ok(Box::new(VirtualStream::client(self.clone(), number)))
    }

    fn run(&self, _name: &str, process: Box<dyn Process>) -> Result<Running> {
        let mut state = self.state();
        let (number, now) = (state.number(), state.now);
        let of = process;
        state.plan(now, Event::Turn { process: number, of });
        let world = self.clone();
        Ok(Running::until(move || world.end(number)))
    }
}
