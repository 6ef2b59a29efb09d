//! Drives that speak a robot's own real-time interface: no gateway stands between.
//!
//! ```text
//!   controller ─ LocalDevice ─ FrankaDrive ─ spherecal-fci ──TCP, UDP──▶ Panda, FR3
//!                            ├ KukaDrive ─── spherecal-fri ──UDP───────▶ LBR iiwa, LBR Med
//!                            └ UrDrive ───── spherecal-ur ───TCP───────▶ e-Series, UR20, UR30
//! ```
//!
//! The robot is the clock: an exchange answers the newest state and waits for the next one. The robots compensate
//! gravity, so their hello says so. A stop of the robot (reflex, user stop, safety stop, session lost) becomes a
//! [`DriveStatus`](spherecal_shared::protocol::drive::DriveStatus) that the controller takes for a fault; the robot's
//! own words are a [`DriveEvent`]. After a stop no torque leaves until the robot is ready and the controller enables
//! the drive again.
//!
//! Ticks count the periods of the commanded motion. While the brakes are closed, a state that was not read is no
//! missed period.

mod drive;
mod event;
mod franka;
mod histogram;
mod kuka;
mod monitor;
mod ur;
mod ur_start;

use spherecal_shared::Joints;

pub use drive::InterfaceDrive;
pub use event::DriveEvent;
pub use franka::{FrankaDrive, FrankaOptions, collision_behavior};
pub use histogram::{Histogram, WakeUps};
pub use kuka::{KukaDrive, KukaError, KukaOptions};
pub use monitor::{DriveRecord, Monitor};
pub use ur::UrDrive;
pub use ur_start::{UrError, UrOptions};

/// Makes the calling thread a real-time thread, as far as the system permits, and reports how it went. For the thread
/// that steps a drive with this monitor; call it once, before the loop.
pub fn enter_real_time(monitor: &Monitor) {
    monitor.announce(DriveEvent::Scheduled(spherecal_realtime::enter()));
}

/// What the robot does not say of itself over its own interface, but a controller has to know.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Undeclared {
    /// Inertia of each motor, seen at its joint, that lies between commanded and measured torque, in kg m², base to
    /// flange; empty: none.
    pub motor_kg_m2: Joints,
    /// Delay beyond one period, in µs.
    pub latency_us: u32,
}

/// Joints of an arm of Franka or KUKA.
pub const JOINTS: usize = 7;
/// Periods between a stop and the next attempt to move. The host sees the fault first.
const PAUSE_TICKS: u64 = 1000;
