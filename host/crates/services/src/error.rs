//! Why a service could not be offered or reached.

#[cfg(feature = "grpc")]
use tonic::Code;

/// What can go wrong with services.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    /// A text that is not an address.
    #[error("\"{address}\" is not an address: give HOST:PORT, or a port alone for this machine only")]
    Address {
        /// As given.
        address: String,
    },
    /// Open to the network without protection.
    #[error(
        "{address} can be reached from other machines, and {missing} is missing: give --tls-cert, --tls-key and \
         --token-file, or listen on 127.0.0.1"
    )]
    Unprotected {
        /// Where it was to listen.
        address: String,
        /// What is missing.
        missing: &'static str,
    },
    /// A file for the protection cannot be used.
    #[error("{path}: {what}: {remedy}")]
    File {
        /// File.
        path: String,
        /// What is wrong.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
    /// The server cannot listen.
    #[error("cannot listen on {address} ({source}): choose another port, or end the program that uses it")]
    Listen {
        /// Where.
        address: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The transport failed.
    #[error("{peer}: {what}: check that `spherecal serve` runs there, and the network between")]
    Transport {
        /// The other side.
        peer: String,
        /// What failed.
        what: String,
    },
    /// The server's certificate is not accepted.
    #[cfg(feature = "grpc")]
    #[error("{peer}: {what}: {remedy}")]
    Tls {
        /// The other side.
        peer: String,
        /// What is wrong with its certificate.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// The other side refused or failed.
    #[cfg(feature = "grpc")]
    #[error("{peer}: {message}{}", remedy(*code))]
    Status {
        /// The other side.
        peer: String,
        /// Kind of refusal.
        code: Code,
        /// What it said.
        message: String,
    },
    /// The other side sent an impossible value.
    #[error("{peer}: {what}: use programs of the same version")]
    Nonsense {
        /// The other side.
        peer: String,
        /// What it said.
        what: String,
    },
    /// This program was built without the requested feature.
    #[error(
        "{what} needs the feature `services`, which this program was built without: build it with --features services"
    )]
    Feature {
        /// What is asked for.
        what: &'static str,
    },
    /// No runtime for the network could be made.
    #[error("the network runtime cannot be started: {0}")]
    Runtime(#[from] std::io::Error),
}

/// What to do about a refusal.
#[cfg(feature = "grpc")]
fn remedy(code: Code) -> &'static str {
    match code {
        Code::ResourceExhausted => " (wait until it is free)",
        Code::Unimplemented => " (start that server with this service)",
        _ => "",
    }
}

impl ServiceError {
    /// Whether the user's input is at fault.
    pub fn is_input(&self) -> bool {
        matches!(
            self,
            Self::Address { .. } | Self::Unprotected { .. } | Self::File { .. } | Self::Feature { .. }
        )
    }

    /// What the other side answered, as an error. A status with a cause was made on this side: the connection failed.
    #[cfg(feature = "grpc")]
    pub(crate) fn status(peer: &str, status: &tonic::Status) -> Self {
        if let Some(cause) = std::error::Error::source(status) {
            return Self::transport(peer, cause);
        }
        let message = match (status.message(), status.code()) {
            ("", Code::Unimplemented) => "the server does not have this service",
            (message, _) => message,
        };
        Self::Status {
            peer: peer.to_owned(),
            code: status.code(),
            message: message.to_owned(),
        }
    }

    /// What the transport said, with its causes.
    #[cfg(feature = "grpc")]
    pub(crate) fn transport(peer: &str, error: &dyn std::error::Error) -> Self {
        let mut what = error.to_string();
        let mut cause = error.source();
        while let Some(inner) = cause {
            let words = inner.to_string();
            if !what.contains(&words) {
                what = format!("{what}: {words}");
            }
            cause = inner.source();
        }
        match super::grpc::certificate_words(&what) {
            Some((what, remedy)) => Self::Tls {
                peer: peer.to_owned(),
                what,
                remedy,
            },
            None => Self::Transport {
                peer: peer.to_owned(),
                what,
            },
        }
    }
}
