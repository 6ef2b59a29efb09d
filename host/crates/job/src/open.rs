//! Opens the store at a location of any kind.

use spherecal_store::{CalibrationStore, Peer, SqlStore, StoreError, StoreLocation};

/// Opens the store at a location: a file, created with its folder if `create` is set; a PostgreSQL
/// database, whose tables are created if there are none; or a service.
///
/// # Errors
/// The file is not a database of spherecal, has a newer version, is damaged or is not writable; the
/// server does not answer or refuses; this program was built without that kind of store.
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
