//! Why a server's certificate is not accepted, in words.

use spherecal_store::time::now_utc;

/// Environment variable with the file of the certificate that a client trusts.
pub(super) const CA_VARIABLE: &str = "SPHERECAL_CA";

/// What is wrong with a certificate and what to do, from what the TLS library says. `None` where it is about something else.
pub(crate) fn certificate_words(said: &str) -> Option<(String, String)> {
    words(
        said,
        std::env::var_os(CA_VARIABLE)
            .map(|path| path.to_string_lossy().into_owned())
            .as_deref(),
        &now_utc(),
    )
}

fn words(said: &str, trusted: Option<&str>, now: &str) -> Option<(String, String)> {
    let has = |word: &str| said.contains(word);
    let file = trusted.map_or_else(
        || format!("{CA_VARIABLE} names no file"),
        |path| format!("{CA_VARIABLE} is {path}"),
    );
    let day = now.split('T').next().unwrap_or(now);
    let found = if has("CaUsedAsEndEntity") {
        (
            "the server's certificate is that of an authority (CA:TRUE), and no server may use it".to_owned(),
            format!(
                "`openssl req -x509` makes such certificates: add -addext basicConstraints=critical,CA:FALSE and -addext \
                 subjectAltName=DNS:NAME or IP:ADDRESS, give the new file to --tls-cert and to {CA_VARIABLE} ({file})"
            ),
        )
    } else if has("UnknownIssuer") || has("BadSignature") {
        (
            format!("the server's certificate is not signed by a certificate that this computer trusts ({file})"),
            format!("give the file of the server's certificate, or of its authority, in {CA_VARIABLE}"),
        )
    } else if has("certificate expired") || has("Expired") {
        (
            format!(
                "the server's certificate has expired; today is {day} by this computer's clock ({})",
                detail(said)
            ),
            format!("make a new one for --tls-cert and {CA_VARIABLE} ({file}), or set the clock"),
        )
    } else if has("not valid yet") || has("NotValidYet") {
        (
            format!(
                "the server's certificate is not valid yet; today is {day} by this computer's clock ({})",
                detail(said)
            ),
            format!("set the clock, or make a new certificate for --tls-cert and {CA_VARIABLE} ({file})"),
        )
    } else if has("not valid for name") || has("NotValidForName") {
        (
            format!(
                "the server's certificate is for another name or address ({})",
                detail(said)
            ),
            "connect by a name in the certificate, or make one with -addext subjectAltName=DNS:NAME or IP:ADDRESS"
                .to_owned(),
        )
    } else if has("invalid peer certificate") {
        (
            format!("the server's certificate is not accepted ({}; {file})", detail(said)),
            "make a new one, version 3, with a subjectAltName".to_owned(),
        )
    } else if has("InvalidContentType") || has("corrupt message") {
        (
            "the server does not speak TLS".to_owned(),
            "give grpc: in place of grpcs:, or start the server with --tls-cert and --tls-key".to_owned(),
        )
    } else {
        return None;
    };
    Some(found)
}

/// What the TLS library says of the certificate.
fn detail(said: &str) -> &str {
    said.rsplit_once("invalid peer certificate: ")
        .map_or(said, |(_, detail)| detail)
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a message lacks the file in SPHERECAL_CA, the date, or what to do.
    #[test]
    fn every_refusal_has_file_and_remedy() {
        let told = |said: &str, trusted| {
            let (what, remedy) = words(said, trusted, "2026-11-24T08:00:00Z").expect("about a certificate");
            format!("{what}: {remedy}")
        };
        let ca = Some("ca.pem");
        let other = told(
            "transport error: invalid peer certificate: Other(OtherError(CaUsedAsEndEntity))",
            ca,
        );
        assert!(
            other.contains("CA:TRUE") && other.contains("openssl req -x509") && other.contains("ca.pem"),
            "{other}"
        );
        let unknown = told("invalid peer certificate: UnknownIssuer", ca);
        assert!(unknown.contains("SPHERECAL_CA is ca.pem"), "{unknown}");
        assert!(told("invalid peer certificate: UnknownIssuer", None).contains("SPHERECAL_CA names no file"));
        let old = told(
            "invalid peer certificate: certificate expired: verification time 1 (UNIX)",
            ca,
        );
        assert!(old.contains("today is 2026-11-24") && old.contains("ca.pem"), "{old}");
        let name = told("invalid peer certificate: certificate not valid for name \"a\"", ca);
        assert!(
            name.contains("for another name") && name.contains("subjectAltName"),
            "{name}"
        );
        assert!(told("received corrupt message of type InvalidContentType", ca).contains("does not speak TLS"));
        assert!(words("connection refused", ca, "").is_none());
    }
}
