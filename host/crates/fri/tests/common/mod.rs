//! What the tests of client against cabinet share: a cabinet, a soft control law, and a network that can fail.
#![allow(dead_code, reason = "each test binary uses a part")]

use std::collections::VecDeque;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU16, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use spherecal_fri::client::{Client, ClientError, Config, Cycle, Limits, State};
use spherecal_fri::robot::{CabinetConfig, CabinetSide, JointArm, START, Tolerance};
use spherecal_fri::wire::SessionState;

pub(crate) const LOCAL: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

/// Settings of a client on this machine, on any free port. The timeout is long: two cores are shared.
pub(crate) fn config() -> Config {
    Config {
        address: LOCAL,
        timeout: Duration::from_secs(2),
        ..Config::new(Limits::IIWA_7)
    }
}

/// A tolerant cabinet with the simple arm, which the test can push, for the client at this address.
pub(crate) fn cabinet(client: SocketAddr) -> (CabinetSide, Arc<Mutex<JointArm>>) {
    cabinet_with(CabinetConfig {
        client,
        tolerance: Tolerance::tolerant(),
        ..CabinetConfig::new()
    })
}

pub(crate) fn cabinet_with(config: CabinetConfig) -> (CabinetSide, Arc<Mutex<JointArm>>) {
    let arm = Arc::new(Mutex::new(JointArm::new(START)));
    let side = CabinetSide::start(config, Box::new(Arc::clone(&arm))).expect("a cabinet");
    (side, arm)
}

/// A joint impedance that holds `at`: stiffness in N m/rad, damping in N m s/rad.
pub(crate) fn hold(at: [f64; 7]) -> impl Fn(&State) -> [f64; 7] {
    let stiffness = [600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0];
    let damping = [50.0, 50.0, 40.0, 40.0, 10.0, 8.0, 2.0];
    move |state| std::array::from_fn(|j| stiffness[j] * (at[j] - state.q[j]) - damping[j] * state.dq[j])
}

/// The largest distance of a joint from `at`, rad.
pub(crate) fn deviation(state: &State, at: &[f64; 7]) -> f64 {
    (0..7).fold(0.0, |most: f64, j| most.max((state.q[j] - at[j]).abs()))
}

/// Exchanges until the session has this state; fails after many messages.
pub(crate) fn until(client: &mut Client, session: SessionState, state: &mut State) -> Result<Cycle, ClientError> {
    let law = hold(START);
    for _ in 0..20_000 {
        let cycle = client.exchange(state, &law)?;
        if state.session == session {
            return Ok(cycle);
        }
    }
    panic!("the session stays in {}", state.session);
}

/// A client that commands: the session is in COMMANDING_ACTIVE.
pub(crate) fn commanding(config: &Config) -> (Client, CabinetSide, Arc<Mutex<JointArm>>) {
    let mut client = Client::listen(config).expect("a client");
    let (side, arm) = cabinet(client.address().expect("an address"));
    rise(&mut client, &side);
    (client, side, arm)
}

/// Lets the session rise to COMMANDING_ACTIVE.
pub(crate) fn rise(client: &mut Client, side: &CabinetSide) {
    let mut state = State::default();
    // The cabinet sees every control within two messages.
    for _ in 0..3 {
        client.exchange(&mut state, |_| [0.0; 7]).expect("a message");
    }
    until(client, SessionState::MonitoringReady, &mut state).expect("a good connection");
    client.enable().expect("a robot that may move");
    side.controls().command.store(true, Ordering::Relaxed);
    until(client, SessionState::CommandingActive, &mut state).expect("a motion");
}

/// Waits until `done`, at most 10 s. Returns whether it came true.
pub(crate) fn eventually(mut done: impl FnMut() -> bool) -> bool {
    let deadline = Instant::now() + Duration::from_secs(10);
    while Instant::now() < deadline {
        if done() {
            return true;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    false
}

/// Faults of the network between cabinet and client.
#[derive(Default)]
pub(crate) struct Faults {
    /// Datagrams lost in each direction, of 10,000.
    pub(crate) loss: AtomicU32,
    /// Largest delay of a datagram, us. The order is kept.
    pub(crate) jitter_us: AtomicU32,
    /// Nothing passes.
    pub(crate) cable_out: AtomicBool,
    /// Datagrams lost by `loss`.
    pub(crate) lost: AtomicU64,
    end: AtomicBool,
}

/// A network between cabinet and client.
pub(crate) struct Network {
    pub(crate) faults: Arc<Faults>,
    /// Where the cabinet sends.
    pub(crate) address: SocketAddr,
}

impl Network {
    /// In front of the client at `client`. `seed` decides which datagrams are lost.
    pub(crate) fn before(client: SocketAddr, seed: u64) -> Self {
        let faults = Arc::new(Faults::default());
        let cabinet_side = Arc::new(UdpSocket::bind(LOCAL).expect("a port"));
        let client_side = Arc::new(UdpSocket::bind(LOCAL).expect("a port"));
        let address = cabinet_side.local_addr().expect("an address");
        let cabinet_port = Arc::new(AtomicU16::new(0));
        let client_port = Arc::new(AtomicU16::new(client.port()));
        for (from, out, learn, port, seed) in [
            (&cabinet_side, &client_side, Some(&cabinet_port), &client_port, seed),
            (
                &client_side,
                &cabinet_side,
                None,
                &cabinet_port,
                seed ^ 0x9E37_79B9_7F4A_7C15,
            ),
        ] {
            let (from, out, port, faults) = (Arc::clone(from), Arc::clone(out), Arc::clone(port), Arc::clone(&faults));
            let learn = learn.map(Arc::clone);
            std::thread::spawn(move || datagrams(&from, &out, learn.as_deref(), &port, &faults, seed));
        }
        Self { faults, address }
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        self.faults.end.store(true, Ordering::Relaxed);
    }
}

/// A small generator (SplitMix64), so that the same seed loses the same datagrams.
fn random(seed: &mut u64) -> u64 {
    *seed = seed.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let mut z = *seed;
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

fn datagrams(
    from: &UdpSocket,
    out: &UdpSocket,
    learn: Option<&AtomicU16>,
    port: &AtomicU16,
    faults: &Faults,
    mut seed: u64,
) {
    let mut waiting: VecDeque<(Instant, Vec<u8>)> = VecDeque::new();
    let mut data = [0; 4096];
    while !faults.end.load(Ordering::Relaxed) {
        let now = Instant::now();
        while waiting.front().is_some_and(|(due, _)| *due <= now) {
            let (_, data) = waiting.pop_front().expect("one");
            let to = (Ipv4Addr::LOCALHOST, port.load(Ordering::Relaxed));
            if to.1 != 0 {
                let _ = out.send_to(&data, to);
            }
        }
        let wait = waiting.front().map_or(Duration::from_millis(5), |(due, _)| *due - now);
        from.set_read_timeout(Some(wait.max(Duration::from_micros(20))))
            .expect("a socket");
        let Ok((size, sender)) = from.recv_from(&mut data) else {
            continue;
        };
        if let Some(learn) = learn {
            learn.store(sender.port(), Ordering::Relaxed);
        }
        if faults.cable_out.load(Ordering::Relaxed) {
            continue;
        }
        if random(&mut seed) % 10_000 < u64::from(faults.loss.load(Ordering::Relaxed)) {
            faults.lost.fetch_add(1, Ordering::Relaxed);
            continue;
        }
        let jitter = u64::from(faults.jitter_us.load(Ordering::Relaxed));
        let delay = if jitter == 0 {
            0
        } else {
            random(&mut seed) % (jitter + 1)
        };
        let due = Instant::now() + Duration::from_micros(delay);
        let due = waiting.back().map_or(due, |(last, _)| due.max(*last));
        waiting.push_back((due, data[..size].to_vec()));
    }
}
