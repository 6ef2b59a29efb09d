//! Programs that are held up.

use spherecal_shared::protocol::frame::{self, Accumulator};
use spherecal_shared::protocol::host::{Command, Downlink};

use super::*;
use crate::HostEndpoint;

/// Longest wait for an end that must come, on a busy machine.
const END: Duration = Duration::from_mins(1);

/// A device of 1 kHz that says one byte in each period. What it hears leaves it.
struct Clocked {
    waits: bool,
    ticks: u64,
    heard: Arc<Mutex<Vec<(u64, Vec<u8>)>>>,
    fails_at: u64,
}

impl Device for Clocked {
    fn waits(&self) -> bool {
        self.waits
    }

    fn now_us(&self) -> u64 {
        1_000 * self.ticks
    }

    fn ticks(&self) -> u64 {
        self.ticks
    }

    fn step(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        if !self.waits {
            std::thread::sleep(Duration::from_millis(1));
        }
        if !down.is_empty() {
            self.heard.lock().expect("sound").push((self.ticks, down.to_vec()));
        }
        self.ticks += 1;
        up.push(self.ticks as u8);
        if self.ticks == self.fails_at {
            return Err(LinkError::device(std::io::Error::other("the cable")));
        }
        Ok(())
    }

    fn move_plate(&mut self, place: u32) -> bool {
        place == 2
    }
}

type Heard = Arc<Mutex<Vec<(u64, Vec<u8>)>>>;

fn clocked(waits: bool, fails_at: u64) -> (Attended, Heard) {
    let heard = Heard::default();
    let device = Clocked {
        waits,
        ticks: 0,
        heard: heard.clone(),
        fails_at,
    };
    (Attended::start(device).expect("a thread"), heard)
}

// Fails if a controller hears nothing for the 2 s after which it stops the arm while its host is held up, if a byte of it
// is lost, if it hears commands, or if the host's clock stands meanwhile: what it asks next would be late from the start.
#[test]
fn a_controller_whose_time_does_not_wait_is_kept_alive() {
    let (mut device, heard) = clocked(false, 0);
    let endpoint = HostEndpoint::new(Timing::default());
    device.keep_alive(endpoint.keep_alives());
    let mut up = Vec::new();
    device.step(&[], &mut up).expect("a period");
    std::thread::sleep(Duration::from_millis(1_200));
    let now_us = device.now_us();
    assert!(now_us > 100_000, "the device has stood still: {now_us} us");
    device.step(b"order", &mut up).expect("all periods since");
    device.step(&[], &mut up).expect("a period");
    device.step(&[], &mut up).expect("a period");
    let said: Vec<u8> = (1..=up.len()).map(|tick| tick as u8).collect();
    assert_eq!(up, said);
    assert!(up.len() as u64 >= now_us / 1_000, "{} of {now_us} us", up.len());
    let heard = heard.lock().expect("sound").clone();
    assert_eq!(heard.last().expect("the order").1, b"order");
    let mut before = 0;
    for (tick, bytes) in heard {
        assert!(tick - before < 1_000, "silent from {before} to {tick}");
        before = tick;
        let mut accumulator = Accumulator::default();
        for byte in bytes {
            accumulator.push(byte, &mut |bytes| {
                let (_, message) = bytes.and_then(frame::decode::<Downlink>).expect("a whole frame");
                assert_eq!(
                    (message.command, message.session),
                    (Command::KeepAlive, endpoint.session())
                );
            });
        }
    }
}

// Fails if a program that hangs for good holds an arm on a sphere for good.
#[test]
fn a_program_that_hangs_keeps_no_controller() {
    let (mut device, _) = clocked(false, 0);
    device.step(&[], &mut Vec::new()).expect("a period");
    let (begun, mut before) = (Instant::now(), 0);
    while device.ticks() != before {
        assert!(begun.elapsed() < END, "the controller is kept alive for ever");
        before = device.ticks();
        std::thread::sleep(Duration::from_millis(300));
    }
    // What has come meanwhile, and a period more.
    for _ in 0..2 {
        device.step(&[], &mut Vec::new()).expect("it goes on");
    }
    assert!(device.ticks() > before);
}

// Fails if a simulation in lock-step goes on by the time that its host takes: its bits would depend on the host.
#[test]
fn a_device_in_lock_step_stands_still() {
    let (mut device, heard) = clocked(true, 0);
    device.keep_alive(HostEndpoint::new(Timing::default()).keep_alives());
    for ticks in 1..40u64 {
        let mut up = Vec::new();
        device.step(&[7], &mut up).expect("a period");
        assert_eq!((up, device.ticks()), (vec![ticks as u8], ticks));
        std::thread::sleep(Duration::from_millis(10));
        assert_eq!(device.ticks(), ticks);
    }
    assert!(heard.lock().expect("sound").iter().all(|(_, bytes)| bytes == &[7]));
    assert!(device.move_plate(2) && !device.move_plate(1));
}

// Fails if a link that fails is not told, if what came before is lost, or if the next step waits for ever.
#[test]
fn a_link_that_fails_is_told() {
    let (mut device, _) = clocked(false, 5);
    let mut up = Vec::new();
    device.step(&[], &mut up).expect("a period");
    let failed = std::iter::repeat_with(|| device.step(&[], &mut up).err())
        .flatten()
        .next();
    assert!(failed.expect("an error").to_string().contains("the cable"));
    assert_eq!(up, [1, 2, 3, 4]);
    assert!(device.step(&[], &mut up).is_err());
}

/// The fixed priority of this thread; 0 is that of an ordinary one.
#[cfg(target_os = "linux")]
fn priority() -> u32 {
    let stat = std::fs::read_to_string("/proc/thread-self/stat").expect("Linux");
    // The second field, the name, ends with a bracket; this is the fortieth.
    let fields = stat.rsplit_once(')').expect("a name").1;
    let field = fields.split_whitespace().nth(37).expect("forty fields");
    field.parse().expect("a number")
}

/// A device that says the priority of the thread that serves it.
#[cfg(target_os = "linux")]
struct Scheduled {
    waits: bool,
}

#[cfg(target_os = "linux")]
impl Device for Scheduled {
    fn waits(&self) -> bool {
        self.waits
    }

    fn now_us(&self) -> u64 {
        0
    }

    fn ticks(&self) -> u64 {
        0
    }

    fn step(&mut self, _down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        up.push(priority() as u8);
        std::thread::sleep(Duration::from_millis(1));
        Ok(())
    }

    fn move_plate(&mut self, _place: u32) -> bool {
        false
    }
}

// Fails if the exchange with a controller whose time does not wait is done by an ordinary thread although the system permits
// more, or if one in lock-step, which takes as much of a processor as there is, goes ahead of others.
#[cfg(target_os = "linux")]
#[test]
fn only_what_cannot_wait_goes_ahead() {
    let permitted = std::thread::spawn(|| {
        spherecal_realtime::go_ahead();
        priority()
    });
    let permitted = permitted.join().expect("no panic") as u8;
    for (waits, expected) in [(false, permitted), (true, 0)] {
        let mut device = Attended::start(Scheduled { waits }).expect("a thread");
        let mut up = Vec::new();
        for _ in 0..3 {
            device.step(&[], &mut up).expect("a period");
        }
        assert_eq!((up[0], up[up.len() - 1]), (0, expected), "waits: {waits}");
    }
}
