//! Where a store is: a file, a PostgreSQL database, or a service.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

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

/// A server as a client names it: `grpc:HOST:PORT`, or `grpcs:HOST:PORT` with TLS. The token comes
/// from `SPHERECAL_TOKEN`, the trusted certificate from the file in `SPHERECAL_CA`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Peer {
    /// `HOST:PORT`.
    pub address: String,
    /// Whether TLS is used.
    pub encrypted: bool,
}

impl std::fmt::Display for Peer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}:{}", if self.encrypted { "grpcs" } else { "grpc" }, self.address)
    }
}

impl Peer {
    /// Reads `grpc:HOST:PORT` or `grpcs:HOST:PORT` (slashes after the colon are
    /// allowed); `None` for anything else.
    pub fn parse(text: &str) -> Option<Self> {
        let (scheme, address) = text.split_once(':')?;
        let encrypted = match scheme {
            "grpc" => false,
            "grpcs" => true,
            _ => return None,
        };
        let address = address.trim_start_matches("//").trim_end_matches('/');
        address.contains(':').then(|| Self {
            address: address.to_owned(),
            encrypted,
        })
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

#[cfg(test)]
mod peer_tests {
    use super::*;

    // Fails if a peer is misread.
    #[test]
    fn peers_are_read() {
        let peer = Peer::parse("grpcs://cell-4:7403/").expect("a peer");
        assert_eq!((peer.address.as_str(), peer.encrypted), ("cell-4:7403", true));
        assert_eq!(Peer::parse("grpc:[::1]:5").expect("a peer").to_string(), "grpc:[::1]:5");
        assert_eq!(Peer::parse("grpc:host"), None);
        assert_eq!(Peer::parse("postgres://h:1/d"), None);
    }
}
