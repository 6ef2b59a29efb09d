//! Time: the embassy time driver on the CMSDK dual timer, and a stopwatch.
//!
//! Both timers count down at 25 MHz. The first runs freely and wraps after
//! 171.8 s; every read extends its 32 bits to 64. The second is the alarm. It
//! never waits longer than half a wrap, so no wrap is missed. Ticks of
//! `embassy-time` are µs.

use core::cell::RefCell;
use core::task::Waker;

use critical_section::Mutex;
use embassy_time_driver::Driver;
use embassy_time_queue_utils::Queue;

use crate::hardware::{self, Register};

/// Frequency of the timers, in Hz.
pub const HZ: u32 = 25_000_000;
const COUNTS_PER_TICK: u32 = (HZ as u64 / embassy_time_driver::TICK_HZ) as u32;
const _: () = assert!(HZ as u64 % embassy_time_driver::TICK_HZ == 0);
/// Longest wait of the alarm: half a wrap of the counter.
const LONGEST: u64 = 1 << 31;

const COUNTER: usize = 0x4000_2000;
const ALARM: usize = 0x4000_2020;
const LOAD: usize = 0x00;
const VALUE: usize = 0x04;
const CONTROL: usize = 0x08;
const CLEAR: usize = 0x0c;
const ONE_SHOT: u32 = 1 << 0;
const SIZE_32: u32 = 1 << 1;
const INTERRUPT: u32 = 1 << 5;
const PERIODIC: u32 = 1 << 6;
const ENABLE: u32 = 1 << 7;

/// Extends a 32-bit counter to 64 bits; it must be read at least once per wrap.
/// The result is kept as whole ticks and the counts of the current tick, because
/// a 64-bit division is slow and would run with interrupts off.
struct Extended {
    ticks: u64,
    rest: u32,
    last: u32,
}

impl Extended {
    const fn new() -> Self {
        Self {
            ticks: 0,
            rest: 0,
            last: 0,
        }
    }

    #[inline(always)]
    fn update(&mut self, low: u32) {
        let passed = low.wrapping_sub(self.last);
        self.last = low;
        let rest = self.rest + passed % COUNTS_PER_TICK;
        let carry = u32::from(rest >= COUNTS_PER_TICK);
        self.rest = rest - carry * COUNTS_PER_TICK;
        self.ticks += u64::from(passed / COUNTS_PER_TICK + carry);
    }

    fn counts(&self) -> u64 {
        self.ticks * u64::from(COUNTS_PER_TICK) + u64::from(self.rest)
    }
}

struct State {
    counter: Extended,
    queue: Queue,
}

struct DualTimer {
    state: Mutex<RefCell<State>>,
}

embassy_time_driver::time_driver_impl!(static DRIVER: DualTimer = DualTimer {
    state: Mutex::new(RefCell::new(State {
        counter: Extended::new(),
        queue: Queue::new(),
    })),
});

impl State {
    /// Reads the counter.
    #[inline(always)]
    fn look(&mut self) -> &Extended {
        self.counter.update(!Register::at(COUNTER + VALUE).read());
        &self.counter
    }

    /// Wakes the tasks that are due and sets the alarm for the next.
    fn serve(&mut self) {
        loop {
            let now = self.look().ticks;
            let next = self.queue.next_expiration(now);
            let at = next.saturating_mul(u64::from(COUNTS_PER_TICK));
            let wait = at.saturating_sub(self.look().counts()).min(LONGEST);
            if wait > 0 {
                // Writing a new value restarts a one-shot timer that has expired.
                Register::at(ALARM + LOAD).write(wait as u32);
                return;
            }
        }
    }
}

impl Driver for DualTimer {
    fn now(&self) -> u64 {
        critical_section::with(|cs| self.state.borrow_ref_mut(cs).look().ticks)
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        critical_section::with(|cs| {
            let mut state = self.state.borrow_ref_mut(cs);
            if state.queue.schedule_wake(at, waker) {
                // The timer's own interrupt sets the alarm. Interrupts are off
                // here, and a longer critical section would delay the control tick.
                hardware::pend(hardware::Interrupt::DualTimer);
            }
        });
    }
}

/// Handler of the dual timer's interrupt.
pub extern "C" fn on_interrupt() {
    critical_section::with(|cs| {
        Register::at(ALARM + CLEAR).write(1);
        DRIVER.state.borrow_ref_mut(cs).serve();
    });
}

/// Starts the time, `counts_to_wrap` counts before the 32-bit counter wraps for
/// the first time (0: a full wrap before).
pub fn start(counts_to_wrap: u32) {
    critical_section::with(|_| {
        Register::at(COUNTER + CONTROL).write(0);
        Register::at(COUNTER + LOAD).write(counts_to_wrap.wrapping_sub(1));
        Register::at(COUNTER + CONTROL).write(ENABLE | SIZE_32);
        Register::at(ALARM + CONTROL).write(0);
        Register::at(ALARM + CLEAR).write(1);
        Register::at(ALARM + LOAD).write(LONGEST as u32);
        Register::at(ALARM + CONTROL).write(ENABLE | INTERRUPT | SIZE_32 | PERIODIC | ONE_SHOT);
    });
    hardware::enable(hardware::Interrupt::DualTimer, hardware::Priority::Timer);
}

/// Counts of the 25 MHz timer since the start, extended to 64 bits.
pub fn counts() -> u64 {
    let (ticks, rest) = critical_section::with(|cs| {
        let mut state = DRIVER.state.borrow_ref_mut(cs);
        let counter = state.look();
        (counter.ticks, counter.rest)
    });
    ticks * u64::from(COUNTS_PER_TICK) + u64::from(rest)
}

/// SysTick as a stopwatch: a counter of 24 bits at the processor's 25 MHz. With
/// QEMU's `-icount shift=3` one count is five instructions.
pub mod stopwatch {
    use crate::hardware::Register;

    const SYST_CSR: usize = 0xe000_e010;
    const SYST_RVR: usize = 0xe000_e014;
    const SYST_CVR: usize = 0xe000_e018;

    /// Starts the counter without its interrupt.
    pub fn start() {
        Register::at(SYST_RVR).write(0x00ff_ffff);
        Register::at(SYST_CVR).write(0);
        Register::at(SYST_CSR).write(0b101);
    }

    /// The value of the counter, which counts down.
    #[inline(always)]
    pub fn read() -> u32 {
        Register::at(SYST_CVR).read()
    }

    /// Counts between reading `from` and reading `to`, less than one wrap (0.67 s).
    pub fn between(from: u32, to: u32) -> u32 {
        from.wrapping_sub(to) & 0x00ff_ffff
    }
}
