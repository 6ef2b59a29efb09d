//! A network that also carries the TCP connection of a client: its first message names the port for datagrams.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Weak};
use std::time::Duration;

use super::{Faults, LOCAL, Relay};

/// A network between a client (A) and the robot (B) to which it connects. `cable_out` also stops the bytes of TCP; `cut`
/// closes the connections.
#[derive(Debug)]
pub struct Connected {
    /// What goes wrong.
    pub faults: Arc<Faults>,
    /// Where the client connects.
    pub address: SocketAddr,
    _relay: Arc<Relay>,
}

impl Connected {
    /// Listens in front of the robot at `robot`. The client's first message has `first` bytes, of which the last two are
    /// its port for datagrams, little endian. `seed` decides which datagrams are lost.
    ///
    /// # Panics
    /// If the loopback network cannot be used.
    pub fn before(robot: SocketAddr, seed: u64, first: usize) -> Self {
        let relay = Arc::new(Relay::start(seed));
        let listener = TcpListener::bind(LOCAL).expect("a port");
        let address = listener.local_addr().expect("an address");
        listener.set_nonblocking(true).expect("a listener");
        let faults = Arc::clone(&relay.faults);
        let theirs = Arc::downgrade(&relay);
        std::thread::spawn(move || accept(&listener, robot, first, &theirs));
        Self {
            faults,
            address,
            _relay: relay,
        }
    }
}

fn accept(listener: &TcpListener, robot: SocketAddr, first: usize, relay: &Weak<Relay>) {
    while let Some(relay) = relay.upgrade() {
        let client = match listener.accept() {
            // A cable that is out: whoever connects is cut off.
            Ok((client, _)) if !relay.faults.cable_out.load(Ordering::Relaxed) => client,
            _ => {
                drop(relay);
                std::thread::sleep(Duration::from_millis(2));
                continue;
            }
        };
        client.set_nonblocking(false).expect("a stream");
        // A robot that is off refuses: so does the network.
        let Ok(mut to) = TcpStream::connect(robot) else {
            continue;
        };
        let mut connect = vec![0; first];
        let mut from = client.try_clone().expect("a stream");
        if from.read_exact(&mut connect).is_err() {
            continue;
        }
        let port = first - 2;
        relay.set_a(u16::from_le_bytes([connect[port], connect[port + 1]]));
        connect[port..].copy_from_slice(&relay.for_b.port().to_le_bytes());
        if to.write_all(&connect).is_err() {
            continue;
        }
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
