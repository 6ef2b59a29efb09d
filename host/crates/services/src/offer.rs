//! What a server offers.

use super::SharedStore;
#[cfg(feature = "grpc")]
use super::grpc::{DeviceFactory, RobotFacts, TrackerFactory};
use super::web::Page;

/// What a server offers. Requests for anything left out get UNIMPLEMENTED.
#[derive(Default)]
pub struct Offer {
    /// A robot, and what makes it at the first client.
    #[cfg(feature = "grpc")]
    pub robot: Option<(RobotFacts, DeviceFactory)>,
    /// Creates a laser tracker for each client; and the standard deviation of its coordinates, in
    /// m.
    #[cfg(feature = "grpc")]
    pub tracker: Option<(TrackerFactory, f64)>,
    /// The database.
    #[cfg(feature = "grpc")]
    pub store: Option<SharedStore>,
    /// The web page, and whether runs of other programs are shown on it.
    pub page: Option<(Page, bool)>,
}

impl Offer {
    /// The stores that are offered or shown.
    pub(crate) fn stores(&self) -> Vec<SharedStore> {
        #[allow(unused_mut, reason = "more with the feature")]
        let mut stores: Vec<SharedStore> = self.page.iter().filter_map(|(page, _)| page.store.clone()).collect();
        #[cfg(feature = "grpc")]
        stores.extend(self.store.clone());
        stores
    }
}
