//! How a client proves that it may use a server. The token comes from `SPHERECAL_TOKEN`, the
//! trusted certificate from the file in `SPHERECAL_CA`.

use std::error::Error as _;
use std::path::Path;
use std::time::Duration;

use spherecal_store::Peer;
use tokio::runtime::Runtime;
use tonic::metadata::MetadataValue;
use tonic::service::Interceptor;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint};
use tonic::{Code, Request, Status};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_client::HealthClient;

use super::certificate::CA_VARIABLE;
use crate::ServiceError;
use crate::budget::HANDSHAKE;
use crate::guard::{CERTIFICATE, Guard, read_pem};
use spherecal_budget::services::SILENCE;

/// Environment variable with the token that a client shows.
const TOKEN_VARIABLE: &str = "SPHERECAL_TOKEN";

/// Refusals by which a server shows that it speaks the protocol.
const SPEAKS: [Code; 4] = [
    Code::Unimplemented,
    Code::NotFound,
    Code::Unauthenticated,
    Code::PermissionDenied,
];

/// A runtime for one connection. It has a thread of its own: a server closes a connection that leaves its pings without
/// an answer, and the thread answers them while the caller plans or waits for a person. A robot's connection has none:
/// a host that is silent for that long loses its robot anyway.
/// Errors: when the system gives no thread.
pub(super) fn own_runtime() -> std::io::Result<Runtime> {
    tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .thread_name("connection")
        .enable_all()
        .build()
}

/// Connects, with the token and the certificate that the environment names.
pub(super) async fn connect(peer: &Peer) -> Result<(Channel, Credentials), ServiceError> {
    let name = peer.to_string();
    let scheme = if peer.encrypted { "https" } else { "http" };
    let transport = |e: tonic::transport::Error| ServiceError::transport(&name, &e);
    let mut endpoint = Endpoint::from_shared(format!("{scheme}://{}", peer.address))
        .map_err(transport)?
        .tcp_nodelay(true)
        .connect_timeout(HANDSHAKE)
        .http2_keep_alive_interval(SILENCE)
        .keep_alive_timeout(SILENCE)
        .keep_alive_while_idle(true);
    if peer.encrypted {
        let mut tls = ClientTlsConfig::new();
        if let Some(path) = std::env::var_os(CA_VARIABLE) {
            tls = tls.ca_certificate(Certificate::from_pem(read_pem(Path::new(&path), CERTIFICATE)?));
        }
        endpoint = endpoint.tls_config(tls).map_err(transport)?;
    }
    let credentials = Credentials::from_environment(&name)?;
    let connecting = async {
        let channel = endpoint.connect().await.map_err(transport)?;
        // A server without this service speaks the protocol, too, and one that wants a token. An answer that cannot be
        // read earns no place.
        let mut health = HealthClient::with_interceptor(channel.clone(), credentials.clone());
        match health.check(HealthCheckRequest::default()).await {
            Ok(_) => Ok(channel),
            Err(status) if status.source().is_none() && SPEAKS.contains(&status.code()) => Ok(channel),
            Err(status) => Err(ServiceError::status(&name, &status)),
        }
    };
    let channel = within(
        HANDSHAKE,
        &name,
        "accepted the connection and did not answer",
        connecting,
    )
    .await?;
    Ok((channel, credentials))
}

/// Waits for what a server owes, at most so long. `what` it did is told otherwise.
pub(super) async fn within<T>(
    most: Duration,
    peer: &str,
    what: &str,
    owed: impl Future<Output = Result<T, ServiceError>>,
) -> Result<T, ServiceError> {
    match tokio::time::timeout(most, owed).await {
        Ok(answer) => answer,
        Err(_) => Err(ServiceError::Transport {
            peer: peer.to_owned(),
            what: format!("the server {what} for {} s", most.as_secs_f64()),
        }),
    }
}

/// The token of a client, put on every request.
#[derive(Clone, Default)]
pub(super) struct Credentials(Option<MetadataValue<tonic::metadata::Ascii>>);

impl Credentials {
    fn from_environment(peer: &str) -> Result<Self, ServiceError> {
        let Ok(token) = std::env::var(TOKEN_VARIABLE) else {
            return Ok(Self(None));
        };
        let value = format!("Bearer {}", token.trim())
            .parse()
            .map_err(|_| ServiceError::Nonsense {
                peer: peer.to_owned(),
                what: format!("{TOKEN_VARIABLE} contains characters that are not allowed in a token"),
            })?;
        Ok(Self(Some(value)))
    }
}

impl Interceptor for Credentials {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(value) = &self.0 {
            request.metadata_mut().insert("authorization", value.clone());
        }
        Ok(request)
    }
}

impl Interceptor for Guard {
    fn call(&mut self, request: Request<()>) -> Result<Request<()>, Status> {
        let shown = request
            .metadata()
            .get("authorization")
            .and_then(|value| value.to_str().ok())
            .and_then(|value| value.strip_prefix("Bearer "));
        match shown {
            _ if !self.wants_token() => Ok(request),
            Some(token) if self.takes_token(token) => Ok(request),
            Some(_) => Err(Status::unauthenticated(
                "the bearer token is not that of this server: SPHERECAL_TOKEN must have what is in the server's \
                 --token-file",
            )),
            None => Err(Status::unauthenticated(
                "this server wants a bearer token, and none was shown: give what is in the server's --token-file in \
                 SPHERECAL_TOKEN",
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::GuardFiles;

    fn file(folder: &Path, name: &str, text: &str) -> PathBuf {
        let path = folder.join(name);
        std::fs::write(&path, text).expect("written");
        path
    }

    // Fails if a request without the token, or with another one, is accepted.
    #[test]
    fn only_the_token_opens() {
        let folder = tempfile::tempdir().expect("a folder");
        let token = "0123456789abcdef0123456789abcdef";
        let files = GuardFiles {
            token: Some(file(folder.path(), "token", &format!("{token}\n"))),
            ..GuardFiles::default()
        };
        let mut guard = Guard::new("127.0.0.1:1".parse().expect("address"), &files).expect("protected");
        let mut with = |header: Option<String>| {
            let mut request = Request::new(());
            if let Some(value) = header {
                request
                    .metadata_mut()
                    .insert("authorization", value.parse().expect("ascii"));
            }
            guard.call(request).is_ok()
        };
        assert!(with(Some(format!("Bearer {token}"))));
        assert!(!with(None));
        assert!(!with(Some(token.to_owned())));
        assert!(!with(Some(format!("Bearer {token}0"))));
        assert!(!with(Some("Bearer ".to_owned())));
        // A browser's pass is not the token, and gives access to no service.
        let pass = guard.pass().expect("a token");
        assert!(guard.takes_pass(&pass) && !guard.takes_token(&pass) && !guard.takes_pass(token));
        assert!(guard.call(Request::new(())).is_err());
        assert_eq!(Guard::default().pass(), None);
        assert!(!Guard::default().takes_pass(""));
    }
}
