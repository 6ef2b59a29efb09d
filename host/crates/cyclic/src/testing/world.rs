//! A simulated network on a virtual clock: robot, client and their faults in one process, at the speed of the processor.
//!
//! Time stands still while anything computes. It passes only while the test or a client of it waits: then everything
//! that is due meanwhile happens, in the order of its time, and what is due at the same time in the order in which it
//! was planned. So one test has one course of events, whatever the computer does beside it.
//!
//! - A **datagram** is an event; without faults it is due at once.
//! - A **process** ([`Process`]: a robot side, a person) is an event for each of its turns. It never waits.
//! - An **action** ([`World::after`]) is an event of the test.
//!
//! Exactly one thread may wait. Ports are those of one machine; the address of a port does not matter.

use std::collections::{BTreeMap, VecDeque};
use std::io::{ErrorKind, Result};
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::machine::{Machine, Process};

/// The longest wait: longer than any test.
const LONGEST: Duration = Duration::from_hours(24);

/// Faults of the network. Every change acts at once.
#[derive(Debug, Default)]
pub struct Faults {
    /// Datagrams lost in each direction, of 10,000.
    pub loss: AtomicU32,
    /// Largest delay of a datagram, us. The order is kept.
    pub jitter_us: AtomicU32,
    /// Writes to connections, of 10,000, whose bytes come late, and with them all bytes behind: a packet was lost and sent again.
    pub late: AtomicU32,
    /// How late they come, us.
    pub late_us: AtomicU32,
    /// Nothing passes: datagrams are lost, connections stand still.
    pub cable_out: AtomicBool,
    /// Each datagram comes once more, after the next one: repeated and out of order.
    pub repeat: AtomicBool,
    /// Datagrams lost by `loss`.
    pub lost: AtomicU64,
}

/// What happens at its time.
pub(super) enum Event {
    Datagram { from: u16, to: u16, bytes: Vec<u8> },
    Turn { process: u64, of: Box<dyn Process> },
    Action(Box<dyn FnOnce() + Send>),
}

/// Everything that the lock of a world guards. Nothing that was handed in is dropped or called under it.
pub(super) struct State {
    pub(super) now: Instant,
    events: BTreeMap<(Instant, u64), Event>,
    /// Number of the next event, process or connection.
    next: u64,
    port: u16,
    random: ChaCha8Rng,
    /// For each port that receives datagrams: what has come, and from where.
    pub(super) inboxes: BTreeMap<u16, VecDeque<(u16, Vec<u8>)>>,
    /// For each receiving port: when the last datagram on its way is due, and which one it is.
    on_the_way: BTreeMap<u16, (Instant, Vec<u8>)>,
    pub(super) listeners: BTreeMap<u16, VecDeque<u64>>,
    pub(super) connections: BTreeMap<u64, Connection>,
    /// The process whose turn it is, and whether it was ended meanwhile.
    turning: Option<(u64, bool)>,
}

/// A simulated network on a virtual clock. Clones are the same world.
#[derive(Clone)]
pub struct World(Arc<Shared>);

struct Shared {
    state: Mutex<State>,
    faults: Faults,
}

impl std::fmt::Debug for World {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("World")
    }
}

impl World {
    /// A network without faults. `seed` decides which datagrams are lost, and by how much the others are late.
    pub fn new(seed: u64) -> Self {
        Self(Arc::new(Shared {
            state: Mutex::new(State {
                now: Instant::now(),
                events: BTreeMap::new(),
                next: 0,
                port: 40_000,
                random: ChaCha8Rng::seed_from_u64(seed),
                inboxes: BTreeMap::new(),
                on_the_way: BTreeMap::new(),
                listeners: BTreeMap::new(),
                connections: BTreeMap::new(),
                turning: None,
            }),
            faults: Faults::default(),
        }))
    }

    /// The machine for the settings of both sides.
    pub fn machine(&self) -> Arc<dyn Machine> {
        Arc::new(self.clone())
    }

    /// What goes wrong.
    pub fn faults(&self) -> &Faults {
        &self.0.faults
    }

    /// Lets something happen after this time. It must not wait.
    pub fn after(&self, time: Duration, action: impl FnOnce() + Send + 'static) {
        let mut state = self.state();
        let due = state.now + time;
        state.plan(due, Event::Action(Box::new(action)));
    }

    /// Breaks all connections: what a killed client looks like to the robot.
    pub fn cut(&self) {
        for connection in self.state().connections.values_mut() {
            connection.open = false;
        }
    }

    /// Waits until `done`, at most 10 s. Returns whether it came true.
    pub fn eventually(&self, mut done: impl FnMut() -> bool) -> bool {
        (0..10_000).any(|_| {
            self.sleep(Duration::from_millis(1));
            done()
        })
    }

    pub(super) fn state(&self) -> MutexGuard<'_, State> {
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn is_out(&self) -> bool {
        self.0.faults.cable_out.load(Ordering::Relaxed)
    }

    /// Lets time pass until `ready`, at most `time`.
    pub(super) fn wait(&self, time: Duration, ready: impl Fn(&State) -> bool) {
        let mut state = self.state();
        let until = state.now + time.min(LONGEST);
        while !ready(&state) {
            let Some(event) = state.events.first_entry().filter(|event| event.key().0 <= until) else {
                state.now = until;
                return;
            };
            let ((due, _), event) = event.remove_entry();
            state.now = due;
            match event {
                Event::Datagram { from, to, bytes } => {
                    // A closed port loses the datagram, as a network does.
                    if let Some(inbox) = state.inboxes.get_mut(&to) {
                        inbox.push_back((from, bytes));
                    }
                }
                Event::Action(action) => {
                    drop(state);
                    action();
                    state = self.state();
                }
                Event::Turn { process, mut of } => {
                    state.turning = Some((process, false));
                    drop(state);
                    let next = of.turn(due);
                    state = self.state();
                    if state.turning.take() == Some((process, false)) {
                        let next = next.max(due + Duration::from_nanos(1));
                        state.plan(next, Event::Turn { process, of });
                    } else {
                        drop(state);
                        drop(of);
                        state = self.state();
                    }
                }
            }
        }
    }

    /// Sends a datagram through the faults of the network.
    pub(super) fn send(&self, from: u16, to: u16, bytes: &[u8]) {
        let faults = self.faults();
        let mut state = self.state();
        if self.is_out() {
            return;
        }
        if state.random.random_range(0..10_000) < faults.loss.load(Ordering::Relaxed) {
            faults.lost.fetch_add(1, Ordering::Relaxed);
            return;
        }
        let jitter = u64::from(faults.jitter_us.load(Ordering::Relaxed));
        let due = state.now + Duration::from_micros(state.random.random_range(0..=jitter));
        let before = state.on_the_way.remove(&to);
        let due = before.as_ref().map_or(due, |(last, _)| due.max(*last));
        state.on_the_way.insert(to, (due, bytes.to_vec()));
        let bytes = bytes.to_vec();
        state.plan(due, Event::Datagram { from, to, bytes });
        if let Some((_, bytes)) = before.filter(|_| faults.repeat.load(Ordering::Relaxed)) {
            state.plan(due, Event::Datagram { from, to, bytes });
        }
    }

    /// When bytes come that are sent now over a connection, if they are late.
    pub(super) fn lateness(&self, state: &mut State) -> Option<Instant> {
        let faults = self.faults();
        let share = faults.late.load(Ordering::Relaxed);
        let late = share > 0 && state.random.random_range(0..10_000) < share;
        let by = Duration::from_micros(faults.late_us.load(Ordering::Relaxed).into());
        late.then(|| state.now + by)
    }

    /// Ends a process, unless it has ended.
    pub(super) fn end(&self, process: u64) {
        let mut state = self.state();
        if let Some((turning, ended)) = &mut state.turning
            && *turning == process
        {
            *ended = true;
            return;
        }
        let of = |event: &Event| matches!(event, Event::Turn { process: p, .. } if *p == process);
        let key = state.events.iter().find(|(_, event)| of(event)).map(|(key, _)| *key);
        let event = key.and_then(|key| state.events.remove(&key));
        drop(state);
        // Its sockets close without the lock.
        drop(event);
    }
}

impl State {
    pub(super) fn plan(&mut self, due: Instant, event: Event) {
        let number = self.number();
        self.events.insert((due, number), event);
    }

    pub(super) fn number(&mut self) -> u64 {
        self.next += 1;
        self.next
    }

    pub(super) fn free(&mut self, asked: SocketAddr) -> Result<SocketAddr> {
        let taken = |state: &Self, port: u16| state.inboxes.contains_key(&port) || state.listeners.contains_key(&port);
        let mut port = asked.port();
        if port == 0 {
            while taken(self, self.port) {
                self.port += 1;
            }
            port = self.port;
            self.port += 1;
        } else if taken(self, port) {
            return Err(ErrorKind::AddrInUse.into());
        }
        Ok(SocketAddr::new(asked.ip(), port))
    }
}

/// What is on its way between two ends.
#[derive(Debug)]
pub(super) struct Connection {
    /// For each end: the bytes that it has not read.
    pub(super) bytes: [VecDeque<u8>; 2],
    /// For each end: how many of them are on their way, and when they are due.
    pub(super) late: [VecDeque<(Instant, usize)>; 2],
    pub(super) open: bool,
}

impl Default for Connection {
    fn default() -> Self {
        let (bytes, late) = Default::default();
        Self {
            bytes,
            late,
            open: true,
        }
    }
}

impl Connection {
    /// Bytes that this end can read now.
    pub(super) fn ready(&self, end: usize, now: Instant) -> usize {
        let late = self.late[end]
            .iter()
            .filter(|(due, _)| *due > now)
            .map(|(_, count)| count);
        self.bytes[end].len() - late.sum::<usize>()
    }
}

/// The address of a port, as its peers see it.
pub(super) fn local(port: u16) -> SocketAddr {
    SocketAddr::from((Ipv4Addr::LOCALHOST, port))
}

#[cfg(test)]
#[path = "world_tests.rs"]
mod tests;
