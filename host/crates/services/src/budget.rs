//! The budgets for which tests of this crate would wait: they wait for less time.

use std::time::Duration;

use spherecal_budget::services;

const fn here(limit: Duration) -> Duration {
    if cfg!(test) { Duration::from_millis(500) } else { limit }
}

/// Time within which a response must be read.
pub(crate) const RESPONSE: Duration = here(services::RESPONSE);
/// Time within which a server must answer a client's first request, connection included.
#[cfg(feature = "grpc")]
pub(crate) const HANDSHAKE: Duration = here(spherecal_budget::HANDSHAKE);
/// Time within which a server must answer any other request.
#[cfg(feature = "grpc")]
pub(crate) const ANSWER: Duration = here(services::ANSWER);
/// Time within which a tracker must give a shot.
#[cfg(feature = "grpc")]
pub(crate) const SHOT: Duration = here(services::SHOT);
