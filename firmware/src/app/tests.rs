//! The control task with its queues behaves like a [`Node`], which has none.

use core::pin::pin;
use core::sync::atomic::{AtomicU32, Ordering};
use core::task::{Context, Poll, Waker};

use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_time::Instant;
use heapless::Deque;
use spherecal_shared::Joints;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveCommand, DriveMessage, DriveState};
use spherecal_shared::protocol::frame::{MAX_FRAME, encode};
use spherecal_shared::protocol::host::{Command, Downlink};
use spherecal_shared::robot::{Arm, Dynamics, iiwa7, iiwa7_tool};
use std::vec;
use std::vec::Vec;

use super::ports::{Clock, DrivePort, Probe, Tick};
use super::{ControlState, LinkSide, Mailbox, MailboxSignal, run_cycle};
use crate::link::CommandPort as _;
use crate::testing::HOME;
use crate::{HostLink, Node, Stopwatch};

/// A drive that delivers one state per tick.
#[derive(Default)]
struct Drive {
    states: Deque<DriveMessage, 1>,
    command: DriveCommand,
}

impl DrivePort for Drive {
    fn next_message(&mut self) -> Option<DriveMessage> {
        self.states.pop_front()
    }

    fn send(&mut self, command: &DriveCommand) {
        self.command = command.clone();
    }
}

impl Probe for Drive {}

/// A clock that gives the control path the drive's time.
struct DriveTime;

impl Clock for DriveTime {
    async fn next_tick(&mut self) -> Tick {
        core::future::pending().await
    }

    fn device_time(&self, _tick: &Tick, drive_us: u64) -> Instant {
        Instant::from_micros(drive_us)
    }
}

const TICK: Tick = Tick {
    at: Instant::MIN,
    missed: 0,
};

fn frame(sequence: u32, command: Command) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let length = encode(&Downlink::at_once(sequence, command), sequence, 0, &mut out).expect("it fits");
    out[..length].to_vec()
}

/// The bytes that the host sends before tick `tick`.
fn down(tick: u64) -> Vec<u8> {
    let mut target: Joints = HOME.iter().copied().collect();
    target[0] += 0.3;
    let tool = iiwa7_tool();
    let procedure = Procedure::default();
    let configure = Command::Configure { tool, procedure };
    match tick {
        0 => [
            frame(1, Command::Hello),
            frame(2, Command::Robot(iiwa7().driven().expect("seven joints"))),
        ]
        .concat(),
        1 => frame(3, configure),
        // A repeated number, and a command that is refused.
        2 => [frame(3, Command::Stop), frame(4, Command::Decouple)].concat(),
        // The arm does not follow: a fault.
        20 => frame(5, Command::Move { target }),
        1500 => frame(6, Command::ClearFault),
        _ => Vec::new(),
    }
}

fn state(tick: u64) -> DriveState {
    let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
    let gravity = arm.bodies(&arm.frames(&HOME)).gravity();
    DriveState {
        session: 1,
        tick,
        q: HOME.iter().copied().collect(),
        dq: [0.0; 7].into_iter().collect(),
        tau: gravity.iter().copied().collect(),
        ..DriveState::default()
    }
}

fn tick_finished(port: &mut LinkSide<'_, NoopRawMutex>) -> Instant {
    let wait = pin!(port.tick_finished());
    match wait.poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(now) => now,
        Poll::Pending => panic!("the tick was not announced"),
    }
}

// Fails if the queues between control task and link lose, reorder or delay
// anything: bytes to the host and torques, tick by tick, through commands, a
// repeat, a refusal, a fault, telemetry and statistics.
#[test]
fn queues_between_control_and_link_change_nothing() {
    let mut node = Node::<7>::new("one");
    node.controller().connect(&crate::testing::hello()).expect("a drive");
    let (mut mailbox, signal) = (Mailbox::new(), MailboxSignal::<NoopRawMutex>::new());
    let (mut host, mut port) = mailbox.split(&signal);
    let (mut link, mut control) = (HostLink::new("one", 7), ControlState::<7>::default());
    control.controller.connect(&crate::testing::hello()).expect("a drive");
    let mut drive = Drive::default();
    let mut compared = 0;
    for tick in 0..3000 {
        let (state, down) = (state(tick), down(tick));
        let time_us = tick * 1000;
        let (mut expected, mut up) = (vec![0; 8 * MAX_FRAME], vec![0; 8 * MAX_FRAME]);
        let (command, length) = node.exchange(Instant::from_micros(time_us), &state, &down, &mut expected);

        link.receive(&down, &mut port);
        drive
            .states
            .push_back(DriveMessage::State { state, time_us })
            .expect("the last one was taken");
        run_cycle(&mut control, &DriveTime, &TICK, &mut drive, &mut host).expect("the drive is there");
        let now = tick_finished(&mut port);
        let count = link.transmit(now, &mut up, &mut port);
        assert_eq!(drive.command, command, "torques of tick {tick}");
        assert_eq!(up[..count], expected[..length], "bytes of tick {tick}");
        compared += length;
    }
    assert!(compared > 20_000, "only {compared} bytes were compared");
    assert_eq!(signal.dropped(), 0);
}

// Fails if a host link that does not run stops the control task, or if values
// that find no room are lost without being counted.
#[test]
fn a_link_that_does_not_run_delays_nothing() {
    let (mut mailbox, signal) = (Mailbox::new(), MailboxSignal::<NoopRawMutex>::new());
    let (mut host, mut port) = mailbox.split(&signal);
    let (mut link, mut control) = (HostLink::new("one", 7), ControlState::<7>::default());
    control.controller.connect(&crate::testing::hello()).expect("a drive");
    let mut drive = Drive::default();
    for tick in 0..3000u64 {
        if tick < 3 {
            link.receive(&down(tick), &mut port);
        }
        let message = DriveMessage::State {
            state: state(tick),
            time_us: tick * 1000,
        };
        drive.states.push_back(message).expect("the last one was taken");
        run_cycle(&mut control, &DriveTime, &TICK, &mut drive, &mut host).expect("the drive is there");
        assert_eq!(drive.command.tick, tick);
    }
    assert!(
        control.controller.statistics().link.overflow > 0,
        "samples were dropped"
    );
    // Commands that do not fit the queue are not taken; the host repeats them.
    let before = link.counters().overflow;
    for sequence in 10..20 {
        link.receive(&frame(sequence, Command::Stop), &mut port);
    }
    assert_eq!(link.counters().overflow - before, 6);
}

// Fails if the host of a board does not learn what a control cycle costs and how many ticks came in
// time: between control task and link lies a queue.
#[test]
fn the_cost_of_a_cycle_reaches_the_host() {
    static COUNTER: AtomicU32 = AtomicU32::new(0);
    let (mut mailbox, signal) = (Mailbox::new(), MailboxSignal::<NoopRawMutex>::new());
    let (mut host, mut port) = mailbox.split(&signal);
    let mut control = ControlState::<7>::default();
    control.controller.connect(&crate::testing::hello()).expect("a drive");
    control.controller.set_stopwatch(Stopwatch {
        read: || COUNTER.fetch_add(3, Ordering::Relaxed),
        hz: 480_000_000,
        last: u32::MAX,
    });
    let mut drive = Drive::default();
    for tick in 0..3000u64 {
        let message = DriveMessage::State {
            state: state(tick),
            time_us: tick * 1000,
        };
        drive.states.push_back(message).expect("the last one was taken");
        run_cycle(&mut control, &DriveTime, &TICK, &mut drive, &mut host).expect("the drive is there");
        tick_finished(&mut port);
    }
    let (board, itself) = (port.statistics(), control.controller.statistics());
    assert_eq!((board.ticks, board.missed, board.late), (3000, 0, 0));
    assert_eq!(board.cost, itself.cost);
    // Each reading of the counter takes three counts.
    assert!(
        board.cost.hz == 480_000_000 && board.cost.whole.mean >= 3,
        "{:?}",
        board.cost
    );
}

// Fails if the skeleton that the boards' README shows is not the one that
// `scripts/cross.sh portable` checks.
#[test]
fn the_readme_shows_the_skeleton_of_a_board() {
    let readme = include_str!("../../boards/README.md");
    let skeleton = include_str!("../../boards/nucleo-h743zi/examples/skeleton.rs");
    assert!(readme.contains(&std::format!("```rust\n{skeleton}```\n")));
}
