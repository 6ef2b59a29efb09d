//! A service as a client names it.

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
