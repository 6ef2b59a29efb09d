//! Servers under clients that mean harm: idle connections, trickled and oversized
//! headers, streams without end. Each test asks as an honest client throughout.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use crate::support::Server;

/// Longest wait of an honest client.
const HONEST: Duration = Duration::from_secs(1);
/// Most memory of a server under attack, MiB.
const MEMORY_MIB: f64 = 100.0;

fn server(folder: &tempfile::TempDir) -> Server {
    Server::start_in(
        folder.path(),
        &["serve", "--grpc", "0", "--service", "page", "--out", "o"],
    )
}

/// Asks for the page; fails if that takes longer than an honest client waits.
fn ask(server: &Server) {
    let begin = Instant::now();
    let mut socket = TcpStream::connect(&server.address).expect("an honest client connects");
    socket.set_read_timeout(Some(4 * HONEST)).expect("a time limit");
    write!(
        socket,
        "GET / HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n",
        server.address
    )
    .expect("an honest client asks");
    let mut answer = String::new();
    socket
        .read_to_string(&mut answer)
        .expect("an honest client is answered");
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    assert!(begin.elapsed() < HONEST, "answered after {:?}", begin.elapsed());
}

/// Whether the other side has closed a connection, waiting for at most `wait`.
fn is_closed(socket: &mut TcpStream, wait: Duration) -> bool {
    socket.set_read_timeout(Some(wait)).expect("a time limit");
    let mut buffer = [0; 4096];
    loop {
        match socket.read(&mut buffer) {
            Ok(0) => return true,
            Ok(_) => {}
            Err(e) => return !matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut),
        }
    }
}

// Fails if idle connections lock an honest client out, cost memory, or are kept.
#[test]
fn idle_connections_lock_nobody_out() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = server(&folder);
    let mut idle = Vec::new();
    for k in 0..600 {
        idle.push(TcpStream::connect(&server.address).expect("connects"));
        if k % 100 == 99 {
            ask(&server);
        }
    }
    ask(&server);
    assert!(server.memory_mib() < MEMORY_MIB, "{} MiB", server.memory_mib());
    let kept = idle
        .iter_mut()
        .filter_map(|s| (!is_closed(s, Duration::from_millis(1))).then_some(()))
        .count();
    assert!(kept <= 128, "{kept} idle connections are kept");
}

// Fails if a connection that never ends its headers is kept, or if headers of any
// size are taken.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_headers_are_bounded_in_time_and_size() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = server(&folder);
    let mut trickle = TcpStream::connect(&server.address).expect("connects");
    write!(trickle, "GET / HTTP/1.1\r\n").expect("sent");
    let begin = Instant::now();
    let closed = loop {
        // The server may have closed the connection already.
        let _ = write!(trickle, "X: y\r\n");
        if is_closed(&mut trickle, Duration::from_millis(300)) {
            break true;
        }
        if begin.elapsed() > Duration::from_secs(20) {
            break false;
        }
    };
    assert!(closed, "headers may be trickled for {:?}", begin.elapsed());
    let mut large = TcpStream::connect(&server.address).expect("connects");
    let header = format!("X: {}\r\n", "y".repeat(8000));
    let _ = write!(large, "GET / HTTP/1.1\r\n");
    let taken = (0..10_000)
        .take_while(|_| large.write_all(header.as_bytes()).is_ok())
        .count();
    assert!(taken < 5_000, "{taken} headers of 8 kB are taken");
    ask(&server);
    assert!(server.memory_mib() < MEMORY_MIB, "{} MiB", server.memory_mib());
}

/// An HTTP/2 frame.
#[cfg(feature = "services")]
fn frame(kind: u8, flags: u8, stream: u32, payload: &[u8]) -> Vec<u8> {
    let length = u32::try_from(payload.len()).expect("short").to_be_bytes();
    let mut bytes = vec![length[1], length[2], length[3], kind, flags];
    bytes.extend(stream.to_be_bytes());
    bytes.extend(payload);
    bytes
}

// Fails if one connection that opens streams without end, or opens and resets them,
// takes the server's memory or its time.
#[cfg(feature = "services")]
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_flood_of_streams_is_bounded() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = Server::start_in(folder.path(), &["serve", "--grpc", "0", "--out", "o"]);
    for reset in [false, true] {
        let mut flood = TcpStream::connect(&server.address).expect("connects");
        flood
            .set_write_timeout(Some(Duration::from_millis(200)))
            .expect("a time limit");
        flood.write_all(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n").expect("sent");
        flood.write_all(&frame(4, 0, 0, &[])).expect("sent");
        let begin = Instant::now();
        let mut next = Instant::now();
        let mut peak: f64 = 0.0;
        // POST, http, /, and 4 kB of another header, as literals without an index.
        let mut headers = vec![0x83, 0x86, 0x84, 0x00, 0x01, b'x', 0x7f, 0xa1, 0x1e];
        headers.extend([b'y'; 127 + 0x21 + (0x1e << 7)]);
        'flood: for stream in (1..).step_by(2) {
            let mut bytes = frame(1, 0x4, stream, &headers);
            if reset {
                bytes.extend(frame(3, 0, stream, &8_u32.to_be_bytes()));
            }
            let mut left = &bytes[..];
            while !left.is_empty() {
                match flood.write(left) {
                    Ok(0) => break 'flood,
                    Ok(n) => left = &left[n..],
                    Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                    Err(_) => break 'flood,
                }
                if begin.elapsed() > Duration::from_secs(4) {
                    break 'flood;
                }
            }
            if Instant::now() > next {
                next += Duration::from_millis(250);
                peak = peak.max(server.memory_mib());
            }
        }
        peak = peak.max(server.memory_mib());
        assert!(peak < MEMORY_MIB, "{peak} MiB, reset: {reset}");
        // It still answers while the flooding connection is open.
        let mut honest = TcpStream::connect(&server.address).expect("connects");
        honest.set_read_timeout(Some(HONEST)).expect("a time limit");
        honest.write_all(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n").expect("sent");
        honest.write_all(&frame(4, 0, 0, &[])).expect("sent");
        let mut head = [0; 9];
        honest.read_exact(&mut head).expect("its settings within a second");
        assert_eq!(head[3], 4, "settings come first");
    }
}
