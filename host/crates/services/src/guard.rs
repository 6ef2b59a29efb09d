//! Decides who may use a server, and how a client proves it.
//!
//! On loopback every program of this machine may. Beyond loopback, a server needs a certificate and
//! a token, or it does not start. A client needs the token, and the certificate of the authority
//! that signed the server's certificate.

use std::net::{SocketAddr, ToSocketAddrs};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::ServiceError;

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
    /// Certificate chain and private key, both PEM.
    pub(crate) tls: Option<(Vec<u8>, Vec<u8>)>,
}

impl Guard {
    /// Reads the files and refuses an address beyond loopback without them.
    ///
    /// # Errors
    /// An unprotected address, or a file that cannot be used.
    pub fn new(address: SocketAddr, files: &GuardFiles) -> Result<Self, ServiceError> {
        let tls = match (&files.certificate, &files.key) {
            (Some(_), Some(_)) if cfg!(not(feature = "grpc")) => return Err(ServiceError::Feature { what: "TLS" }),
            (Some(certificate), Some(key)) => Some((read_pem(certificate, CERTIFICATE)?, read_pem(key, PRIVATE_KEY)?)),
            (None, None) => None,
            (Some(path), None) | (None, Some(path)) => {
                return Err(ServiceError::File {
                    path: path.display().to_string(),
                    what: "certificate and key belong together".to_owned(),
                    remedy: "give both --tls-cert and --tls-key",
                });
            }
        };
        let token = files.token.as_deref().map(token).transpose()?;
        let unprotected = |missing| ServiceError::Unprotected {
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
        // Compares digests, so that the duration reveals nothing about the token.
        self.token == Some(digest(shown.as_bytes()))
    }

    /// The cookie of a browser that has shown the token. It gives access to the page and to no
    /// service, and does not reveal the token.
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

fn digest(bytes: &[u8]) -> [u8; 32] {
    Sha256::digest(bytes).into()
}

/// What a file of certificates holds.
pub(crate) const CERTIFICATE: &str = "CERTIFICATE";
/// What a file with a key holds; the kind of the key may stand before it.
const PRIVATE_KEY: &str = "PRIVATE KEY";

/// Reads a PEM file that must hold `what`.
pub(crate) fn read_pem(path: &Path, what: &'static str) -> Result<Vec<u8>, ServiceError> {
    let bytes = read(path)?;
    let text = String::from_utf8_lossy(&bytes);
    let holds = |line: &str| line.starts_with("-----BEGIN ") && line.trim_end().ends_with(&format!("{what}-----"));
    if text.lines().any(holds) {
        return Ok(bytes);
    }
    Err(ServiceError::File {
        path: path.display().to_string(),
        what: format!("it has no line -----BEGIN {what}-----"),
        remedy: "give a PEM file: --tls-cert and SPHERECAL_CA take certificates, --tls-key a private key without a password",
    })
}

pub(crate) fn read(path: &Path) -> Result<Vec<u8>, ServiceError> {
    std::fs::read(path).map_err(|error| ServiceError::File {
        path: path.display().to_string(),
        what: error.to_string(),
        remedy: "check the path and its permissions",
    })
}

fn token(path: &Path) -> Result<String, ServiceError> {
    let text = String::from_utf8_lossy(&read(path)?).trim().to_owned();
    if text.len() < TOKEN_LEAST || !text.chars().all(|c| c.is_ascii_graphic()) {
        return Err(ServiceError::File {
            path: path.display().to_string(),
            what: format!("a token needs at least {TOKEN_LEAST} printable characters"),
            remedy: "make one with `openssl rand -hex 32`",
        });
    }
    Ok(text)
}

/// Where a server listens: `HOST:PORT`, or a port alone on this machine only.
/// Errors: when the text is not an address.
pub(crate) fn listen_address(text: &str) -> Result<SocketAddr, ServiceError> {
    let whole = if text.contains(':') {
        text.to_owned()
    } else {
        format!("127.0.0.1:{text}")
    };
    let refused = || ServiceError::Address {
        address: text.to_owned(),
    };
    whole
        .to_socket_addrs()
        .ok()
        .and_then(|mut a| a.next())
        .ok_or_else(refused)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(folder: &Path, name: &str, text: &str) -> PathBuf {
        let path = folder.join(name);
        std::fs::write(&path, text).expect("written");
        path
    }

    // Fails if an address that other machines can reach is served without TLS or without a token,
    // or if a short token is accepted.
    #[test]
    fn beyond_loopback_tls_and_token_are_demanded() {
        let folder = tempfile::tempdir().expect("a folder");
        let certificate = Some(file(folder.path(), "cert.pem", "-----BEGIN CERTIFICATE-----\n"));
        let key = Some(file(folder.path(), "key.pem", "-----BEGIN PRIVATE KEY-----\n"));
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
        assert!(refused(own, files(&key, &certificate, &None)).contains("it has no line -----BEGIN CERTIFICATE-----"));
        assert!(refused(own, files(&None, &None, &short)).contains("openssl rand"));
        let guard = Guard::new(open, &files(&certificate, &key, &long));
        if cfg!(feature = "grpc") {
            assert!(guard.expect("protected").is_encrypted());
        } else {
            let refusal = guard.err().expect("no TLS").to_string();
            assert!(refusal.contains("--features services"), "{refusal}");
        }
    }
}
