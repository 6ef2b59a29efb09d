//! The sink of `defmt`: ring buffers that a task of low priority writes to a file
//! of the host.
//!
//! Each priority that logs has its own ring. Only that priority writes the ring,
//! and only the log task reads it. A log statement therefore needs no lock, and
//! one in thread mode does not delay the control task. A message that does not
//! fit is dropped as a whole and counted; the count is logged once there is room.
//! The host decodes the file with the image's ELF file. Messages of different
//! priorities need not stand in the order of their time stamps.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};

use cortex_m::peripheral::SCB;
use cortex_m::peripheral::scb::VectActive;
use critical_section::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;

use crate::hardware::Interrupt;
use crate::semihosting::{File, Mode};

const CAPACITY: usize = 8 * 1024;

/// The part of a ring that only its writer uses.
struct Writer {
    encoder: defmt::Encoder,
    bytes: [u8; CAPACITY],
    written: usize,
    committed: usize,
    cut: bool,
}

/// A ring of bytes with one writer and one reader. A message becomes visible to
/// the reader when it is complete.
struct Ring {
    writer: UnsafeCell<Writer>,
    writing: AtomicBool,
    committed: AtomicUsize,
    read: AtomicUsize,
}

// SAFETY: one priority alone uses the writer's part, between `acquire` and
// `release`, and it does not interrupt itself. The reader reads only bytes before
// `committed`; the writer does not touch those until `read` has passed them.
unsafe impl Sync for Ring {}

impl Ring {
    const fn new() -> Self {
        Self {
            writer: UnsafeCell::new(Writer {
                encoder: defmt::Encoder::new(),
                bytes: [0; CAPACITY],
                written: 0,
                committed: 0,
                cut: false,
            }),
            writing: AtomicBool::new(false),
            committed: AtomicUsize::new(0),
            read: AtomicUsize::new(0),
        }
    }

    /// Calls `act` with the encoder and the function that takes its bytes.
    fn write(&self, act: impl FnOnce(&mut defmt::Encoder, &mut dyn FnMut(&[u8]))) {
        // SAFETY: see `Sync`.
        let Writer {
            encoder,
            bytes,
            written,
            cut,
            ..
        } = unsafe { &mut *self.writer.get() };
        let read = self.read.load(Ordering::Acquire);
        act(encoder, &mut |piece| {
            for &byte in piece {
                if *cut || written.wrapping_sub(read) >= CAPACITY {
                    *cut = true;
                    return;
                }
                bytes[*written % CAPACITY] = byte;
                *written = written.wrapping_add(1);
            }
        });
    }

    /// Makes the written message visible, or drops it if it was cut.
    fn commit(&self) {
        // SAFETY: see `Sync`.
        let writer = unsafe { &mut *self.writer.get() };
        if writer.cut {
            writer.written = writer.committed;
            writer.cut = false;
            DROPPED.fetch_add(1, Ordering::Relaxed);
        }
        writer.committed = writer.written;
        self.committed.store(writer.committed, Ordering::Release);
    }

    fn take(&self, out: &mut [u8]) -> usize {
        let (committed, read) = (
            self.committed.load(Ordering::Acquire),
            self.read.load(Ordering::Relaxed),
        );
        let count = committed.wrapping_sub(read).min(out.len());
        for (k, slot) in out.iter_mut().take(count).enumerate() {
            // SAFETY: see `Sync`: a byte between `read` and `committed`.
            *slot = unsafe { (&raw const (*self.writer.get()).bytes[read.wrapping_add(k) % CAPACITY]).read() };
        }
        self.read.store(read.wrapping_add(count), Ordering::Release);
        count
    }
}

/// One ring each for thread mode, the links and the control task, and one for
/// messages after a panic or a hard fault.
static RINGS: [Ring; 4] = [const { Ring::new() }; 4];
/// Set when the image is about to end: messages may then interrupt any other.
static ENDING: AtomicBool = AtomicBool::new(false);
static DROPPED: AtomicU32 = AtomicU32::new(0);
static FILLED: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// The ring of the priority that runs now.
fn ring() -> &'static Ring {
    const LINK: u8 = Interrupt::Link as u8;
    const CONTROL: u8 = Interrupt::Control as u8;
    let number = match SCB::vect_active() {
        _ if ENDING.load(Ordering::Relaxed) => 3,
        VectActive::ThreadMode => 0,
        VectActive::Interrupt { irqn: LINK } => 1,
        VectActive::Interrupt { irqn: CONTROL } => 2,
        _ => 3,
    };
    &RINGS[number]
}

#[defmt::global_logger]
struct Logger;

// SAFETY: messages of one priority do not mix: `writing` refuses one that starts
// inside another. Messages of different priorities use different rings.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        let ring = ring();
        if ring.writing.swap(true, Ordering::Relaxed) {
            crate::semihosting::exit(crate::EXIT_LOGGER);
        }
        ring.write(|encoder, put| encoder.start_frame(put));
    }

    unsafe fn flush() {}

    unsafe fn release() {
        let ring = ring();
        ring.write(|encoder, put| encoder.end_frame(put));
        ring.commit();
        ring.writing.store(false, Ordering::Relaxed);
        FILLED.signal(());
    }

    unsafe fn write(bytes: &[u8]) {
        ring().write(|encoder, put| encoder.write(bytes, put));
    }
}

defmt::timestamp!("{=u64:us}", embassy_time::Instant::now().as_micros());

/// The file that the log goes to, if any.
#[derive(Clone, Copy)]
pub struct Sink(Option<File>);

static OPENED: Mutex<core::cell::Cell<Option<File>>> = Mutex::new(core::cell::Cell::new(None));

/// Marks everything that is logged from now on as the image's last messages.
pub fn ending() {
    cortex_m::interrupt::disable();
    ENDING.store(true, Ordering::Relaxed);
}

/// Writes the rings to the file before the processor stops.
pub fn last_words() {
    Sink(critical_section::with(|cs| OPENED.borrow(cs).get())).empty();
}

impl Sink {
    /// Opens a file of the host. `path` ends with a zero byte; without a path
    /// there is no log.
    pub fn open(path: Option<&str>) -> Self {
        let file = path.and_then(|path| File::open(path, Mode::Write));
        critical_section::with(|cs| OPENED.borrow(cs).set(file));
        Self(file)
    }

    /// Writes everything in the rings to the file.
    pub fn empty(self) {
        let mut chunk = [0; 1024];
        for ring in &RINGS {
            loop {
                let count = ring.take(&mut chunk);
                if count == 0 {
                    break;
                }
                if let Some(file) = self.0 {
                    file.write(&chunk[..count]);
                }
            }
        }
    }
}

/// Writes the rings to the file whenever something was logged.
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
