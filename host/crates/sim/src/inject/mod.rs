//! Fault injection: what goes wrong, when, and the device that makes it so.
//!
//! Vocabulary: an [`InjectedFault`] is one thing that goes wrong; a [`When`] says when
//! it begins, by tick, by phase or by chance; an [`Entry`] is both with a
//! duration; a [`FaultPlan`] is the list of a TOML file, with the seed of whatever is
//! drawn. [`PRESETS`] has one plan for each fault.
//!
//! ```text
//!   campaign ─▶ FaultyCell (a Device) ─▶ controller     ┐ frames and states are
//!                 │  Scheduler: tick, phase, chance    │ changed between them
//!                 ├─────────────────▶ drive / plant    ┘ [`Disturbance`]s of the plant
//!                 └─ HostFaults ────────▶ journal            the host's own computer
//! ```
//!
//! The device stands where [`LocalDevice`](spherecal_link::LocalDevice) stands and does the same
//! when nothing is due. It knows the controller's phase from the host link's
//! bytes, as any listener may, so the same plan works in-process, in QEMU and
//! with a drive behind a socket; faults of the arm itself want the simulated one.

mod fault;
mod faulty_cell;
mod host_faults;
mod listener;
mod plan;
mod presets;
mod scheduler;

pub use fault::{InjectedFault, Status};
pub use faulty_cell::{FaultyCell, FaultyCellError, FaultyDrive, Happened, HostKilled, Restart};
pub use host_faults::{FileLock, HostFaultJournal, HostFaults};
pub use plan::{Entry, FaultPlan, InjectError, When};
pub use presets::{PRESETS, Preset, preset, table};
