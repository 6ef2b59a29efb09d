//! Where a store is: a file, a PostgreSQL database, or a service.

use std::convert::Infallible;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use crate::Peer;

/// Where a store is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StoreLocation {
    /// An SQLite file.
    File(PathBuf),
    /// `postgres://USER:PASSWORD@HOST:PORT/DATABASE`.
    Postgres(String),
    /// `grpc:HOST:PORT` or `grpcs:HOST:PORT`.
    Service(Peer),
}

impl FromStr for StoreLocation {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(if let Some(peer) = Peer::parse(text) {
            Self::Service(peer)
        } else if text.starts_with("postgres://") || text.starts_with("postgresql://") {
            Self::Postgres(text.to_owned())
        } else {
            Self::File(PathBuf::from(text))
        })
    }
}

impl fmt::Display for StoreLocation {
    /// As it was given, but without a password.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => path.display().fmt(f),
            Self::Service(peer) => peer.fmt(f),
            Self::Postgres(url) => {
                let (scheme, rest) = url.split_once("://").unwrap_or(("postgres", url));
                let (user, address) = rest.rsplit_once('@').unwrap_or(("", rest));
                let user = user.split(':').next().unwrap_or_default();
                let at = if user.is_empty() { "" } else { "@" };
                // Parameters may hold a password, too.
                let address = address.split('?').next().unwrap_or_default();
                write!(f, "{scheme}://{user}{at}{address}")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a location is misread, or if a password is printed.
    #[test]
    fn locations_are_read_and_keep_their_secrets() {
        let place = |text: &str| text.parse::<StoreLocation>().expect("infallible");
        assert_eq!(
            place("cell/calibration.db"),
            StoreLocation::File("cell/calibration.db".into())
        );
        assert!(matches!(place("grpc:host:1"), StoreLocation::Service(_)));
        let shown = place("postgres://robot:se@cret@db:5432/fleet?password=x").to_string();
        assert_eq!(shown, "postgres://robot@db:5432/fleet");
        assert_eq!(place("postgres:///fleet?host=/run").to_string(), "postgres:///fleet");
    }
}
