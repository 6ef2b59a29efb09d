//! Network services (Figure 4 of the paper): robot controller, laser tracker
//! and calibration database, for an external controller on another machine.
//!
//! ```text
//!                       ┌─ RobotController ── controller ── drive
//!   campaign ── gRPC ───┼─ LaserTracker ───── tracker
//!   (spherecal run)     ├─ CalibrationStore ─ SQLite or PostgreSQL
//!                       └─ LiveView ───────── the web page, on the same port
//!                             (spherecal serve)
//! ```
//!
//! The messages are in `proto/spherecal/v1/spherecal.proto`. The server also offers reflection and
//! health, so that `grpcurl` and similar tools need no files.
//!
//! The campaign is independent of this module. A robot behind gRPC is one more
//! [`Device`](spherecal_link::Device) ([`RemoteRobot`]); a store behind it is one more
//! [`CalibrationStore`](spherecal_store::CalibrationStore). Every number keeps its bits on the way,
//! so a run over the network records the same values as a run in this process.

mod certificate;
mod convert;
mod device;
mod live;
mod operate;
mod peer;
mod robot;
mod store_client;
mod store_server;
mod tracker;

pub use device::RemoteRobot;
pub use live::Publisher;
pub use operate::{DeviceFactory, RobotFacts};
pub use store_client::RemoteStore;
pub use tracker::{RemoteTracker, TrackerFactory};

pub(crate) use certificate::certificate_words;
pub(crate) use live::LiveService;
pub(crate) use robot::RobotService;
pub(crate) use store_server::StoreService;
pub(crate) use tracker::TrackerService;

/// The messages and services, as compiled from `spherecal.proto`.
#[allow(missing_docs, unreachable_pub, clippy::all, clippy::pedantic)]
pub mod proto {
    tonic::include_proto!("spherecal.v1");
}

/// The services' description of themselves, for reflection.
pub(crate) const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/spherecal.bin"));
