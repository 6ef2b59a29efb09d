//! The sink of `defmt`: a ring that a task of low priority empties to a file of
//! the host.
//!
//! A log statement anywhere, in an interrupt too, only copies bytes. A message
//! that does not fit is dropped whole and counted; the count is logged as soon
//! as there is room. The host decodes the file with the image's own ELF.

use core::cell::RefCell;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use critical_section::{Mutex, RestoreState};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;

use crate::semihosting::{File, Mode};

const CAPACITY: usize = 16 * 1024;

/// Bytes between a writer and a reader; a message becomes visible when whole.
struct Ring {
    bytes: [u8; CAPACITY],
    read: usize,
    committed: usize,
    written: usize,
    cut: bool,
}

impl Ring {
    const fn new() -> Self {
        Self {
            bytes: [0; CAPACITY],
            read: 0,
            committed: 0,
            written: 0,
            cut: false,
        }
    }

    fn push(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            if self.cut || self.written.wrapping_sub(self.read) >= CAPACITY {
                self.cut = true;
                return;
            }
            self.bytes[self.written % CAPACITY] = byte;
            self.written = self.written.wrapping_add(1);
        }
    }

    fn commit(&mut self) {
        if self.cut {
            self.written = self.committed;
            DROPPED.fetch_add(1, Ordering::Relaxed);
        }
        self.committed = self.written;
        self.cut = false;
    }

    fn take(&mut self, out: &mut [u8]) -> usize {
        let mut count = 0;
        for slot in out {
            if self.read == self.committed {
                break;
            }
            *slot = self.bytes[self.read % CAPACITY];
            self.read = self.read.wrapping_add(1);
            count += 1;
        }
        count
    }
}

/// What one message needs while it is written.
struct Writing {
    ring: Ring,
    encoder: defmt::Encoder,
}

static WRITING: Mutex<RefCell<Writing>> = Mutex::new(RefCell::new(Writing {
    ring: Ring::new(),
    encoder: defmt::Encoder::new(),
}));
static RESTORE: Mutex<core::cell::Cell<RestoreState>> = Mutex::new(core::cell::Cell::new(RestoreState::invalid()));
static TAKEN: AtomicBool = AtomicBool::new(false);
static DROPPED: AtomicU32 = AtomicU32::new(0);
static FILLED: Signal<CriticalSectionRawMutex, ()> = Signal::new();

#[defmt::global_logger]
struct Logger;

fn with(act: impl FnOnce(&mut Writing)) {
    critical_section::with(|cs| act(&mut WRITING.borrow_ref_mut(cs)));
}

// SAFETY: between `acquire` and `release` interrupts are off, so messages do
// not mix; a message begun inside another is refused by `TAKEN`.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        // SAFETY: released in `release`, which defmt calls in pairs with this.
        let restore = unsafe { critical_section::acquire() };
        if TAKEN.swap(true, Ordering::Relaxed) {
            crate::semihosting::exit(crate::EXIT_LOGGER);
        }
        critical_section::with(|cs| RESTORE.borrow(cs).set(restore));
        with(|writing| writing.encoder.start_frame(|bytes| writing.ring.push(bytes)));
    }

    unsafe fn flush() {}

    unsafe fn release() {
        with(|writing| {
            writing.encoder.end_frame(|bytes| writing.ring.push(bytes));
            writing.ring.commit();
        });
        FILLED.signal(());
        TAKEN.store(false, Ordering::Relaxed);
        let restore = critical_section::with(|cs| RESTORE.borrow(cs).get());
        // SAFETY: the state is the one that `acquire` was given.
        unsafe { critical_section::release(restore) };
    }

    unsafe fn write(bytes: &[u8]) {
        with(|writing| writing.encoder.write(bytes, |bytes| writing.ring.push(bytes)));
    }
}

defmt::timestamp!("{=u64:us}", embassy_time::Instant::now().as_micros());

/// Where the log goes.
#[derive(Clone, Copy)]
pub struct Sink(Option<File>);

static OPENED: Mutex<core::cell::Cell<Option<File>>> = Mutex::new(core::cell::Cell::new(None));

/// Writes out what has been logged, before the processor stops.
pub fn last_words() {
    Sink(critical_section::with(|cs| OPENED.borrow(cs).get())).empty();
}

impl Sink {
    /// A file of the host, whose path ends with a zero byte; none without a path.
    pub fn open(path: Option<&str>) -> Self {
        let file = path.and_then(|path| File::open(path, Mode::Write));
        critical_section::with(|cs| OPENED.borrow(cs).set(file));
        Self(file)
    }

    /// Writes out what has been logged.
    pub fn empty(self) {
        let mut chunk = [0; 1024];
        loop {
            let mut count = 0;
            with(|writing| count = writing.ring.take(&mut chunk));
            if count == 0 {
                return;
            }
            if let Some(file) = self.0 {
                file.write(&chunk[..count]);
            }
        }
    }
}

/// Empties the ring whenever something was logged.
#[embassy_executor::task]
pub async fn task(sink: Sink) -> ! {
    let mut told = 0;
    loop {
        FILLED.wait().await;
        sink.empty();
        let dropped = DROPPED.load(Ordering::Relaxed);
        if dropped != told {
            told = dropped;
            defmt::warn!("{} log messages dropped so far: the ring was full", dropped);
        }
    }
}
