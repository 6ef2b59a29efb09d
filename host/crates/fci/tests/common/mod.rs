//! What the tests of client against robot side share: a robot, a soft control law, and a network that can fail.
#![allow(dead_code, reason = "each test binary uses a part")]

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, Weak};
use std::time::Duration;

use spherecal_cyclic::testing::{Faults, LOCAL, Relay, joint_impedance};
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

/// A joint impedance that holds `at`, rad.
pub(crate) fn hold(at: [f64; 7]) -> impl Fn(&RobotState) -> [f64; 7] {
    let law = joint_impedance(at);
    move |state| law(&state.q, &state.dq)
}

/// The largest distance of a joint from `at`, rad.
pub(crate) fn deviation(state: &RobotState, at: &[f64; 7]) -> f64 {
    spherecal_cyclic::testing::deviation(&state.q, at)
}

/// A network between client (A) and robot (B). `cable_out` also stops the bytes of TCP; `cut` closes the connections.
pub(crate) struct Network {
    pub(crate) faults: Arc<Faults>,
    pub(crate) address: SocketAddr,
    _relay: Arc<Relay>,
}

impl Network {
    /// Listens in front of the robot at `robot`. `seed` decides which datagrams are lost.
    pub(crate) fn before(robot: SocketAddr, seed: u64) -> Self {
        let relay = Arc::new(Relay::start(seed));
        let listener = TcpListener::bind(LOCAL).expect("a port");
        let address = listener.local_addr().expect("an address");
        listener.set_nonblocking(true).expect("a listener");
        let faults = Arc::clone(&relay.faults);
        let theirs = Arc::downgrade(&relay);
        std::thread::spawn(move || accept(&listener, robot, &theirs));
        Self {
            faults,
            address,
            _relay: relay,
        }
    }
}

fn accept(listener: &TcpListener, robot: SocketAddr, relay: &Weak<Relay>) {
    while let Some(relay) = relay.upgrade() {
        let Ok((client, _)) = listener.accept() else {
            drop(relay);
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
        relay.set_a(u16::from_le_bytes([connect[14], connect[15]]));
        connect[14..].copy_from_slice(&relay.for_b.port().to_le_bytes());
        to.write_all(&connect).expect("the robot listens");
        let back = (to.try_clone().expect("a stream"), client.try_clone().expect("a stream"));
        for (from, to) in [(client, to), back] {
            let faults = Arc::clone(&relay.faults);
            std::thread::spawn(move || bytes(from, to, &faults));
        }
    }
}

fn bytes(mut from: TcpStream, mut to: TcpStream, faults: &Faults) {
    from.set_read_timeout(Some(Duration::from_millis(5))).expect("a stream");
    let mut part = [0; 4096];
    while !faults.has_ended() && !faults.cut.load(Ordering::Relaxed) {
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
