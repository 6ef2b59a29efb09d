//! The link tasks, the clock of the drive's states and the control task on one simulated
//! core, with the UARTs of [`uart_model`](super::uart_model). While the control task runs, no
//! other task runs.

use core::cell::Cell;
use core::future::Future;
use core::pin::Pin;
use core::task::{Context, Waker};

use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_time::{Duration, Instant};
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState};
use spherecal_shared::protocol::frame::{Accumulator, MAX_FRAME, Message, decode, encode};
use spherecal_shared::protocol::host::{Command, Downlink, Event, Sample, Statistics, Uplink};
use spherecal_shared::robot::{iiwa7, iiwa7_tool};
use std::boxed::Box;
use std::rc::Rc;
use std::vec::Vec;

use super::links::Links;
use super::ports::{Clock, Tick};
use super::supervisor::{Part, Supervisor};
use super::uart_model::{Carrier, NOW_US, Reader, Receiver, STEP_US, Shared, Transmitter, Writer};
use super::{ControlState, Mailbox, MailboxSignal, StateClock, run};
use crate::HostLink;
use crate::testing::HOME;

/// A clock that counts its ticks, and those without a new state.
struct CountedClock {
    clock: StateClock<'static, NoopRawMutex>,
    supervisor: Supervisor,
    links: &'static Links<NoopRawMutex>,
    ticks: Rc<Cell<u64>>,
    silent: Rc<Cell<Option<Part>>>,
}

impl Clock for CountedClock {
    fn start(&mut self) {
        self.clock.start();
    }

    fn set_period(&mut self, period: Duration) {
        self.clock.set_period(period);
    }

    async fn next_tick(&mut self) -> Tick {
        let tick = self.clock.next_tick().await;
        self.ticks.set(self.ticks.get() + 1);
        if let Err(part) = self.supervisor.check(tick.at.as_micros(), self.links.pulse()) {
            self.silent.set(self.silent.get().or(Some(part)));
        }
        tick
    }

    fn device_time(&self, tick: &Tick, _drive_us: u64) -> Instant {
        tick.at
    }
}

type Task = Pin<Box<dyn Future<Output = ()>>>;

/// A task that does not end, as one that has no result.
async fn endless(task: impl Future) {
    task.await;
}

/// A board on its wires.
struct Board {
    control: Task,
    below: Vec<(Part, Task)>,
    /// The control task occupies the core until then.
    busy_us: u64,
    /// How long a control cycle takes.
    cycle_us: u64,
    links: &'static Links<NoopRawMutex>,
    from_drive: Shared<Receiver>,
    to_drive: Shared<Transmitter>,
    from_host: Shared<Receiver>,
    to_host: Shared<Transmitter>,
    ticks: Rc<Cell<u64>>,
    silent: Rc<Cell<Option<Part>>>,
    dead: Option<Part>,
    /// Numbers of the next frames of drive and host.
    sequences: [u32; 2],
    noise: u64,
}

impl Board {
    fn new(carrier: Carrier) -> Self {
        NOW_US.set(0);
        let links: &'static Links<NoopRawMutex> = Box::leak(Box::new(Links::new()));
        let signal: &'static MailboxSignal<NoopRawMutex> = Box::leak(Box::new(MailboxSignal::new()));
        let (control_side, mut link_side) = Box::leak(Box::new(Mailbox::new())).split(signal);
        let (from_drive, to_drive) = (Receiver::new(carrier, 3_000_000), Transmitter::new(3_000_000));
        let (from_host, to_host) = (Receiver::new(carrier, 921_600), Transmitter::new(921_600));
        let (ticks, silent) = (Rc::new(Cell::new(0)), Rc::new(Cell::new(None)));
        let mut clock = CountedClock {
            clock: StateClock::new(links),
            supervisor: Supervisor::default(),
            links,
            ticks: Rc::clone(&ticks),
            silent: Rc::clone(&silent),
        };
        let control = Box::pin(async move {
            let mut state = Box::<ControlState<7>>::default();
            let (mut drive, mut host) = (links, control_side);
            run(&mut state, &mut clock, &mut drive, &mut host).await;
        });
        let (mut drive_in, mut drive_out) = (Reader(Rc::clone(&from_drive)), Writer(Rc::clone(&to_drive)));
        let (mut host_in, mut host_out) = (Reader(Rc::clone(&from_host)), Writer(Rc::clone(&to_host)));
        let mut link = HostLink::new("a test", 7)
            .resending_after(Duration::from_millis(50))
            .with_bandwidth(92_160);
        let below: Vec<(Part, Task)> = Vec::from([
            (
                Part::DriveIn,
                Box::pin(endless(async move { links.drive_in(&mut drive_in).await })) as Task,
            ),
            (
                Part::DriveOut,
                Box::pin(endless(async move { links.drive_out(&mut drive_out).await })),
            ),
            (
                Part::HostIn,
                Box::pin(endless(async move { links.host_in(&mut host_in).await })),
            ),
            (
                Part::HostLink,
                Box::pin(endless(async move {
                    let mut buffer = [0; 2 * MAX_FRAME];
                    links.serve_host(&mut link, &mut link_side, &mut buffer).await
                })),
            ),
            (
                Part::HostOut,
                Box::pin(endless(async move { links.host_out(&mut host_out).await })),
            ),
            (
                Part::Thread,
                Box::pin(endless(async move {
                    loop {
                        links.pulse().beat(Part::Thread);
                        embassy_time::Timer::after_millis(5).await;
                    }
                })),
            ),
        ]);
        Self {
            control,
            below,
            busy_us: 0,
            cycle_us: 130,
            links,
            from_drive,
            to_drive,
            from_host,
            to_host,
            ticks,
            silent,
            dead: None,
            sequences: [0; 2],
            noise: 1,
        }
    }

    /// The hardware and the tasks until `until_us`.
    fn run_until(&mut self, until_us: u64) {
        let mut context = Context::from_waker(Waker::noop());
        while NOW_US.get() < until_us {
            let now = NOW_US.get() + STEP_US;
            NOW_US.set(now);
            let blocked = now < self.busy_us;
            for port in [&self.from_drive, &self.from_host] {
                port.borrow_mut().advance(now as f64, blocked);
            }
            if blocked {
                continue;
            }
            for k in 0..=self.below.len() {
                // The control task interrupts those below it.
                let ticks = self.ticks.get();
                let _ = self.control.as_mut().poll(&mut context);
                if self.ticks.get() > ticks {
                    self.busy_us = now + self.cycle_us;
                    break;
                }
                if let Some((part, task)) = self.below.get_mut(k)
                    && self.dead != Some(*part)
                {
                    let _ = task.as_mut().poll(&mut context);
                }
            }
        }
    }

    fn frame<M: Message>(&mut self, side: usize, message: &M) -> Vec<u8> {
        let mut out = [0; MAX_FRAME];
        let length = encode(message, self.sequences[side], NOW_US.get(), &mut out).expect("it fits");
        self.sequences[side] += 1;
        out[..length].to_vec()
    }

    fn noise(&mut self) -> f64 {
        self.noise = self.noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (self.noise >> 11) as f64 / (1u64 << 53) as f64
    }

    fn hello(&mut self) {
        let hello = DriveHello::new(1, iiwa7().joints.iter().map(|joint| joint.limits));
        let frame = self.frame(0, &hello);
        self.from_drive.borrow_mut().send(NOW_US.get() as f64, &frame);
    }

    /// Runs `count` periods of a drive whose clock is 50 ppm fast and whose states are up to
    /// `jitter_us` late.
    fn drive(&mut self, first: u64, count: u64, jitter_us: f64) {
        for tick in first..first + count {
            let at_us = 2000.0 + tick as f64 * 1000.0 / 1.000_05 + jitter_us * self.noise();
            self.run_until(at_us as u64);
            let q = HOME.map(|q| q + 1e-6 * self.noise());
            let dq = [0.0; 7].map(|_: f64| 1e-3 * (self.noise() - 0.5));
            let state = DriveState {
                session: 1,
                tick,
                q: q.into_iter().collect(),
                dq: dq.into_iter().collect(),
                tau: [0.0; 7].map(|_: f64| 0.1 * self.noise()).into_iter().collect(),
                ..DriveState::default()
            };
            let frame = self.frame(0, &state);
            self.from_drive.borrow_mut().send(at_us, &frame);
        }
    }

    fn order(&mut self, sequence: u32, command: Command) {
        let frame = self.frame(1, &Downlink::at_once(sequence, command));
        self.from_host.borrow_mut().send(NOW_US.get() as f64, &frame);
    }

    /// Ticks of the commands that the drive got.
    fn commands(&self) -> Vec<u64> {
        frames::<DriveCommand>(&self.to_drive).iter().map(|c| c.tick).collect()
    }

    fn events(&self) -> Vec<Event> {
        frames::<Uplink>(&self.to_host).into_iter().map(|u| u.body).collect()
    }

    fn statistics(&self) -> Statistics {
        let statistics = |event: &Event| match event {
            Event::Statistics(statistics) => Some(*statistics),
            _ => None,
        };
        self.events().iter().rev().find_map(statistics).expect("statistics")
    }
}

fn frames<M: Message>(port: &Shared<Transmitter>) -> Vec<M> {
    let (mut accumulator, mut found) = (Accumulator::new(), Vec::new());
    for byte in &port.borrow().sent {
        accumulator.push(*byte, &mut |frame| {
            if let Ok((_, message)) = frame.and_then(decode::<M>) {
                found.push(message);
            }
        });
    }
    found
}

// Fails if DMA and the clock of the states leave one of 3,000 ticks without its state, run
// a tick without one, lose a frame, or answer a state late. The drive's clock is 50 ppm fast,
// its states jitter by 300 µs, and a cycle takes 130 µs in which no interrupt is served.
#[test]
fn dma_and_the_drives_clock_lose_nothing() {
    let mut board = Board::new(Carrier::Dma);
    board.hello();
    board.order(1, Command::Hello);
    board.drive(0, 3_000, 300.0);
    board.run_until(NOW_US.get() + 1200);
    let commands = board.commands();
    // The hello starts a cycle of its own before the first state.
    assert!(commands.into_iter().eq(0..3_000), "every state is answered, once");
    assert!(board.ticks.get() <= 3_000 + 5, "{} ticks", board.ticks.get());
    let statistics = board.statistics();
    assert_eq!(
        (statistics.missed, statistics.drive.lost, statistics.drive.crc_errors),
        (0, 0, 0)
    );
    assert!(statistics.drive.frames > 2_000);
    assert_eq!((board.links.dropped(), board.silent.get()), ((0, 0, 0), None));
}

// Fails if the model of the UART is better than a real one: with interrupts instead of DMA,
// in the same place, the FIFO must overflow when a state begins during the cycle of the one
// before, and the link must count the damaged states.
#[test]
fn a_fifo_of_sixteen_loses_states() {
    let mut board = Board::new(Carrier::Fifo);
    board.hello();
    board.order(1, Command::Hello);
    board.drive(0, 3_000, 300.0);
    let lost = board.from_drive.borrow().lost;
    let statistics = board.statistics();
    // Once it has begun, every cycle falls into the next state.
    assert!(
        lost > 200 && statistics.drive.crc_errors > 20,
        "{lost} bytes, {:?}",
        statistics.drive
    );
}

// Fails if a stall of the control task, longer than the ring holds, stops the link for good,
// or if the lost bytes are not counted.
#[test]
fn an_overrun_ring_starts_again() {
    let mut board = Board::new(Carrier::Dma);
    board.hello();
    board.order(1, Command::Hello);
    board.drive(0, 100, 0.0);
    // 2,048 bytes are ten states.
    board.busy_us = NOW_US.get() + 15_000;
    board.drive(100, 1_100, 0.0);
    assert!(board.from_drive.borrow().lost > 2000);
    let commands = board.commands();
    let expected: Vec<u64> = (200..1_190).collect();
    let after: Vec<u64> = commands
        .into_iter()
        .filter(|tick| (200..1_190).contains(tick))
        .collect();
    assert!(
        after == expected,
        "{} of {} states answered after the stall",
        after.len(),
        expected.len()
    );
    assert!(board.statistics().missed >= 10);
    assert!(board.links.dropped().2 > 0, "the overrun is counted");
}

// Fails if a transmitter that loses a wake-up stops its link for good, or stops the other
// link, or makes the watchdog reset a board that goes on by itself.
#[test]
fn a_lost_wake_up_delays_its_link_only() {
    for host in [true, false] {
        let mut board = Board::new(Carrier::Dma);
        let port = if host { &board.to_host } else { &board.to_drive };
        // The host's wire carries statistics once a second.
        port.borrow_mut().hang = Some(if host { 900_000..1_030_000 } else { 300_000..340_000 });
        board.hello();
        board.order(1, Command::Hello);
        board.drive(0, 2_100, 100.0);
        let commands = board.commands();
        let late = commands.iter().filter(|tick| **tick >= 400).count();
        assert!(late > 1_690, "{late} commands after the hang, host {host}");
        assert!(
            board
                .events()
                .iter()
                .filter(|e| matches!(e, Event::Statistics(_)))
                .count()
                >= 2
        );
        assert!(
            (2..=4).contains(&board.links.dropped().2) || host,
            "{:?}",
            board.links.dropped()
        );
        assert!(board.links.dropped().2 > 0, "the writes that were given up are counted");
        assert_eq!(board.silent.get(), None);
    }
}

// Fails if a task that is not run any more keeps the watchdog fed.
#[test]
fn a_dead_task_is_noticed() {
    for part in Part::ALL {
        let mut board = Board::new(Carrier::Dma);
        board.hello();
        board.drive(0, 100, 0.0);
        assert_eq!(board.silent.get(), None);
        board.dead = Some(part);
        board.drive(100, 25, 0.0);
        assert_eq!(board.silent.get(), Some(part));
    }
}

// Fails if telemetry at 1 kHz takes more than 60 % of a link of 92 kB/s and the rest of the
// wire's time, if its samples are not evenly spaced, or if events and statistics wait for it.
#[test]
fn telemetry_leaves_room_on_a_slow_wire() {
    let mut board = Board::new(Carrier::Dma);
    let mut procedure = Procedure::default();
    procedure.telemetry.other_ticks = 1;
    let tool = iiwa7_tool();
    board.hello();
    board.drive(0, 10, 0.0);
    board.order(1, Command::Hello);
    board.drive(10, 30, 0.0);
    board.order(2, Command::Robot(iiwa7().driven().expect("seven joints")));
    board.drive(40, 60, 0.0);
    board.order(3, Command::Configure { tool, procedure });
    board.drive(100, 100, 0.0);
    let before = board.to_host.borrow().sent.len();
    for second in 0..2 {
        board.order(0, Command::KeepAlive);
        board.drive(200 + 1000 * second, 1000, 300.0);
    }
    let bytes = board.to_host.borrow().sent.len() - before;
    let samples: Vec<Sample> = board
        .events()
        .into_iter()
        .filter_map(|event| {
            if let Event::Telemetry(batch) = event {
                Some(batch)
            } else {
                None
            }
        })
        .flatten()
        .collect();
    let spaced = samples
        .windows(2)
        .skip(20)
        .all(|pair| (3..=4).contains(&(pair[1].tick - pair[0].tick)));
    assert!(spaced && samples.len() > 450, "{} samples", samples.len());
    assert!((2 * 40_000..2 * 58_000).contains(&bytes), "{bytes} bytes in 2 s");
    let statistics = board
        .events()
        .iter()
        .filter(|e| matches!(e, Event::Statistics(_)))
        .count();
    assert!(statistics >= 2, "{statistics}");
    assert_eq!(board.links.dropped(), (0, 0, 0));
    assert_eq!(board.statistics().link.overflow, 0);
}
