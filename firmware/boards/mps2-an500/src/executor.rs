//! Two embassy executors: control in an interrupt, everything else in thread
//! mode below it.
//!
//! embassy's stock thread executor waits with WFE, which never sleeps in
//! QEMU 7.2; these wait with WFI under PRIMASK, where an interrupt that comes
//! between the look and the sleep still wakes the processor.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, Ordering};

use embassy_executor::raw::Executor;
use embassy_executor::{SendSpawner, Spawner};

use crate::hardware::{self, Interrupt, Priority};

const THREAD: usize = 0;
const CONTROL: usize = 1;

static THREAD_HAS_WORK: AtomicBool = AtomicBool::new(false);
static CONTROL_STARTED: AtomicBool = AtomicBool::new(false);
static CONTROL_EXECUTOR: Slot = Slot(UnsafeCell::new(MaybeUninit::uninit()));

struct Slot(UnsafeCell<MaybeUninit<Executor>>);

// SAFETY: written once before the control interrupt is enabled, then only used
// by that interrupt's handler.
unsafe impl Sync for Slot {}

/// Called by embassy when an executor has work.
#[unsafe(export_name = "__pender")]
fn pender(context: *mut ()) {
    if context as usize == CONTROL {
        hardware::pend(Interrupt::Control);
    } else {
        THREAD_HAS_WORK.store(true, Ordering::SeqCst);
    }
}

/// Handler of the control executor's interrupt.
pub extern "C" fn on_control() {
    if CONTROL_STARTED.load(Ordering::Acquire) {
        // SAFETY: `start_control` has initialised the executor; this handler
        // does not interrupt itself, so `poll` is not re-entered.
        unsafe { (*CONTROL_EXECUTOR.0.get()).assume_init_ref().poll() }
    }
}

/// Starts the executor that runs in the control interrupt.
///
/// To be called once: a second call would replace an executor in use.
pub fn start_control() -> SendSpawner {
    assert!(
        !CONTROL_STARTED.load(Ordering::Acquire),
        "the control executor was started twice"
    );
    // SAFETY: nothing else touches the slot before `CONTROL_STARTED` is set.
    let executor: &'static Executor = unsafe { (*CONTROL_EXECUTOR.0.get()).write(Executor::new(CONTROL as *mut ())) };
    CONTROL_STARTED.store(true, Ordering::Release);
    hardware::enable(Interrupt::Control, Priority::Control);
    executor.spawner().make_send()
}

/// Runs the thread-mode executor for good.
pub fn run_thread(start: impl FnOnce(Spawner)) -> ! {
    let mut executor = Executor::new(THREAD as *mut ());
    // SAFETY: this function never returns, so the executor lives for ever.
    let executor: &'static Executor = unsafe { &mut *core::ptr::from_mut(&mut executor) };
    start(executor.spawner());
    loop {
        // SAFETY: only this loop polls it.
        unsafe { executor.poll() };
        cortex_m::interrupt::disable();
        if !THREAD_HAS_WORK.swap(false, Ordering::SeqCst) {
            cortex_m::asm::wfi();
        }
        // SAFETY: interrupts were enabled before.
        unsafe { cortex_m::interrupt::enable() };
    }
}
