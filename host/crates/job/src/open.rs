//! Opening the store at a location, whatever is there.

use spherecal_store::{CalibrationStore, Peer, SqlStore, StoreError, StoreLocation};

/// Opens the store at a location: a file, made with its folder if `create`, a
/// PostgreSQL database, whose tables are made if there are none, or a service.
///
/// # Errors
/// A file that is not ours, of another version, damaged or not writable; a
/// server that does not answer or refuses; a kind of store that this program
/// was built without.
pub fn open_store(location: &StoreLocation, create: bool) -> Result<Box<dyn CalibrationStore>, StoreError> {
    match location {
        StoreLocation::File(path) if create => Ok(Box::new(SqlStore::create_or_open(path)?)),
        StoreLocation::File(path) => Ok(Box::new(SqlStore::open(path)?)),
        StoreLocation::Postgres(url) => Ok(Box::new(SqlStore::postgres(url)?)),
        StoreLocation::Service(peer) => service(peer),
    }
}

#[cfg(feature = "services")]
fn service(peer: &Peer) -> Result<Box<dyn CalibrationStore>, StoreError> {
    let store = spherecal_services::grpc::RemoteStore::connect(peer).map_err(|error| StoreError::Remote {
        input: error.is_input(),
        source: Box::new(error),
    })?;
    Ok(Box::new(store))
}

#[cfg(not(feature = "services"))]
fn service(_peer: &Peer) -> Result<Box<dyn CalibrationStore>, StoreError> {
    Err(StoreError::Feature {
        what: "a store behind gRPC",
        feature: "services",
    })
}
