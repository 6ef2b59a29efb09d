//! What the image does, one function for each scenario.

use embassy_executor::SendSpawner;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::{Duration, Instant, Ticker, Timer};
use spherecal_firmware::HostLink;
use spherecal_firmware::app::links::{DriveClock, Links};
use spherecal_firmware::app::ports::{Beat, Clock};
use spherecal_firmware::app::{Bell, ControlEnd, Ended, PERIOD, PeriodWatch, Post, Workspace, run as run_control};
use spherecal_shared::protocol::lockstep::MAX_HOST;
use static_cell::{ConstStaticCell, StaticCell};

use crate::arguments::Scenario;
use crate::executor;
use crate::log::{self, Sink};
use crate::pipe::{self, Desk, LockStep, Messages, Pipe};
use crate::semihosting;
use crate::stack;
use crate::timer;
use crate::uart::{UART0, UART1};

/// Joints of the arm.
const JOINTS: usize = 7;
/// What the banner says of the build.
pub const BUILD: &str = match option_env!("SPHERECAL_BUILD") {
    Some(build) => build,
    None => "unknown",
};
/// Where the counter starts in [`Scenario::Wrap`]: half a second before its wrap.
pub const COUNTS_TO_WRAP: u32 = timer::HZ / 2;

static LINKS: Links<CriticalSectionRawMutex> = Links::new();

/// The control task's end of the queues, with this board's lock.
type Control = ControlEnd<'static, CriticalSectionRawMutex>;

/// The workspace of the one control task.
fn workspace() -> &'static mut Workspace<JOINTS> {
    static WORKSPACE: StaticCell<Workspace<JOINTS>> = StaticCell::new();
    WORKSPACE.init_with(Workspace::default)
}

/// The two ends of the queues between control task and host link.
fn post() -> (Control, Desk) {
    static POST: StaticCell<Post> = StaticCell::new();
    static BELL: Bell<CriticalSectionRawMutex> = Bell::new();
    POST.init_with(Post::new).split(&BELL)
}

fn host_link() -> &'static mut HostLink {
    static LINK: StaticCell<HostLink> = StaticCell::new();
    LINK.init_with(|| HostLink::new(BUILD, JOINTS))
}

/// Runs `scenario`; the log goes to `sink`.
pub fn run(scenario: Scenario, sink: Sink) -> ! {
    let control = executor::start_control();
    let links = executor::start_link();
    match scenario {
        Scenario::Pipe | Scenario::Hog => start_pipe(control, links, sink),
        Scenario::Uart => start_uarts(control, links, sink),
        Scenario::Wrap => control.spawn(spawned(wrapped(sink))),
        Scenario::Stages => crate::stages::run(),
    }
    // What the start has used is done with: from here on the paint shows what
    // the tasks use, at all priorities together.
    stack::paint();
    executor::run_thread(|spawner| {
        spawner.spawn(spawned(log::task(sink)));
        if scenario == Scenario::Hog {
            spawner.spawn(spawned(hog()));
        }
    })
}

// Not inlined: what they build on the stack is not to stay there.
#[inline(never)]
fn start_pipe(control: SendSpawner, links: SendSpawner, sink: Sink) {
    static MESSAGES: StaticCell<Messages> = StaticCell::new();
    static PIPE: StaticCell<Pipe> = StaticCell::new();
    let (producer, consumer) = MESSAGES.init(Messages::new()).split();
    let Some(pipe) = Pipe::open(producer, host_link()) else {
        semihosting::exit(crate::EXIT_HOST);
    };
    let pipe = PIPE.init(pipe);
    let (host, desk) = post();
    control.spawn(spawned(piped(workspace(), LockStep::new(consumer), host, sink)));
    links.spawn(spawned(serve(pipe, desk)));
}

#[inline(never)]
fn start_uarts(control: SendSpawner, links: SendSpawner, sink: Sink) {
    UART0.start();
    UART1.start();
    let (host, desk) = post();
    control.spawn(spawned(wired(workspace(), host, sink)));
    links.spawn(spawned(drive_in()));
    links.spawn(spawned(drive_out()));
    links.spawn(spawned(host_in()));
    links.spawn(spawned(speak(host_link(), desk)));
    links.spawn(spawned(host_out()));
}

/// Every task is spawned once, so its one place is free.
fn spawned<S>(
    token: Result<embassy_executor::SpawnToken<S>, embassy_executor::SpawnError>,
) -> embassy_executor::SpawnToken<S> {
    token.unwrap_or_else(|_| semihosting::exit(crate::EXIT_FAILED))
}

/// Writes out the log and ends the process.
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
async fn piped(work: &'static mut Workspace<JOINTS>, mut drive: LockStep, mut host: Control, sink: Sink) {
    let mut clock = LockStepClock::start().await;
    let ended = run_control(work, &mut clock, &mut drive, &mut host).await;
    defmt::info!(
        "beats: {} since the last that was missed, {} counts early to {} counts late at 25 MHz",
        clock.beats,
        clock.early,
        clock.late
    );
    finish(sink, ended)
}

#[embassy_executor::task]
async fn serve(pipe: &'static mut Pipe, mut desk: Desk) {
    pipe.serve(&mut desk).await;
}

/// The ticker's beat, with a look at how even it is. A beat before whose turn
/// has come waits for it, since the drive waits for us: that is lateness.
struct LockStepClock {
    ticker: Ticker,
    watch: PeriodWatch,
    first: Option<u64>,
    beats: u64,
    early: u64,
    late: u64,
}

impl LockStepClock {
    /// Beats from the first turn on: before it there is no drive to wait for.
    async fn start() -> Self {
        pipe::TURN.wait().await;
        pipe::TURN.signal(());
        let start = Instant::now();
        let mut ticker = Ticker::every(PERIOD);
        ticker.reset_at(start);
        Self {
            ticker,
            watch: PeriodWatch::new(PERIOD, start),
            first: None,
            beats: 0,
            early: 0,
            late: 0,
        }
    }

    /// Notes that a tick begins at `counts`.
    fn measure(&mut self, counts: u64, missed: u32) {
        if missed > 0 {
            self.first = None;
        }
        let first = *self.first.get_or_insert_with(|| {
            self.beats = 0;
            counts
        });
        let due = first + self.beats * u64::from(timer::HZ / 1000);
        self.beats += 1;
        self.early = self.early.max(due.saturating_sub(counts));
        self.late = self.late.max(counts.saturating_sub(due));
    }
}

impl Clock for LockStepClock {
    async fn next(&mut self) -> Beat {
        self.ticker.next().await;
        pipe::TURN.wait().await;
        let counts = timer::counts();
        let at = Instant::now();
        let missed = self.watch.note(at);
        if missed > 0 {
            self.ticker.reset_at(at);
        }
        self.measure(counts, missed);
        Beat { at, missed }
    }

    fn time(&self, _beat: &Beat, drive_us: u64) -> Instant {
        Instant::from_micros(drive_us)
    }
}

#[embassy_executor::task]
async fn wired(work: &'static mut Workspace<JOINTS>, mut host: Control, sink: Sink) {
    let ended = run_control(work, &mut DriveClock(&LINKS), &mut &LINKS, &mut host).await;
    finish(sink, ended)
}

#[embassy_executor::task]
async fn drive_in() {
    LINKS.drive_in(&mut &UART0).await
}

#[embassy_executor::task]
async fn drive_out() {
    LINKS.drive_out(&mut &UART0).await
}

#[embassy_executor::task]
async fn host_in() {
    LINKS.host_in(&mut &UART1).await
}

#[embassy_executor::task]
async fn speak(link: &'static mut HostLink, mut desk: Desk) {
    static UP: ConstStaticCell<[u8; MAX_HOST]> = ConstStaticCell::new([0; MAX_HOST]);
    LINKS.host(link, &mut desk, UP.take()).await
}

#[embassy_executor::task]
async fn host_out() {
    LINKS.host_out(&mut &UART1).await
}

/// Keeps the processor busy in thread mode for 20 ms out of 25.
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

/// One second of beats with the wrap in its middle: each comes when it is due
/// and time never goes back.
#[embassy_executor::task]
async fn wrapped(sink: Sink) {
    let start = Instant::now();
    let mut ticker = Ticker::every(Duration::from_millis(1));
    let (mut least, mut most) = (u64::MAX, 0);
    let mut before = timer::counts();
    let first = before;
    for beat in 1..=1000u64 {
        ticker.next().await;
        let now = Instant::now();
        let late = now
            .as_ticks()
            .abs_diff((start + Duration::from_millis(beat)).as_ticks());
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
        "from {} to {} counts, beats {} to {} us after their time",
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
