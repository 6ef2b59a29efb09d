//! Shows a calibration to others: the web page, the live view, and gRPC services.
//!
//! ```text
//!   campaign ─▶ live (an Observer) ─▶ Hub ─▶ web page ◀─ browsers
//!   spherecal run ─── gRPC ─── robot controller, laser tracker, store, live view
//! ```
//!
//! | module | what | feature |
//! |---|---|---|
//! | [`live`] | a run as others see it while it goes on | |
//! | [`web`] | the page | |
//! | [`server`](Server) | one port for the page and the services | |
//! | `grpc` | network services (Figure 4 of the paper) and their clients | `grpc` |
//!
//! Callers pass reports, trackers, devices and stores as closures and trait objects, so this crate
//! does not depend on the job.
//!
//! Everyone who may use a robot's services may move the robot. So beyond loopback a server does not
//! start without TLS and a token ([`Guard`]).

mod budget;
mod error;
#[cfg(feature = "grpc")]
pub mod grpc;
mod guard;
mod listen;
pub mod live;
mod offer;
mod responses;
#[cfg(feature = "grpc")]
mod serve;
mod server;
pub mod web;

use std::sync::{Arc, Mutex};

use spherecal_store::CalibrationStore;

pub use error::ServiceError;
pub use guard::{Guard, GuardFiles};
pub use offer::Offer;
pub use server::Server;

/// A store that several requests work with, one at a time.
pub type SharedStore = Arc<Mutex<Box<dyn CalibrationStore>>>;

#[cfg(test)]
mod budget_tests;
