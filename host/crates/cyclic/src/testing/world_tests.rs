//! Tests of the simulated network.

use super::super::LOCAL;
use super::*;
use crate::machine::Datagrams;

const MS: Duration = Duration::from_millis(1);

/// What came at a port until the network is quiet: the first byte of each datagram, and after how many microseconds.
fn received(world: &World, port: &dyn Datagrams) -> Vec<(u8, u128)> {
    let begun = world.now();
    port.set_wait(Some(50 * MS)).expect("a wait");
    let mut buffer = [0; 8];
    std::iter::from_fn(|| {
        port.receive(&mut buffer).ok()?;
        Some((buffer[0], (world.now() - begun).as_micros()))
    })
    .collect()
}

fn sent(seed: u64, jitter_us: u32, loss: u32, repeat: bool) -> Vec<(u8, u128)> {
    let world = World::new(seed);
    let port = || world.datagrams(LOCAL).expect("a port");
    let (a, b) = (port(), port());
    let to = b.address().expect("an address");
    let faults = world.faults();
    faults.jitter_us.store(jitter_us, Ordering::Relaxed);
    faults.loss.store(loss, Ordering::Relaxed);
    faults.repeat.store(repeat, Ordering::Relaxed);
    for number in 0..100 {
        a.send(&[number], to).expect("sent");
    }
    received(&world, b.as_ref())
}

// Fails if one seed has two courses of events, late datagrams overtake, or a fault does not act.
#[test]
fn one_seed_is_one_course_of_events() {
    let numbers = |seen: &[(u8, u128)]| seen.iter().map(|(number, _)| *number).collect::<Vec<_>>();
    let all: Vec<u8> = (0..100).collect();
    assert_eq!(sent(1, 0, 0, false), all.iter().map(|n| (*n, 0)).collect::<Vec<_>>());
    let late = sent(1, 2000, 0, false);
    assert_eq!((numbers(&late), sent(1, 2000, 0, false)), (all, late.clone()));
    assert!(late.iter().all(|(_, us)| *us <= 2000) && late[99].1 > 1000, "{late:?}");
    let lossy = sent(1, 0, 1000, false);
    assert!(
        (80..98).contains(&lossy.len()) && lossy != sent(2, 0, 1000, false),
        "{lossy:?}"
    );
    assert_eq!(numbers(&sent(1, 0, 0, true))[..5], [0, 1, 0, 2, 1]);
}

// Fails if time passes by itself, if an action comes early or late, or out of order.
#[test]
fn time_passes_only_in_a_wait() {
    let world = World::new(1);
    let begun = world.now();
    let seen: Arc<Mutex<Vec<u128>>> = Arc::default();
    for ms in [3, 1, 7] {
        let (world, seen) = (world.clone(), Arc::clone(&seen));
        let at = world.clone();
        at.after(ms * MS, move || {
            seen.lock().expect("a lock").push((world.now() - begun).as_millis());
        });
    }
    std::thread::sleep(2 * MS);
    assert_eq!(world.now(), begun);
    world.sleep(5 * MS);
    assert_eq!(*seen.lock().expect("a lock"), [1, 3]);
    assert_eq!(world.now() - begun, 5 * MS);
}

/// Writes down its turns, each millisecond.
struct Turns(Arc<Mutex<u32>>);

impl Process for Turns {
    fn turn(&mut self, now: Instant) -> Instant {
        *self.0.lock().expect("a lock") += 1;
        now + MS
    }
}

// Fails if a process misses a turn, or has one after its end.
#[test]
fn a_process_runs_until_it_is_ended() {
    let world = World::new(1);
    let turns = Arc::default();
    let running = world
        .run("turns", Box::new(Turns(Arc::clone(&turns))))
        .expect("a process");
    world.sleep(10 * MS);
    drop(running);
    world.sleep(10 * MS);
    assert_eq!(*turns.lock().expect("a lock"), 11);
}

// Fails if a connection loses bytes, a cable that is out does not stop them, a closed end is not seen, or nobody can
// be connected to.
#[test]
fn connections_carry_bytes_and_close() {
    let world = World::new(1);
    let listener = world.listen(LOCAL).expect("a port");
    let to = listener.address().expect("an address");
    let mut client = world.connect(to, MS).expect("a connection");
    let (mut server, _) = listener.accept().expect("a client");
    assert!(listener.accept().is_err());
    let mut buffer = [0; 8];
    client.write_all(b"abc").expect("sent");
    assert_eq!(server.read(&mut buffer).expect("bytes"), 3);
    assert_eq!(&buffer[..3], b"abc");
    let nothing = server.read(&mut buffer).expect_err("nothing").kind();
    assert_eq!(nothing, ErrorKind::WouldBlock);

    world.faults().cable_out.store(true, Ordering::Relaxed);
    client.write_all(b"d").expect("sent");
    client.set_wait(Some(5 * MS)).expect("a wait");
    assert!(server.read(&mut buffer).is_err() && client.read(&mut buffer).is_err());
    assert_eq!(world.connect(to, MS).expect_err("no cable").kind(), ErrorKind::TimedOut);
    world.faults().cable_out.store(false, Ordering::Relaxed);
    assert_eq!(server.read(&mut buffer).expect("bytes"), 1);

    assert!(!client.is_closed());
    drop(server);
    assert!(client.is_closed());
    assert_eq!(client.read(&mut buffer).expect("an end"), 0);
    assert!(client.write_all(b"e").is_err());
    drop(listener);
    let refused = world.connect(to, MS).expect_err("nobody listens").kind();
    assert_eq!(refused, ErrorKind::ConnectionRefused);
}

// Fails if bytes of a connection that are late come at once, do not wake their reader, or are overtaken by later ones.
#[test]
fn late_bytes_come_in_their_order() {
    let world = World::new(1);
    let listener = world.listen(LOCAL).expect("a port");
    let to = listener.address().expect("an address");
    let mut client = world.connect(to, MS).expect("a connection");
    let (mut server, _) = listener.accept().expect("a client");
    let faults = world.faults();
    faults.late_us.store(5000, Ordering::Relaxed);
    faults.late.store(10_000, Ordering::Relaxed);
    client.write_all(b"ab").expect("sent");
    faults.late.store(0, Ordering::Relaxed);
    client.write_all(b"c").expect("sent");
    let mut buffer = [0; 8];
    assert!(server.read(&mut buffer).is_err());
    let begun = world.now();
    server.set_wait(Some(20 * MS)).expect("a wait");
    assert_eq!(server.read(&mut buffer).expect("bytes"), 3);
    assert_eq!((&buffer[..3], world.now() - begun), (&b"abc"[..], 5 * MS));
}
