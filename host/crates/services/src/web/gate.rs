//! Who may look at the page.

use std::net::IpAddr;
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::header::{AUTHORIZATION, CONTENT_LENGTH, COOKIE, HOST, SET_COOKIE};
use axum::http::{HeaderMap, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::{RequestContext, file, refused};

/// Name of the cookie of browsers that have shown the token.
const PASS: &str = "spherecal_pass";

/// Without a token the server answers only requests for a name of this machine itself.
pub(super) async fn own_name(State(site): State<Arc<RequestContext>>, request: Request, next: Next) -> Response {
    let name = request
        .uri()
        .authority()
        .map(|authority| authority.as_str().to_owned())
        .or_else(|| request.headers().get(HOST)?.to_str().ok().map(str::to_owned))
        .unwrap_or_default();
    if site.guard.wants_token() || is_own(&name) {
        next.run(request).await
    } else {
        refused(
            StatusCode::MISDIRECTED_REQUEST,
            format!(
                "\"{name}\" is not a local name of this machine: use 127.0.0.1, or start the server with a token\n"
            ),
        )
    }
}

/// Whether `HOST[:PORT]` is a name of this machine that no other site can point here.
fn is_own(name: &str) -> bool {
    let host = match name.strip_prefix('[') {
        Some(rest) => match rest.split_once(']') {
            Some((host, after)) if after.is_empty() || is_port(after) => host,
            _ => return false,
        },
        None => name.rsplit_once(':').map_or(name, |(host, _)| host),
    };
    host.eq_ignore_ascii_case("localhost") || host.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

/// Whether text is `:` and digits.
fn is_port(text: &str) -> bool {
    text.strip_prefix(':')
        .is_some_and(|digits| !digits.is_empty() && digits.bytes().all(|b| b.is_ascii_digit()))
}

/// Admits browsers that have shown the token, and asks others for it.
pub(super) async fn admit(State(site): State<Arc<RequestContext>>, request: Request, next: Next) -> Response {
    if !site.guard.wants_token() || has_pass(&site, request.headers()) || has_token(&site, request.headers()) {
        return next.run(request).await;
    }
    if request.uri().path() == "/" {
        let mut page = file("text/html; charset=utf-8", include_str!("login.html"));
        *page.status_mut() = StatusCode::UNAUTHORIZED;
        page
    } else {
        refused(StatusCode::UNAUTHORIZED, "this server wants a bearer token\n")
    }
}

fn has_pass(site: &RequestContext, headers: &HeaderMap) -> bool {
    headers
        .get_all(COOKIE)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(';'))
        .filter_map(|cookie| cookie.trim().strip_prefix(PASS)?.strip_prefix('='))
        .any(|pass| site.guard.takes_pass(pass))
}

fn has_token(site: &RequestContext, headers: &HeaderMap) -> bool {
    headers
        .get(AUTHORIZATION)
        .and_then(|value| value.to_str().ok()?.strip_prefix("Bearer "))
        .is_some_and(|token| site.guard.takes_token(token))
}

/// Exchanges the token for a cookie that scripts cannot read and other sites cannot send.
pub(super) async fn login(State(site): State<Arc<RequestContext>>, headers: HeaderMap) -> Response {
    // The token is in a header, where pages of other sites cannot put it.
    if headers.get(CONTENT_LENGTH).is_some_and(|length| length != "0") {
        return refused(StatusCode::PAYLOAD_TOO_LARGE, "the token goes into the header\n");
    }
    match site.guard.pass() {
        Some(pass) if has_token(&site, &headers) => {
            let secure = if site.guard.is_encrypted() { "; Secure" } else { "" };
            let cookie = format!("{PASS}={pass}; Path=/; HttpOnly; SameSite=Strict{secure}");
            (StatusCode::NO_CONTENT, [(SET_COOKIE, cookie)]).into_response()
        }
        _ => refused(StatusCode::UNAUTHORIZED, "this is not the token\n"),
    }
}

#[cfg(test)]
mod tests {
    use super::is_own;

    // Fails if a name that another site can point at this machine is accepted, or if a local name
    // is refused.
    #[test]
    fn names_of_this_machine() {
        for own in [
            "127.0.0.1:7403",
            "localhost:1",
            "LOCALHOST",
            "127.8.8.8",
            "[::1]:7403",
            "[::1]",
        ] {
            assert!(is_own(own), "{own}");
        }
        for other in [
            "",
            "evil.example:7403",
            "127.0.0.1.evil.example",
            "10.0.0.7:7403",
            "localhost.evil",
            "[::2]:1",
            "[::1].evil.com",
            "[::1].evil.com:7403",
            "[::1]:",
            "[::1]:7403.evil.com",
            "[::1",
        ] {
            assert!(!is_own(other), "{other}");
        }
    }
}
