//! Three embassy executors: one in the control interrupt, one for the links in an
//! interrupt of lower priority, and one in thread mode for everything else.
//!
//! embassy's own thread executor waits with WFE, which never sleeps in QEMU 7.2.
//! The one here waits with WFI while PRIMASK is set: an interrupt that comes
//! between the check for work and the sleep still wakes the processor.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, Ordering};

use embassy_executor::raw::Executor;
use embassy_executor::{SendSpawner, Spawner};

use crate::hardware::{self, Interrupt, Priority};

const THREAD: usize = 0;
const CONTROL: usize = 1;
const LINK: usize = 2;

static THREAD_HAS_WORK: AtomicBool = AtomicBool::new(false);
static ON_CONTROL: Slot = Slot::new();
static ON_LINK: Slot = Slot::new();

/// An executor that runs in an interrupt.
struct Slot {
    started: AtomicBool,
    executor: UnsafeCell<MaybeUninit<Executor>>,
}

// SAFETY: the executor is written once, before its interrupt is enabled, then
// only used by that interrupt's handler.
unsafe impl Sync for Slot {}

impl Slot {
    const fn new() -> Self {
        Self {
            started: AtomicBool::new(false),
            executor: UnsafeCell::new(MaybeUninit::uninit()),
        }
    }

    /// Starts the executor. Call it once: a second call would replace an
    /// executor that is in use.
    fn start(&'static self, context: usize, interrupt: Interrupt, priority: Priority) -> SendSpawner {
        assert!(
            !self.started.load(Ordering::Acquire),
            "an interrupt's executor was started twice"
        );
        // SAFETY: nothing else accesses the slot before `started` is set.
        let executor: &'static Executor = unsafe { (*self.executor.get()).write(Executor::new(context as *mut ())) };
        self.started.store(true, Ordering::Release);
        hardware::enable(interrupt, priority);
        executor.spawner().make_send()
    }

    fn poll(&self) {
        if self.started.load(Ordering::Acquire) {
            // SAFETY: `start` has initialised the executor. Only one handler polls
            // it, and that handler does not interrupt itself.
            unsafe { (*self.executor.get()).assume_init_ref().poll() }
        }
    }
}

/// embassy calls this when an executor has work.
#[unsafe(export_name = "__pender")]
fn pender(context: *mut ()) {
    match context as usize {
        CONTROL => hardware::pend(Interrupt::Control),
        LINK => hardware::pend(Interrupt::Link),
        _ => THREAD_HAS_WORK.store(true, Ordering::SeqCst),
    }
}

/// Handler of the control executor's interrupt.
pub extern "C" fn on_control() {
    ON_CONTROL.poll();
}

/// Handler of the link executor's interrupt.
pub extern "C" fn on_link() {
    ON_LINK.poll();
}

/// Starts the executor that runs in the control interrupt.
pub fn start_control() -> SendSpawner {
    ON_CONTROL.start(CONTROL, Interrupt::Control, Priority::Control)
}

/// Starts the executor that runs in the link interrupt.
pub fn start_link() -> SendSpawner {
    ON_LINK.start(LINK, Interrupt::Link, Priority::Links)
}

/// Runs the thread-mode executor for ever.
pub fn run_thread(start: impl FnOnce(Spawner)) -> ! {
    let mut executor = Executor::new(THREAD as *mut ());
    // SAFETY: this function never returns, so the executor lives for ever.
    let executor: &'static Executor = unsafe { &mut *core::ptr::from_mut(&mut executor) };
    start(executor.spawner());
    loop {
        // SAFETY: only this loop polls the executor.
        unsafe { executor.poll() };
        cortex_m::interrupt::disable();
        if !THREAD_HAS_WORK.swap(false, Ordering::SeqCst) {
            cortex_m::asm::wfi();
        }
        // SAFETY: interrupts were enabled before.
        unsafe { cortex_m::interrupt::enable() };
    }
}
