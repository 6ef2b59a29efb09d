//! What the image does, one function for each scenario.

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::{Duration, Instant, Ticker, Timer};
use spherecal_firmware::app::links::{DriveClock, Links};
use spherecal_firmware::app::ports::{Beat, Clock};
use spherecal_firmware::app::{Ended, TickerClock, Workspace, run as run_control};
use static_cell::StaticCell;

use crate::arguments::Scenario;
use crate::executor;
use crate::log::{self, Sink};
use crate::pipe::Pipe;
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

/// The workspace of the one control task.
fn workspace() -> &'static mut Workspace<JOINTS> {
    static WORKSPACE: StaticCell<Workspace<JOINTS>> = StaticCell::new();
    WORKSPACE.init_with(|| Workspace::new(BUILD))
}

/// Runs `scenario`; the log goes to `sink`.
pub fn run(scenario: Scenario, sink: Sink) -> ! {
    let control = executor::start_control();
    match scenario {
        Scenario::Pipe | Scenario::Hog => {
            static PIPE: StaticCell<Pipe> = StaticCell::new();
            let Some(pipe) = Pipe::open() else {
                semihosting::exit(crate::EXIT_HOST);
            };
            let pipe = PIPE.init(pipe);
            control.spawn(spawned(piped(workspace(), pipe, sink)));
        }
        Scenario::Uart => {
            UART0.start();
            UART1.start();
            control.spawn(spawned(wired(workspace(), sink)));
        }
        Scenario::Wrap => control.spawn(spawned(wrapped(sink))),
        Scenario::Stages => crate::stages::run(),
    }
    executor::run_thread(|spawner| {
        spawner.spawn(spawned(log::task(sink)));
        if scenario == Scenario::Hog {
            spawner.spawn(spawned(hog()));
        }
        if scenario == Scenario::Uart {
            spawner.spawn(spawned(drive_in()));
            spawner.spawn(spawned(drive_out()));
            spawner.spawn(spawned(host_in()));
            spawner.spawn(spawned(host_out()));
        }
    })
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
async fn piped(work: &'static mut Workspace<JOINTS>, pipe: &'static mut Pipe, sink: Sink) {
    // From here on the paint shows what the control task and all above it use.
    stack::paint();
    let mut clock = MeasuredClock {
        ticker: TickerClock::start(),
        first: None,
        beats: 0,
        early: 0,
        late: 0,
    };
    let ended = run_control(work, &mut clock, pipe).await;
    defmt::info!(
        "beats: {} counts early to {} counts late at 25 MHz",
        clock.early,
        clock.late
    );
    finish(sink, ended)
}

/// The ticker's beat, with a look at how even it is.
struct MeasuredClock {
    ticker: TickerClock<true>,
    first: Option<u64>,
    beats: u64,
    early: u64,
    late: u64,
}

impl Clock for MeasuredClock {
    async fn next(&mut self) -> Beat {
        let beat = self.ticker.next().await;
        let counts = timer::counts();
        if beat.missed > 0 {
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
        beat
    }

    fn time(&self, beat: &Beat, drive_us: u64) -> Instant {
        self.ticker.time(beat, drive_us)
    }
}

#[embassy_executor::task]
async fn wired(work: &'static mut Workspace<JOINTS>, sink: Sink) {
    let ended = run_control(work, &mut DriveClock(&LINKS), &mut &LINKS).await;
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
