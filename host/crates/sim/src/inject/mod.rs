//! Fault injection: which faults occur and when, and the device that injects them.
//!
//! Vocabulary: an [`InjectedFault`] is one fault. A [`When`] is its start, by tick, by phase or at
//! random. A [`PlannedFault`] is both with a duration. A [`FaultPlan`] is the list in a TOML file, with the
//! seed of the random draws. [`PRESETS`] has one plan for each fault.
//!
//! ```text
//!   campaign ─▶ FaultyCell (a Device) ─▶ controller     ┐ frames and states are
//!                 │  Scheduler: tick, phase, chance    │ changed between them
//!                 ├─────────────────▶ drive / plant    ┘ [`Disturbance`]s of the plant
//!                 └─ HostFaults ────────▶ journal            the host's own computer
//! ```
//!
//! The device replaces [`LocalDevice`](spherecal_link::LocalDevice) and does the same while no fault is due. It
//! reads the controller's phase from the host link's bytes, as any listener may. So the same plan
//! works in-process, in QEMU and with a drive behind a socket. Faults of the arm itself need the
//! simulated arm.

mod fault;
mod faulty_cell;
mod faulty_states;
mod host_faults;
mod listener;
mod plan;
mod presets;
mod scheduler;

pub use fault::{InjectedFault, NotReadyStatus};
pub use faulty_cell::{FaultyCell, FaultyCellError, Happened, Restart};
pub use host_faults::{FileLock, HostFaultJournal, HostFaults, HostKilled};
pub use plan::{FaultPlan, InjectError, PlannedFault, When};
pub use presets::{PRESETS, Preset, preset, table};
pub use scheduler::FaultyDrive;
