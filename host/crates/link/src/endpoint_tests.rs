use super::*;
use proptest::prelude::*;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use spherecal_shared::protocol::frame::MAX_FRAME;
use spherecal_shared::protocol::host::Banner;
use spherecal_shared::protocol::{PROTOCOL_VERSION, SCHEMA};
use std::convert::Infallible;

/// The other end, as simple as the protocol allows. It numbers its events, sends each until it is
/// acknowledged, answers every command and carries out each command once.
#[derive(Default)]
struct TestPeer {
    accumulator: Accumulator,
    frames: u32,
    session: SessionId,
    last_command: u32,
    carried_out: Vec<u32>,
    waiting: VecDeque<(u32, u64)>,
    produced: u32,
}

impl TestPeer {
    fn exchange(&mut self, now_us: u64, down: &[u8], events: u32, up: &mut Vec<Vec<u8>>) {
        let mut heard = Vec::new();
        for &byte in down {
            self.accumulator.push(byte, &mut |frame| {
                if let Ok((_, message)) = frame.and_then(frame::decode::<Downlink>) {
                    heard.push(message);
                }
            });
        }
        for message in heard {
            match message.command {
                Command::Acknowledge { event } => self.waiting.retain(|w| w.0 != event),
                Command::KeepAlive => {}
                _ => {
                    if matches!(message.command, Command::Hello) {
                        self.session = message.session;
                        let banner = self.banner();
                        up.push(self.frame(0, Event::Banner(banner), now_us));
                    }
                    if message.sequence == self.last_command + 1 {
                        self.last_command = message.sequence;
                        self.carried_out.push(message.sequence);
                    }
                    let reply = Event::Reply {
                        sequence: message.sequence,
                        result: Ok(()),
                    };
                    up.push(self.frame(0, reply, now_us));
                }
            }
        }
        if self.produced < events && self.waiting.len() < 8 {
            self.produced += 1;
            self.waiting.push_back((self.produced, 0));
        }
        for k in 0..self.waiting.len() {
            let (event, sent) = self.waiting[k];
            if sent == 0 || now_us - sent >= 30_000 {
                self.waiting[k].1 = now_us;
                up.push(self.frame(event, Event::Passed { pose: event }, now_us));
            }
        }
    }

    fn banner(&self) -> Banner {
        Banner {
            protocol: PROTOCOL_VERSION,
            schema: SCHEMA,
            version: heapless::String::new(),
            build: heapless::String::new(),
            joints: 7,
            period_us: 1000,
            first_event: self.waiting.front().map_or(self.produced + 1, |w| w.0),
        }
    }

    fn frame(&mut self, event: u32, body: Event, now_us: u64) -> Vec<u8> {
        let mut bytes = [0u8; MAX_FRAME];
        let session = self.session;
        let length = frame::encode(&Uplink { session, event, body }, self.frames, now_us, &mut bytes).expect("it fits");
        self.frames += 1;
        bytes[..length].to_vec()
    }
}

/// Loses, repeats, delays (and so reorders) and damages frames.
struct Channel {
    rng: ChaCha8Rng,
    bad: f64,
    late: Vec<(u64, Vec<u8>)>,
}

impl Channel {
    fn pass(&mut self, now_us: u64, frames: Vec<Vec<u8>>) -> Vec<u8> {
        for mut frame in frames {
            if self.rng.random_bool(self.bad) {
                continue;
            }
            if self.rng.random_bool(self.bad) {
                let bit = self.rng.random_range(0..frame.len() * 8);
                frame[bit / 8] ^= 1 << (bit % 8);
            }
            if self.rng.random_bool(self.bad) {
                self.late
                    .push((now_us + self.rng.random_range(1..60_000), frame.clone()));
            }
            let delay = if self.rng.random_bool(self.bad) {
                self.rng.random_range(1..20_000)
            } else {
                0
            };
            self.late.push((now_us + delay, frame));
        }
        let (due, late) = std::mem::take(&mut self.late)
            .into_iter()
            .partition::<Vec<_>, _>(|f| f.0 <= now_us);
        self.late = late;
        due.into_iter().flat_map(|f| f.1).collect()
    }
}

fn split(bytes: &[u8]) -> Vec<Vec<u8>> {
    bytes.split_inclusive(|b| *b == 0).map(<[u8]>::to_vec).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]
    // Fails if an event is lost, repeated or out of order, if a command is
    // carried out twice or never, or if the endpoint stops before all is said.
    #[test]
    fn a_bad_link_loses_nothing_and_repeats_nothing(seed: u64, bad in 0.0f64..0.25) {
        let (events, commands) = (60, 20);
        let mut endpoint = HostEndpoint::new(Timing::default());
        let mut peer = TestPeer::default();
        let channel = |k| Channel { rng: ChaCha8Rng::seed_from_u64(seed ^ k), bad, late: Vec::new() };
        let (mut to_peer, mut to_host) = (channel(1), channel(2));
        let (mut stored, mut handed_on, mut replies) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..commands {
            endpoint.send(if k == 0 { Command::Hello } else { Command::Stop });
        }
        for tick in 1..60_000u64 {
            let now = tick * 1000;
            let mut down = Vec::new();
            endpoint.transmit(now, &mut down).expect("it fits");
            let down = to_peer.pass(now, split(&down));
            let mut up = Vec::new();
            peer.exchange(now, &down, events, &mut up);
            let up = to_host.pass(now, up);
            let mut arrived = Vec::new();
            endpoint
                .receive::<Infallible>(&up, &mut arrived, |batch| {
                    stored.extend(batch.iter().map(|a| a.event));
                    Ok(())
                })
                .expect("infallible");
            for arrival in arrived {
                match arrival.body {
                    Event::Reply { sequence, .. } => replies.push(sequence),
                    Event::Passed { pose } => handed_on.push(pose),
                    _ => {}
                }
            }
            if replies.len() == 20 && handed_on.len() == 60 && peer.waiting.is_empty() {
                break;
            }
        }
        prop_assert_eq!(&stored, &(1..=events).collect::<Vec<_>>());
        prop_assert_eq!(&handed_on, &stored);
        prop_assert_eq!(&peer.carried_out, &(1..=commands).collect::<Vec<_>>());
        prop_assert_eq!(&replies, &peer.carried_out);
        prop_assert!(peer.waiting.is_empty(), "every event is acknowledged in the end");
    }
}

#[test]
fn nothing_is_acknowledged_that_was_not_stored() {
    let mut endpoint = HostEndpoint::new(Timing::default());
    let mut peer = TestPeer::default();
    let mut up = Vec::new();
    let mut down = Vec::new();
    endpoint.send(Command::Hello);
    endpoint.transmit(1000, &mut down).expect("it fits");
    peer.exchange(1000, &down, 1, &mut up);
    let mut arrived = Vec::new();
    let refused = endpoint.receive(&up.concat(), &mut arrived, |_| Err("disk full"));
    assert_eq!(
        (refused, arrived.iter().filter(|a| a.event > 0).count()),
        (Err("disk full"), 0)
    );
    down.clear();
    endpoint.transmit(2000, &mut down).expect("it fits");
    peer.exchange(2000, &down, 1, &mut Vec::new());
    assert_eq!(peer.waiting.len(), 1, "not acknowledged");

    // The disk has room again: no new bytes are needed.
    let stored = endpoint.receive::<Infallible>(&[], &mut arrived, |batch| {
        assert_eq!(batch.len(), 1);
        Ok(())
    });
    assert!(stored.is_ok() && arrived.last().is_some_and(|a| a.event == 1));
    down.clear();
    endpoint.transmit(3000, &mut down).expect("it fits");
    peer.exchange(3000, &down, 1, &mut Vec::new());
    assert!(peer.waiting.is_empty(), "acknowledged once stored");
}

#[test]
fn a_silent_host_says_that_it_lives() {
    let mut endpoint = HostEndpoint::new(Timing::default());
    let mut frames = 0;
    for tick in 0..2000u64 {
        let mut down = Vec::new();
        endpoint.transmit(tick * 1000, &mut down).expect("it fits");
        frames += split(&down).len();
    }
    assert_eq!(frames, 8, "one at once and one every 250 ms");
}
