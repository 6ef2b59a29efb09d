//! What every board shares: the controller's static memory, the queues between
//! the control task and the links, and the link tasks.
//!
//! An embassy task cannot be generic, so these tasks come from a macro.
//! [`controller!`](crate::controller) defines them for the board's own UART
//! types. The control task stays with the board, since the clock and the
//! watchdog belong to it.
//!
//! ```text
//!   board's main ── controller!(..) ── LINKS, control_state, mailbox, host_link, spawn_links
//!        └─ control task: spherecal_firmware::app::run(state, clock, &LINKS, mailbox)
//! ```
#![no_std]

pub use embassy_executor::{SendSpawner, SpawnError};
pub use spherecal_firmware::HostLink;
pub use static_cell::{ConstStaticCell, StaticCell};

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::Timer;
use spherecal_firmware::app;
use spherecal_firmware::app::supervisor::{BEAT, Part};

/// The lock of the queues: it turns interrupts off for the time of one chunk.
pub type Lock = CriticalSectionRawMutex;
/// Queues between the control task and the link tasks.
pub type Links = app::links::Links<Lock>;
/// Queues between the control task and the host link.
pub type Mailbox = app::Mailbox;
/// What both sides of the [`Mailbox`] share.
pub type MailboxSignal = app::MailboxSignal<Lock>;
/// The control task's side of the [`Mailbox`].
pub type ControlSide = app::ControlSide<'static, Lock>;
/// The host link's side of the [`Mailbox`].
pub type LinkSide = app::LinkSide<'static, Lock>;
/// The control task's state, for an arm with `N` joints.
pub type ControlState<const N: usize> = app::ControlState<N>;

/// Shows that thread mode runs, and logs once a second how much `links` have dropped, when
/// the numbers changed. For a task in thread mode.
pub async fn keep_house(links: &Links) -> ! {
    const BEATS: u64 = 1000 / BEAT.as_millis();
    let mut reported = (0, 0, 0);
    loop {
        for _ in 0..BEATS {
            links.pulse().beat(Part::Thread);
            Timer::after(BEAT).await;
        }
        let dropped = links.dropped();
        if dropped != reported {
            reported = dropped;
            defmt::warn!(
                "links: {} drive messages and {} host bytes dropped, {} errors of the streams so far",
                dropped.0,
                dropped.1,
                dropped.2
            );
        }
    }
}

/// Defines an interrupt executor and the handler of the interrupt that runs it.
///
/// `interrupt_executor! { #[interrupt] CONTROL, UART7 }` defines the static `CONTROL` and the handler of `UART7`;
/// `#[interrupt]` is the attribute of the board's HAL. Use an interrupt that nothing else needs. Start the executor
/// once, with this interrupt: `CONTROL.start(interrupt::UART7)`. Enable the interrupt in no other way, because the
/// handler relies on the executor having been started.
///
/// The board's crate depends on `embassy-executor` directly.
#[macro_export]
macro_rules! interrupt_executor {
    ($(#[$attribute:meta])+ $executor:ident, $interrupt:ident) => {
        static $executor: embassy_executor::InterruptExecutor = embassy_executor::InterruptExecutor::new();

        $(#[$attribute])+
        unsafe fn $interrupt() {
            // SAFETY: the interrupt is enabled by `start` alone, which has this executor ready.
            unsafe { $executor.on_interrupt() }
        }
    };
}

/// Defines the controller's memory and link tasks in the board's crate.
///
/// - `joints`: number of joints of the arm.
/// - `drive`, `host`: types of the receiver and the transmitter of each link;
///   they implement `embedded_io_async::Read` and `Write`. Without `drive` the board runs
///   `LINKS.drive_in` and `LINKS.drive_out` in a task of its own.
/// - `tick_bytes`: most bytes that one tick sends to the host; at least one
///   frame (`MAX_FRAME`), two or more so that recordings do not wait.
/// - `control_section`, optional: section of the linker script for the state of the control
///   task, with zeros at the start: the fastest memory of the board.
///
/// Defines:
/// - `BUILD`: the build for the banner, from the variable `SPHERECAL_BUILD`;
/// - `LINKS`: the queues of the links, a drive port for the control task;
/// - `control_state()`, `mailbox()`, `host_link()`: the controller's memory. Call
///   each once; a second call panics;
/// - `spawn_links(spawner, link, mailbox, drive, host)`: starts the link tasks.
///
/// The board's crate depends on `embassy-executor` directly.
#[macro_export]
macro_rules! controller {
    (
        joints: $joints:expr,
        $(drive: ($drive_rx:ty, $drive_tx:ty),)?
        host: ($host_rx:ty, $host_tx:ty),
        tick_bytes: $tick_bytes:expr
        $(, control_section: $control_section:literal)? $(,)?
    ) => {
        /// The build that the banner states.
        pub const BUILD: &str = match option_env!("SPHERECAL_BUILD") {
            Some(build) => build,
            None => "unknown",
        };

        /// The queues between the control task and the link tasks.
        pub static LINKS: $crate::Links = $crate::Links::new();

        /// The state of the control task.
        pub fn control_state() -> &'static mut $crate::ControlState<{ $joints }> {
            $(#[unsafe(link_section = $control_section)])?
            static STATE: $crate::StaticCell<$crate::ControlState<{ $joints }>> = $crate::StaticCell::new();
            STATE.init_with(Default::default)
        }

        /// The two sides of the queues between control task and host link.
        pub fn mailbox() -> ($crate::ControlSide, $crate::LinkSide) {
            static MAILBOX: $crate::StaticCell<$crate::Mailbox> = $crate::StaticCell::new();
            static SIGNAL: $crate::MailboxSignal = $crate::MailboxSignal::new();
            MAILBOX.init_with($crate::Mailbox::new).split(&SIGNAL)
        }

        /// The controller's end of the host link, as `configure` returns it.
        pub fn host_link(
            configure: impl FnOnce($crate::HostLink) -> $crate::HostLink,
        ) -> &'static mut $crate::HostLink {
            static LINK: $crate::StaticCell<$crate::HostLink> = $crate::StaticCell::new();
            LINK.init_with(|| configure($crate::HostLink::new(BUILD, $joints)))
        }

        $(
            #[embassy_executor::task]
            async fn drive_in(mut receiver: $drive_rx) {
                LINKS.drive_in(&mut receiver).await
            }

            #[embassy_executor::task]
            async fn drive_out(mut transmitter: $drive_tx) {
                LINKS.drive_out(&mut transmitter).await
            }
        )?

        #[embassy_executor::task]
        async fn host_in(mut receiver: $host_rx) {
            LINKS.host_in(&mut receiver).await
        }

        #[embassy_executor::task]
        async fn serve_host(link: &'static mut $crate::HostLink, mut mailbox: $crate::LinkSide) {
            static BUFFER: $crate::ConstStaticCell<[u8; { $tick_bytes }]> =
                $crate::ConstStaticCell::new([0; { $tick_bytes }]);
            LINKS.serve_host(link, &mut mailbox, BUFFER.take()).await
        }

        #[embassy_executor::task]
        async fn host_out(mut transmitter: $host_tx) {
            LINKS.host_out(&mut transmitter).await
        }

        /// Starts the tasks of both links on `spawner`, whose priority is below
        /// the control task's.
        ///
        /// # Errors
        /// When called a second time: the tasks run already.
        pub fn spawn_links(
            spawner: &$crate::SendSpawner,
            link: &'static mut $crate::HostLink,
            mailbox: $crate::LinkSide,
            $(drive: ($drive_rx, $drive_tx),)?
            host: ($host_rx, $host_tx),
        ) -> Result<(), $crate::SpawnError> {
            $(
                let (receiver, transmitter): ($drive_rx, $drive_tx) = drive;
                spawner.spawn(drive_in(receiver)?);
                spawner.spawn(drive_out(transmitter)?);
            )?
            spawner.spawn(host_in(host.0)?);
            spawner.spawn(serve_host(link, mailbox)?);
            spawner.spawn(host_out(host.1)?);
            Ok(())
        }
    };
}
