//! For tests of a client against a robot side: a network that can fail, and a soft control law.
#![expect(
    clippy::expect_used,
    reason = "a test fails where the loopback network cannot be used"
)]

mod connected;

use std::collections::VecDeque;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU16, AtomicU32, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

pub use connected::Connected;

/// Any free port of this machine.
pub const LOCAL: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

/// A joint impedance that holds `at`, rad: from `q`, rad, and `dq`, rad/s, to torques, N m.
pub fn joint_impedance(at: [f64; 7]) -> impl Fn(&[f64; 7], &[f64; 7]) -> [f64; 7] {
    let stiffness = [600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0];
    let damping = [50.0, 50.0, 40.0, 40.0, 10.0, 8.0, 2.0];
    move |q, dq| std::array::from_fn(|j| stiffness[j] * (at[j] - q[j]) - damping[j] * dq[j])
}

/// The largest distance of a joint from `at`, rad.
pub fn deviation(q: &[f64; 7], at: &[f64; 7]) -> f64 {
    (0..7).fold(0.0, |most: f64, j| most.max((q[j] - at[j]).abs()))
}

/// Waits until `done`, at most 10 s. Returns whether it came true.
pub fn eventually(mut done: impl FnMut() -> bool) -> bool {
    let deadline = Instant::now() + Duration::from_secs(10);
    while Instant::now() < deadline {
        if done() {
            return true;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    false
}

/// Faults of the network between two sides. Every change acts at once.
#[derive(Debug, Default)]
pub struct Faults {
    /// Datagrams lost in each direction, of 10,000.
    pub loss: AtomicU32,
    /// Largest delay of a datagram, us. The order is kept.
    pub jitter_us: AtomicU32,
    /// Nothing passes.
    pub cable_out: AtomicBool,
    /// Each datagram comes once more, after the next one: repeated and out of order.
    pub repeat: AtomicBool,
    /// Connections of the test's own are cut: what a killed client looks like to the robot.
    pub cut: AtomicBool,
    /// Datagrams lost by `loss`.
    pub lost: AtomicU64,
    end: AtomicBool,
}

impl Faults {
    /// Whether the network is gone.
    pub fn has_ended(&self) -> bool {
        self.end.load(Ordering::Relaxed)
    }
}

/// A relay of datagrams between two sides of this machine, each of which sees a port of the relay.
#[derive(Debug)]
pub struct Relay {
    /// What goes wrong.
    pub faults: Arc<Faults>,
    /// The port that side A talks to; what comes there goes to side B.
    pub for_a: SocketAddr,
    /// The port that side B talks to; what comes there goes to side A.
    pub for_b: SocketAddr,
    a: Arc<AtomicU16>,
    b: Arc<AtomicU16>,
}

impl Relay {
    /// Starts. A side whose port is not told is known by its first datagram. `seed` decides which datagrams are lost.
    ///
    /// # Panics
    /// If the loopback network cannot be used.
    pub fn start(seed: u64) -> Self {
        let bind = || Arc::new(UdpSocket::bind(LOCAL).expect("a port"));
        let (from_a, from_b) = (bind(), bind());
        let relay = Self {
            faults: Arc::default(),
            for_a: from_a.local_addr().expect("an address"),
            for_b: from_b.local_addr().expect("an address"),
            a: Arc::default(),
            b: Arc::default(),
        };
        for (stream, from, out, sender, receiver) in [
            (0, &from_a, &from_b, &relay.a, &relay.b),
            (1, &from_b, &from_a, &relay.b, &relay.a),
        ] {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            random.set_stream(stream);
            let direction = Direction {
                from: Arc::clone(from),
                out: Arc::clone(out),
                sender: Arc::clone(sender),
                receiver: Arc::clone(receiver),
                faults: Arc::clone(&relay.faults),
            };
            std::thread::spawn(move || direction.run(random));
        }
        relay
    }

    /// Side A listens at this port.
    pub fn set_a(&self, port: u16) {
        self.a.store(port, Ordering::Relaxed);
    }

    /// Side B listens at this port.
    pub fn set_b(&self, port: u16) {
        self.b.store(port, Ordering::Relaxed);
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.faults.end.store(true, Ordering::Relaxed);
    }
}

/// How often a direction looks for new datagrams while others wait.
const LOOK: Duration = Duration::from_micros(100);
/// How often it looks whether the network has ended.
const IDLE: Duration = Duration::from_millis(5);

/// One direction of a [`Relay`].
struct Direction {
    from: Arc<UdpSocket>,
    out: Arc<UdpSocket>,
    sender: Arc<AtomicU16>,
    receiver: Arc<AtomicU16>,
    faults: Arc<Faults>,
}

impl Direction {
    fn run(self, mut random: ChaCha8Rng) {
        self.from.set_read_timeout(Some(IDLE)).expect("a socket");
        let mut waiting: VecDeque<(Instant, Vec<u8>)> = VecDeque::new();
        let mut data = [0; 4096];
        let mut last = Vec::new();
        while !self.faults.has_ended() {
            let now = Instant::now();
            while waiting.front().is_some_and(|(due, _)| *due <= now) {
                let (_, data) = waiting.pop_front().expect("one");
                let port = self.receiver.load(Ordering::Relaxed);
                if port != 0 {
                    // A closed port loses the datagram, as a network does.
                    let _ = self.out.send_to(&data, (Ipv4Addr::LOCALHOST, port));
                }
            }
            // The system rounds the time limit of a socket up to its own tick: a wait for a datagram that is due sleeps.
            let due = waiting.front().map(|(due, _)| due.saturating_duration_since(now));
            self.from.set_nonblocking(due.is_some()).expect("a socket");
            let Ok((size, sender)) = self.from.recv_from(&mut data) else {
                std::thread::sleep(due.map_or(Duration::ZERO, |due| due.min(LOOK)));
                continue;
            };
            self.sender.store(sender.port(), Ordering::Relaxed);
            if self.faults.cable_out.load(Ordering::Relaxed) {
                continue;
            }
            if random.random_range(0..10_000) < self.faults.loss.load(Ordering::Relaxed) {
                self.faults.lost.fetch_add(1, Ordering::Relaxed);
                continue;
            }
            let jitter = u64::from(self.faults.jitter_us.load(Ordering::Relaxed));
            let due = Instant::now() + Duration::from_micros(random.random_range(0..=jitter));
            let due = waiting.back().map_or(due, |(last, _)| due.max(*last));
            waiting.push_back((due, data[..size].to_vec()));
            if self.faults.repeat.load(Ordering::Relaxed) {
                let before = std::mem::replace(&mut last, data[..size].to_vec());
                if !before.is_empty() {
                    waiting.push_back((due, before));
                }
            }
        }
    }
}
