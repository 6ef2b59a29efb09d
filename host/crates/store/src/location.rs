//! Where a store is: a file, a PostgreSQL database, or a service.

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

/// A text that names no store.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "there is no kind of database {scheme}://: give a file, postgres://USER@HOST/DATABASE, grpc:HOST:PORT or \
     grpcs:HOST:PORT"
)]
pub struct UnknownScheme {
    /// What stands before `://`. The rest may hold a password.
    pub scheme: String,
}

impl StoreLocation {
    /// Whether it holds a password. Then other users of the computer can read it in the list of
    /// processes.
    pub fn has_password(&self) -> bool {
        let Self::Postgres(url) = self else { return false };
        let (_, rest) = url.split_once("://").unwrap_or(("", url));
        let (user, address) = rest.rsplit_once('@').unwrap_or(("", rest));
        user.contains(':') || address.split_once('?').is_some_and(|(_, p)| p.contains("password="))
    }
}

impl FromStr for StoreLocation {
    type Err = UnknownScheme;

    fn from_str(text: &str) -> Result<Self, UnknownScheme> {
        if let Some(peer) = Peer::parse(text) {
            return Ok(Self::Service(peer));
        }
        match text.split_once("://") {
            Some(("postgres" | "postgresql", _)) => Ok(Self::Postgres(text.to_owned())),
            // A folder may have a colon at its end, but not the name of a scheme before it.
            Some((scheme, _))
                if !scheme.is_empty() && scheme.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'+') =>
            {
                Err(UnknownScheme {
                    scheme: scheme.to_owned(),
                })
            }
            _ => Ok(Self::File(PathBuf::from(text))),
        }
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

    // Fails if a database of an unknown kind is taken for a file, or if its password is printed.
    #[test]
    fn unknown_kinds_of_database_are_refused() {
        for text in ["mysql://robot:secret@db/fleet", "sqlite://x.db", "http://db:80"] {
            let refusal = text.parse::<StoreLocation>().expect_err("refused").to_string();
            let scheme = text.split_once(':').expect("a colon").0;
            assert!(refusal.contains(scheme) && refusal.contains("postgres://"), "{refusal}");
            assert!(!refusal.contains("secret"), "{refusal}");
        }
        assert!(matches!("a:/b.db".parse(), Ok(StoreLocation::File(_))));
    }

    // Fails if a password on the command line is not seen, or one is seen where none is.
    #[test]
    fn a_password_is_seen() {
        for (text, seen) in [
            ("postgres://robot:x@db/fleet", true),
            ("postgresql://robot@db/fleet?sslmode=require&password=x", true),
            ("postgres://robot@db:5432/fleet", false),
            ("postgres://db/fleet", false),
            ("grpc:db:7", false),
            ("a:b@c.db", false),
        ] {
            assert_eq!(
                text.parse::<StoreLocation>().expect("a place").has_password(),
                seen,
                "{text}"
            );
        }
    }

    // Fails if a location is misread, or if a password is printed.
    #[test]
    fn locations_are_read_and_keep_their_secrets() {
        let place = |text: &str| text.parse::<StoreLocation>().expect("a location");
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
