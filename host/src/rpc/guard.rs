//! Who may talk to a server, and how a client shows that it may.
//!
//! On loopback every program of this machine may. Beyond it a server has a
//! certificate and a token, or does not start; a client has the token, and the
//! certificate of whoever signed the server's.

use std::net::{SocketAddr, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::time::Duration;

use sha2::{Digest, Sha256};
use tonic::metadata::MetadataValue;
use tonic::service::Interceptor;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity, ServerTlsConfig};
use tonic::{Request, Status};

use super::RpcError;

/// Environment variable with the token that a client shows.
const TOKEN_VARIABLE: &str = "SPHERECAL_TOKEN";
/// Environment variable with the file of the certificate that a client trusts.
const CA_VARIABLE: &str = "SPHERECAL_CA";
/// Shortest token taken: 128 bits in hexadecimal.
const TOKEN_LEAST: usize = 32;

/// Files that protect a server.
#[derive(Clone, Debug, Default)]
pub struct GuardFiles {
    /// Certificate chain, PEM.
    pub certificate: Option<PathBuf>,
    /// Its private key, PEM.
    pub key: Option<PathBuf>,
    /// The token, alone in a file.
    pub token: Option<PathBuf>,
}

/// How a server is protected.
#[derive(Clone, Default)]
pub struct Guard {
    /// Digest of the token that clients must show.
    token: Option<[u8; 32]>,
    pub(super) tls: Option<ServerTlsConfig>,
}

impl Guard {
    /// Reads the files and refuses an address beyond loopback without them.
    ///
    /// # Errors
    /// An unprotected address, or a file that cannot be used.
    pub fn new(address: SocketAddr, files: &GuardFiles) -> Result<Self, RpcError> {
        let tls = match (&files.certificate, &files.key) {
            (Some(certificate), Some(key)) => {
                Some(ServerTlsConfig::new().identity(Identity::from_pem(read(certificate)?, read(key)?)))
            }
            (None, None) => None,
            (Some(path), None) | (None, Some(path)) => {
                return Err(RpcError::File {
                    path: path.display().to_string(),
                    what: "certificate and key belong together".to_owned(),
                    remedy: "give both --tls-cert and --tls-key",
                });
            }
        };
        let token = files.token.as_deref().map(token).transpose()?;
        let unprotected = |missing| RpcError::Unprotected {
            address: address.to_string(),
            missing,
        };
        if !address.ip().is_loopback() {
            if tls.is_none() {
                return Err(unprotected("TLS"));
            }
            if token.is_none() {
                return Err(unprotected("the token"));
            }
        }
        Ok(Self {
            token: token.map(|token| digest(token.as_bytes())),
            tls,
        })
    }

    /// Whether clients must use TLS.
    pub fn is_encrypted(&self) -> bool {
        self.tls.is_some()
    }

    /// Whether clients must show a token.
    pub fn wants_token(&self) -> bool {
        self.token.is_some()
    }

    /// Whether this is the token.
    pub fn takes_token(&self, shown: &str) -> bool {
        // Digests are compared, so that the time it takes tells nothing of the token.
        self.token == Some(digest(shown.as_bytes()))
    }

    /// What a browser that has shown the token shows from then on: it opens the
    /// page and no service, and the token cannot be told from it.
    pub fn pass(&self) -> Option<String> {
        let token = self.token?;
        let pass = digest(&[b"spherecal page ".as_slice(), &token].concat());
        Some(pass.iter().map(|byte| format!("{byte:02x}")).collect())
    }

    /// Whether this is the pass.
    pub fn takes_pass(&self, shown: &str) -> bool {
        self.pass()
            .is_some_and(|pass| digest(pass.as_bytes()) == digest(shown.as_bytes()))
    }
}

impl Interceptor for Guard {
    fn call(&mut self, request: Request<()>) -> Result<Request<()>, Status> {
        let shown = request
            .metadata()
            .get("authorization")
            .and_then(|value| value.to_str().ok())
            .and_then(|value| value.strip_prefix("Bearer "));
        if !self.wants_token() || shown.is_some_and(|token| self.takes_token(token)) {
            Ok(request)
        } else {
            Err(Status::unauthenticated("this server wants a bearer token"))
        }
    }
}

fn digest(bytes: &[u8]) -> [u8; 32] {
    Sha256::digest(bytes).into()
}

fn read(path: &Path) -> Result<Vec<u8>, RpcError> {
    std::fs::read(path).map_err(|error| RpcError::File {
        path: path.display().to_string(),
        what: error.to_string(),
        remedy: "check the path and its permissions",
    })
}

fn token(path: &Path) -> Result<String, RpcError> {
    let text = String::from_utf8_lossy(&read(path)?).trim().to_owned();
    if text.len() < TOKEN_LEAST || !text.chars().all(|c| c.is_ascii_graphic()) {
        return Err(RpcError::File {
            path: path.display().to_string(),
            what: format!("a token has {TOKEN_LEAST} printable characters at least"),
            remedy: "make one with `openssl rand -hex 32`",
        });
    }
    Ok(text)
}

/// Where a server listens: `HOST:PORT`, or a port alone on this machine only.
///
/// # Errors
/// Text that is no address.
pub(super) fn listen_address(text: &str) -> Result<SocketAddr, RpcError> {
    let whole = if text.contains(':') {
        text.to_owned()
    } else {
        format!("127.0.0.1:{text}")
    };
    let refused = || RpcError::Address {
        address: text.to_owned(),
    };
    whole
        .to_socket_addrs()
        .ok()
        .and_then(|mut a| a.next())
        .ok_or_else(refused)
}

/// A server as a client names it: `grpc:HOST:PORT`, or `grpcs:HOST:PORT` with
/// TLS; the token comes from `SPHERECAL_TOKEN`, the certificate to trust from
/// the file in `SPHERECAL_CA`.
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

    /// Connects, with what the environment says of token and certificate.
    pub(super) async fn connect(&self) -> Result<(Channel, Credentials), RpcError> {
        let name = self.to_string();
        let scheme = if self.encrypted { "https" } else { "http" };
        let transport = |e: tonic::transport::Error| RpcError::transport(&name, &e);
        let mut endpoint = Endpoint::from_shared(format!("{scheme}://{}", self.address))
            .map_err(transport)?
            .tcp_nodelay(true)
            .connect_timeout(Duration::from_secs(10));
        if self.encrypted {
            let mut tls = ClientTlsConfig::new();
            if let Some(path) = std::env::var_os(CA_VARIABLE) {
                tls = tls.ca_certificate(Certificate::from_pem(read(Path::new(&path))?));
            }
            endpoint = endpoint.tls_config(tls).map_err(transport)?;
        }
        let channel = endpoint.connect().await.map_err(transport)?;
        Ok((channel, Credentials::from_environment(&name)?))
    }
}

/// The token of a client, put on every request.
#[derive(Clone, Default)]
pub(super) struct Credentials(Option<MetadataValue<tonic::metadata::Ascii>>);

impl Credentials {
    fn from_environment(peer: &str) -> Result<Self, RpcError> {
        let Ok(token) = std::env::var(TOKEN_VARIABLE) else {
            return Ok(Self(None));
        };
        let value = format!("Bearer {}", token.trim())
            .parse()
            .map_err(|_| RpcError::Nonsense {
                peer: peer.to_owned(),
                what: format!("{TOKEN_VARIABLE} holds characters that no token has"),
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

#[cfg(test)]
mod tests {
    use super::*;

    fn file(folder: &Path, name: &str, text: &str) -> PathBuf {
        let path = folder.join(name);
        std::fs::write(&path, text).expect("written");
        path
    }

    // Fails if an address that others can reach is served without TLS or
    // without a token, or if a short token is taken.
    #[test]
    fn beyond_loopback_tls_and_token_are_demanded() {
        let folder = tempfile::tempdir().expect("a folder");
        let certificate = Some(file(folder.path(), "cert.pem", "x"));
        let key = Some(file(folder.path(), "key.pem", "x"));
        let long = Some(file(folder.path(), "token", &"a1".repeat(32)));
        let short = Some(file(folder.path(), "short", "secret"));
        let open: SocketAddr = "0.0.0.0:1".parse().expect("address");
        let own: SocketAddr = "127.0.0.1:1".parse().expect("address");
        let files = |certificate: &Option<PathBuf>, key: &Option<PathBuf>, token: &Option<PathBuf>| GuardFiles {
            certificate: certificate.clone(),
            key: key.clone(),
            token: token.clone(),
        };
        let refused = |address, files: GuardFiles| Guard::new(address, &files).err().expect("refused").to_string();
        assert!(Guard::new(own, &GuardFiles::default()).is_ok());
        assert!(refused(open, GuardFiles::default()).contains("TLS is missing"));
        assert!(refused(open, files(&None, &None, &long)).contains("TLS is missing"));
        assert!(refused(open, files(&certificate, &key, &None)).contains("the token is missing"));
        assert!(refused(own, files(&certificate, &None, &None)).contains("--tls-key"));
        assert!(refused(own, files(&None, &None, &short)).contains("openssl rand"));
        let guard = Guard::new(open, &files(&certificate, &key, &long)).expect("protected");
        assert!(guard.is_encrypted());
    }

    // Fails if a request without the token, or with another, goes through.
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
        // A browser's pass is not the token, and opens no service.
        let pass = guard.pass().expect("a token");
        assert!(guard.takes_pass(&pass) && !guard.takes_token(&pass) && !guard.takes_pass(token));
        assert!(guard.call(Request::new(())).is_err());
        assert_eq!(Guard::default().pass(), None);
        assert!(!Guard::default().takes_pass(""));
    }

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
