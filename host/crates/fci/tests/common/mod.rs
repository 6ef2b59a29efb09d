//! What the tests of client against robot side share: a robot, a soft control law, and a network that can fail.
#![allow(dead_code, reason = "each test binary uses a part")]

use std::collections::VecDeque;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU16, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use spherecal_fci::client::Config;
use spherecal_fci::robot::{JointArm, READY, RobotConfig, RobotSide};
use spherecal_fci::wire::{RobotState, Version};

/// A robot with the simple arm, which the test can push, on any free port.
pub(crate) fn robot(version: Version) -> (RobotSide, Arc<Mutex<JointArm>>) {
    robot_with(RobotConfig::for_tests(version))
}

pub(crate) fn robot_with(config: RobotConfig) -> (RobotSide, Arc<Mutex<JointArm>>) {
    let arm = Arc::new(Mutex::new(JointArm::new(READY)));
    let side = RobotSide::start(config, Box::new(Arc::clone(&arm))).expect("a robot");
    (side, arm)
}

/// Settings for a robot on this machine. The timeout is long: two cores are shared.
pub(crate) fn config(address: SocketAddr) -> Config {
    Config {
        port: address.port(),
        state_timeout: Duration::from_secs(2),
        ..Config::new("127.0.0.1")
    }
}

/// A joint impedance that holds `at`: stiffness in N m/rad, damping in N m s/rad.
pub(crate) fn hold(at: [f64; 7]) -> impl Fn(&RobotState) -> [f64; 7] {
    let stiffness = [600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0];
    let damping = [50.0, 50.0, 40.0, 40.0, 10.0, 8.0, 2.0];
    move |state| std::array::from_fn(|j| stiffness[j] * (at[j] - state.q[j]) - damping[j] * state.dq[j])
}

/// The largest distance of a joint from `at`, rad.
pub(crate) fn deviation(state: &RobotState, at: &[f64; 7]) -> f64 {
    (0..7).fold(0.0, |most: f64, j| most.max((state.q[j] - at[j]).abs()))
}

/// Faults of the network between client and robot.
#[derive(Default)]
pub(crate) struct Faults {
    /// Datagrams lost in each direction, of 10,000.
    pub(crate) loss: AtomicU32,
    /// Largest delay of a datagram, us. The order is kept.
    pub(crate) jitter_us: AtomicU32,
    /// Nothing passes, by UDP or TCP.
    pub(crate) cable_out: AtomicBool,
    /// Both TCP connections are cut: what a killed client looks like to the robot.
    pub(crate) cut: AtomicBool,
    /// Each datagram comes once more, after the next one: repeated and out of order.
    pub(crate) repeat: AtomicBool,
    /// Datagrams lost by `loss`.
    pub(crate) lost: AtomicU64,
    end: AtomicBool,
}

/// A network between client and robot.
pub(crate) struct Network {
    pub(crate) faults: Arc<Faults>,
    pub(crate) address: SocketAddr,
}

impl Network {
    /// Listens in front of the robot at `robot`. `seed` decides which datagrams are lost.
    pub(crate) fn before(robot: SocketAddr, seed: u64) -> Self {
        let faults = Arc::new(Faults::default());
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
        let address = listener.local_addr().expect("an address");
        listener.set_nonblocking(true).expect("a listener");
        let shared = Arc::clone(&faults);
        std::thread::spawn(move || accept(&listener, robot, &shared, seed));
        Self { faults, address }
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        self.faults.end.store(true, Ordering::Relaxed);
    }
}

fn accept(listener: &TcpListener, robot: SocketAddr, faults: &Arc<Faults>, seed: u64) {
    // One pair of UDP ports for all sessions: towards the robot, towards the client.
    let to_robot = Arc::new(UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port"));
    let to_client = Arc::new(UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port"));
    let robot_port = Arc::new(AtomicU16::new(0));
    let client_port = Arc::new(AtomicU16::new(0));
    for (from, out, learn, port, seed) in [
        (&to_robot, &to_client, Some(&robot_port), &client_port, seed),
        (&to_client, &to_robot, None, &robot_port, seed ^ 0x9E37_79B9_7F4A_7C15),
    ] {
        let (from, out, port, faults) = (Arc::clone(from), Arc::clone(out), Arc::clone(port), Arc::clone(faults));
        let learn = learn.map(Arc::clone);
        std::thread::spawn(move || datagrams(&from, &out, learn.as_deref(), &port, &faults, seed));
    }
    let udp_port = to_robot.local_addr().expect("an address").port();
    while !faults.end.load(Ordering::Relaxed) {
        let Ok((client, _)) = listener.accept() else {
            std::thread::sleep(Duration::from_millis(2));
            continue;
        };
        client.set_nonblocking(false).expect("a stream");
        // A robot that is off refuses: so does the network.
        let Ok(mut to) = TcpStream::connect(robot) else {
            continue;
        };
        let mut connect = [0; 16];
        let mut from = client.try_clone().expect("a stream");
        if from.read_exact(&mut connect).is_err() {
            continue;
        }
        client_port.store(u16::from_le_bytes([connect[14], connect[15]]), Ordering::Relaxed);
        connect[14..].copy_from_slice(&udp_port.to_le_bytes());
        to.write_all(&connect).expect("the robot listens");
        let back = (to.try_clone().expect("a stream"), client.try_clone().expect("a stream"));
        for (from, to) in [(client, to), back] {
            let faults = Arc::clone(faults);
            std::thread::spawn(move || bytes(from, to, &faults));
        }
    }
}

fn bytes(mut from: TcpStream, mut to: TcpStream, faults: &Faults) {
    from.set_read_timeout(Some(Duration::from_millis(5))).expect("a stream");
    let mut part = [0; 4096];
    while !faults.end.load(Ordering::Relaxed) && !faults.cut.load(Ordering::Relaxed) {
        if faults.cable_out.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(1));
            continue;
        }
        match from.read(&mut part) {
            Ok(0) => break,
            Ok(count) => {
                if to.write_all(&part[..count]).is_err() {
                    break;
                }
            }
            Err(e) if matches!(e.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) => {}
            Err(_) => break,
        }
    }
    for stream in [&from, &to] {
        let _ = stream.shutdown(std::net::Shutdown::Both);
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
    let mut last = Vec::new();
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
        if faults.repeat.load(Ordering::Relaxed) {
            let before = std::mem::replace(&mut last, data[..size].to_vec());
            if !before.is_empty() {
                waiting.push_back((due, before));
            }
        }
    }
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
