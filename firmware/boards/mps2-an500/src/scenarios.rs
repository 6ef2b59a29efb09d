//! What the image does, one function for each scenario.

use embassy_executor::SendSpawner;
use embassy_time::{Duration, Instant, Ticker, Timer};
use spherecal_board::ControlSide;
use spherecal_firmware::Stopwatch;
use spherecal_firmware::app::links::DriveClock;
use spherecal_firmware::app::ports::{Clock, Tick};
use spherecal_firmware::app::{ControlState, Ended, PERIOD, run as run_control};
use spherecal_shared::protocol::lockstep::MAX_HOST;
use spherecal_shared::timing::PeriodWatch;
use static_cell::StaticCell;

use crate::arguments::Scenario;
use crate::executor;
use crate::log::{self, Sink};
use crate::pipe::{self, LockStep, Messages, Pipe};
use crate::semihosting;
use crate::stack;
use crate::timer::{self, stopwatch};
use crate::uart::{UART0, UART1, Uart};

/// Joints of the arm.
const JOINTS: usize = 7;
/// Start value of the counter in [`Scenario::Wrap`]: half a second before it wraps.
pub const COUNTS_TO_WRAP: u32 = timer::HZ / 2;

spherecal_board::controller! {
    joints: JOINTS,
    drive: (&'static Uart, &'static Uart),
    host: (&'static Uart, &'static Uart),
    tick_bytes: MAX_HOST,
}

/// The state of the control task, which measures its cycles by SysTick.
fn measured_state() -> &'static mut ControlState<JOINTS> {
    let state = control_state();
    state.controller.set_stopwatch(Stopwatch {
        read: || stopwatch::between(0, stopwatch::read()),
        hz: timer::HZ,
        last: stopwatch::between(0, 1),
    });
    state
}

/// Runs `scenario`; the log goes to `sink`.
pub fn run(scenario: Scenario, sink: Sink) -> ! {
    let control = executor::start_control();
    let links = executor::start_link();
    match scenario {
        Scenario::Pipe | Scenario::Hog => start_pipe(control, links, sink, false),
        Scenario::Steps => start_pipe(control, links, sink, true),
        Scenario::Uart => start_uarts(control, links, sink),
        Scenario::Wrap => control.spawn(spawned(wrapped(sink))),
        Scenario::Stages => crate::stages::run(),
    }
    // The stack that the start has used is free again. From here on the paint
    // shows what the tasks use, at all priorities together.
    stack::paint();
    executor::run_thread(|spawner| {
        spawner.spawn(spawned(log::task(sink)));
        if scenario == Scenario::Hog {
            spawner.spawn(spawned(hog()));
        }
    })
}

// Not inlined, so that what it builds on the stack does not stay there.
#[inline(never)]
fn start_pipe(control: SendSpawner, links: SendSpawner, sink: Sink, steps: bool) {
    static MESSAGES: StaticCell<Messages> = StaticCell::new();
    static PIPE: StaticCell<Pipe> = StaticCell::new();
    let (producer, consumer) = MESSAGES.init(Messages::new()).split();
    let Some(pipe) = Pipe::open(producer, host_link(|link| link)) else {
        semihosting::exit(crate::EXIT_HOST);
    };
    let pipe = PIPE.init(pipe);
    let (host, mailbox) = mailbox();
    let (state, drive) = (measured_state(), LockStep::new(consumer));
    if steps {
        control.spawn(spawned(stepped(state, drive, host, sink)));
    } else {
        control.spawn(spawned(piped(state, drive, host, sink)));
    }
    links.spawn(spawned(serve(pipe, mailbox)));
}

#[inline(never)]
fn start_uarts(control: SendSpawner, links: SendSpawner, sink: Sink) {
    UART0.start();
    UART1.start();
    let (host, mailbox) = mailbox();
    control.spawn(spawned(wired(measured_state(), host, sink)));
    let link = host_link(|link| link);
    if spawn_links(&links, link, mailbox, (&UART0, &UART0), (&UART1, &UART1)).is_err() {
        semihosting::exit(crate::EXIT_FAILED);
    }
}

/// The token of a task. Each task is spawned once, so its memory is free.
fn spawned<S>(
    token: Result<embassy_executor::SpawnToken<S>, embassy_executor::SpawnError>,
) -> embassy_executor::SpawnToken<S> {
    token.unwrap_or_else(|_| semihosting::exit(crate::EXIT_FAILED))
}

/// Writes the log to its file and ends the process.
fn finish(sink: Sink, ended: Ended) -> ! {
    let (used, room) = stack::used();
    defmt::info!("ended: {}, stack {} of {} bytes", ended, used, room);
    sink.empty();
    semihosting::exit(match ended {
        Ended::DriveGone => 0,
        Ended::DriveRefused => crate::EXIT_DRIVE,
    })
}

#[embassy_executor::task]
async fn piped(state: &'static mut ControlState<JOINTS>, mut drive: LockStep, mut host: ControlSide, sink: Sink) {
    let mut clock = LockStepClock::start().await;
    let ended = run_control(state, &mut clock, &mut drive, &mut host).await;
    defmt::info!(
        "ticks: {} since the last missed one, {} counts early to {} counts late at 25 MHz",
        clock.ticks,
        clock.early,
        clock.late
    );
    finish(sink, ended)
}

#[embassy_executor::task]
async fn stepped(state: &'static mut ControlState<JOINTS>, mut drive: LockStep, mut host: ControlSide, sink: Sink) {
    let ended = run_control(state, &mut ExchangeClock, &mut drive, &mut host).await;
    finish(sink, ended)
}

/// A clock that ticks with each exchange on the pipe.
struct ExchangeClock;

impl Clock for ExchangeClock {
    async fn next_tick(&mut self) -> Tick {
        pipe::EXCHANGE.wait().await;
        Tick {
            at: Instant::now(),
            missed: 0,
        }
    }

    fn device_time(&self, _tick: &Tick, drive_us: u64) -> Instant {
        Instant::from_micros(drive_us)
    }
}

#[embassy_executor::task]
async fn serve(pipe: &'static mut Pipe, mut mailbox: spherecal_board::LinkSide) {
    pipe.serve(&mut mailbox).await;
}

/// A ticker whose tick also waits for its exchange on the pipe, because the
/// drive waits for the controller. Measures how regular the ticks are.
struct LockStepClock {
    ticker: Ticker,
    watch: PeriodWatch,
    first: Option<u64>,
    ticks: u64,
    early: u64,
    late: u64,
}

impl LockStepClock {
    /// Starts with the first exchange: before it there is no drive to wait for.
    async fn start() -> Self {
        pipe::EXCHANGE.wait().await;
        pipe::EXCHANGE.signal(());
        let start = Instant::now();
        let mut ticker = Ticker::every(PERIOD);
        ticker.reset_at(start);
        Self {
            ticker,
            watch: PeriodWatch::new(PERIOD.as_micros(), start.as_micros()),
            first: None,
            ticks: 0,
            early: 0,
            late: 0,
        }
    }

    /// Records that a tick starts at `counts` of the timer.
    fn measure(&mut self, counts: u64, missed: u32) {
        if missed > 0 {
            self.first = None;
        }
        let first = *self.first.get_or_insert_with(|| {
            self.ticks = 0;
            counts
        });
        let due = first + self.ticks * u64::from(timer::HZ / 1000);
        self.ticks += 1;
        self.early = self.early.max(due.saturating_sub(counts));
        self.late = self.late.max(counts.saturating_sub(due));
    }
}

impl Clock for LockStepClock {
    async fn next_tick(&mut self) -> Tick {
        self.ticker.next().await;
        pipe::EXCHANGE.wait().await;
        let counts = timer::counts();
        let at = Instant::now();
        let missed = self.watch.record(at.as_micros());
        if missed > 0 {
            self.ticker.reset_at(at);
        }
        self.measure(counts, missed);
        Tick { at, missed }
    }

    fn device_time(&self, _tick: &Tick, drive_us: u64) -> Instant {
        Instant::from_micros(drive_us)
    }
}

#[embassy_executor::task]
async fn wired(state: &'static mut ControlState<JOINTS>, mut host: ControlSide, sink: Sink) {
    let ended = run_control(state, &mut DriveClock(&LINKS), &mut &LINKS, &mut host).await;
    finish(sink, ended)
}

/// Keeps the processor busy in thread mode for 20 ms out of every 25 ms.
#[embassy_executor::task]
async fn hog() {
    loop {
        Timer::after(Duration::from_millis(5)).await;
        let until = Instant::now() + Duration::from_millis(20);
        while Instant::now() < until {
            cortex_m::asm::nop();
        }
    }
}

/// One second of ticks with the counter's wrap in its middle. Every tick must
/// come when it is due, and the time must never go back.
#[embassy_executor::task]
async fn wrapped(sink: Sink) {
    let start = Instant::now();
    let mut ticker = Ticker::every(Duration::from_millis(1));
    let (mut least, mut most) = (u64::MAX, 0);
    let mut before = timer::counts();
    let first = before;
    for tick in 1..=1000u64 {
        ticker.next().await;
        let now = Instant::now();
        let late = now
            .as_ticks()
            .abs_diff((start + Duration::from_millis(tick)).as_ticks());
        (least, most) = (least.min(late), most.max(late));
        let counts = timer::counts();
        if counts < before {
            defmt::error!("time went back from {} to {} counts", before, counts);
            sink.empty();
            semihosting::exit(crate::EXIT_FAILED);
        }
        before = counts;
    }
    let wrapped = first >> 32 != before >> 32;
    defmt::info!(
        "from {} to {} counts, ticks {} to {} us after their time",
        first,
        before,
        least,
        most
    );
    sink.empty();
    // Waking up takes a few us, always the same.
    let even = most - least <= 1 && most < 20;
    semihosting::exit(if wrapped && even { 0 } else { crate::EXIT_FAILED })
}
