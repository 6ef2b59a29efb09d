//! As much of HTTP/1.1 as the Robot API of PolyScope X needs: one request and one answer on a connection, then it ends.
//!
//! Source of the format: RFC 9112 (chunks: section 7.1, the length of a body: section 6.3). Redirections are not followed.

use spherecal_budget::robot::HTTP_BYTES;

use super::WireError;

/// What a robot's Robot API has before each path. Source: `dashboard_client_implementation_x` of the maker's client library.
pub const ROBOT_API: &str = "/universal-robots/robot-api";

/// Status of an answer: done.
pub const HTTP_OK: u16 = 200;
/// Status of an answer without a body.
const NO_CONTENT: u16 = 204;
/// Status of an answer: the robot is in local control. Source: `urctl/robotapi.py` of JimothyJohn/UR-Docker, which saw it on the
/// maker's simulator.
pub const HTTP_FORBIDDEN: u16 = 403;
/// Status of an answer: the robot's state does not permit it, as unlocking without a stop. Source: README of
/// K-Michallik/remote_robot_controller, which lists each path's statuses.
pub const HTTP_CONFLICT: u16 = 409;

/// The name of these messages in errors.
const KIND: &str = "HTTP";
/// What stands between the head and the body.
const HEAD_ENDS: &[u8] = b"\r\n\r\n";
const LINE_ENDS: &[u8] = b"\r\n";

/// What a client asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HttpRequest {
    /// What is to be done: `GET`, `PUT`, `DELETE` ..
    pub method: String,
    /// With what.
    pub path: String,
    /// JSON, or nothing.
    pub body: Vec<u8>,
}

/// What a robot answers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HttpAnswer {
    /// 200 to 299: done.
    pub status: u16,
    /// JSON, or nothing.
    pub body: Vec<u8>,
}

impl HttpRequest {
    /// The bytes of this request to `host`.
    pub fn encode(&self, host: &str) -> Vec<u8> {
        let Self { method, path, body } = self;
        message(
            &format!("{method} {path} HTTP/1.1\r\nHost: {host}\r\nAccept: application/json"),
            body,
        )
    }

    /// The request that begins these bytes. `None` while it is not whole.
    ///
    /// # Errors
    /// A [`WireError`] for bytes that are none, or too many.
    pub fn decode(received: &[u8]) -> Result<Option<Self>, WireError> {
        let Some(head) = Head::decode(received)? else {
            return Ok(None);
        };
        let mut words = head.first.split(' ');
        let (Some(method), Some(path), Some(version), None) = (words.next(), words.next(), words.next(), words.next())
        else {
            return Err(fault("begins with no request"));
        };
        if !version.starts_with("HTTP/1.") || method.is_empty() {
            return Err(fault("begins with no request"));
        }
        // A request without a length has no body.
        let body = if head.chunked {
            chunks(head.body)?
        } else {
            head.body.get(..head.length.unwrap_or(0)).map(<[u8]>::to_vec)
        };
        Ok(body.map(|body| Self {
            method: method.to_owned(),
            path: path.to_owned(),
            body,
        }))
    }
}

impl HttpAnswer {
    /// The bytes of this answer.
    pub fn encode(&self) -> Vec<u8> {
        message(&format!("HTTP/1.1 {} ", self.status), &self.body)
    }

    /// The answer that begins these bytes. `None` while it is not whole. Once the robot has `closed` the connection nothing
    /// more comes; a body of which no length is told ends there.
    ///
    /// # Errors
    /// A [`WireError`] for bytes that are none, too many, or cut.
    pub fn decode(received: &[u8], closed: bool) -> Result<Option<Self>, WireError> {
        let cut = |field| {
            if closed {
                Err(WireError::Cut { kind: KIND, field })
            } else {
                Ok(None)
            }
        };
        let Some(head) = Head::decode(received)? else {
            return cut("head");
        };
        let mut words = head.first.split(' ');
        let version = words.next().is_some_and(|version| version.starts_with("HTTP/1."));
        let status = words.next().and_then(|status| status.parse().ok());
        let Some(status) = status.filter(|status| version && (100..600).contains(status)) else {
            return Err(fault("begins with no status"));
        };
        let body = if status == NO_CONTENT {
            Some(Vec::new())
        } else if head.chunked {
            chunks(head.body)?
        } else {
            match head.length {
                Some(length) => head.body.get(..length).map(<[u8]>::to_vec),
                None => closed.then(|| head.body.to_vec()),
            }
        };
        body.map_or_else(|| cut("body"), |body| Ok(Some(Self { status, body })))
    }
}

/// A message with this head and this body.
fn message(head: &str, body: &[u8]) -> Vec<u8> {
    let kind = if body.is_empty() {
        ""
    } else {
        "Content-Type: application/json\r\n"
    };
    let length = body.len();
    let mut bytes = format!("{head}\r\n{kind}Content-Length: {length}\r\nConnection: close\r\n\r\n").into_bytes();
    bytes.extend_from_slice(body);
    bytes
}

fn fault(fault: &'static str) -> WireError {
    WireError::Http { fault }
}

/// Refuses more bytes than a message has.
fn bounded(size: usize) -> Result<(), WireError> {
    let (least, most) = (0, HTTP_BYTES);
    if size > most {
        return Err(WireError::Size { size, least, most });
    }
    Ok(())
}

/// Where the first of these bytes begin.
fn find(bytes: &[u8], what: &[u8]) -> Option<usize> {
    bytes.windows(what.len()).position(|part| part == what)
}

/// What stands before the body, and what has come behind it.
struct Head<'a> {
    first: &'a str,
    length: Option<usize>,
    chunked: bool,
    body: &'a [u8],
}

impl<'a> Head<'a> {
    fn decode(received: &'a [u8]) -> Result<Option<Self>, WireError> {
        bounded(received.len())?;
        let Some(end) = find(received, HEAD_ENDS) else {
            return Ok(None);
        };
        let (text, body) = (&received[..end], &received[end + HEAD_ENDS.len()..]);
        let text = std::str::from_utf8(text).map_err(|_| WireError::Text { kind: KIND })?;
        let mut lines = text.split("\r\n");
        let mut head = Self {
            first: lines.next().unwrap_or_default(),
            length: None,
            chunked: false,
            body,
        };
        for line in lines {
            let (name, value) = line.split_once(':').ok_or_else(|| fault("has a line without a name"))?;
            let value = value.trim();
            if name.eq_ignore_ascii_case("Content-Length") {
                let length = value.parse().map_err(|_| fault("has a length that is no number"))?;
                bounded(length)?;
                if head.length.replace(length).is_some_and(|before| before != length) {
                    return Err(fault("has two lengths"));
                }
            } else if name.eq_ignore_ascii_case("Transfer-Encoding") {
                head.chunked = value.eq_ignore_ascii_case("chunked");
                if !head.chunked {
                    return Err(fault("has an encoding that is not known here"));
                }
            }
        }
        Ok(Some(head))
    }
}

/// The body in these chunks. `None` while the last one has not come.
fn chunks(mut bytes: &[u8]) -> Result<Option<Vec<u8>>, WireError> {
    let mut body = Vec::new();
    while let Some(end) = find(bytes, LINE_ENDS) {
        let size = std::str::from_utf8(&bytes[..end]).unwrap_or_default();
        let size = size.split(';').next().unwrap_or_default().trim();
        let size = usize::from_str_radix(size, 16).map_err(|_| fault("has a chunk without a size"))?;
        bounded(size)?;
        if size == 0 {
            return Ok(Some(body));
        }
        let Some(rest) = bytes.get(end + LINE_ENDS.len()..) else {
            break;
        };
        let (Some(chunk), Some(behind)) = (rest.get(..size), rest.get(size..size + LINE_ENDS.len())) else {
            break;
        };
        if behind != LINE_ENDS {
            return Err(fault("has a chunk of another size than it says"));
        }
        body.extend_from_slice(chunk);
        bytes = &rest[size + LINE_ENDS.len()..];
    }
    Ok(None)
}
