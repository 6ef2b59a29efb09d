//! As much of HTTP/1.1 as the Robot API of PolyScope X needs: one request and one answer on a connection, then it ends. `httparse`
//! reads heads and sizes; the bytes come over the virtual network of tests, too, so no client or server of a library is used.
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
/// What ends a chunk.
const LINE_ENDS: &[u8] = b"\r\n";
/// Most fields of a head. Those that are needed have four.
const FIELDS: usize = 64;

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
        bounded(received.len())?;
        let mut fields = [httparse::EMPTY_HEADER; FIELDS];
        let mut request = httparse::Request::new(&mut fields);
        let httparse::Status::Complete(begins) = request.parse(received).map_err(unread)? else {
            return Ok(None);
        };
        let body = &received[begins..];
        // A request without a length has no body.
        let body = match Size::of(request.headers)? {
            Size::Chunks => chunks(body)?,
            Size::Bytes(length) => body.get(..length).map(<[u8]>::to_vec),
            Size::Unknown => Some(Vec::new()),
        };
        Ok(body.map(|body| Self {
            method: request.method.unwrap_or_default().to_owned(),
            path: request.path.unwrap_or_default().to_owned(),
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
        bounded(received.len())?;
        let mut fields = [httparse::EMPTY_HEADER; FIELDS];
        let mut answer = httparse::Response::new(&mut fields);
        let httparse::Status::Complete(begins) = answer.parse(received).map_err(unread)? else {
            return cut("head");
        };
        let Some(status) = answer.code.filter(|status| (100..600).contains(status)) else {
            return Err(fault("has no status"));
        };
        let body = &received[begins..];
        let body = match Size::of(answer.headers)? {
            _ if status == NO_CONTENT => Some(Vec::new()),
            Size::Chunks => chunks(body)?,
            Size::Bytes(length) => body.get(..length).map(<[u8]>::to_vec),
            Size::Unknown => closed.then(|| body.to_vec()),
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

fn unread(error: httparse::Error) -> WireError {
    fault(match error {
        httparse::Error::TooManyHeaders => "has too many fields",
        _ => "cannot be read",
    })
}

/// What the fields of a head say of the body.
enum Size {
    Bytes(usize),
    Chunks,
    Unknown,
}

impl Size {
    fn of(fields: &[httparse::Header<'_>]) -> Result<Self, WireError> {
        let mut size = Self::Unknown;
        for field in fields {
            let value = std::str::from_utf8(field.value).unwrap_or_default().trim();
            if field.name.eq_ignore_ascii_case("Content-Length") {
                let length = value.parse().map_err(|_| fault("has a length that is no number"))?;
                bounded(length)?;
                match size {
                    Self::Bytes(before) if before != length => return Err(fault("has two lengths")),
                    Self::Chunks => {}
                    _ => size = Self::Bytes(length),
                }
            } else if field.name.eq_ignore_ascii_case("Transfer-Encoding") {
                if !value.eq_ignore_ascii_case("chunked") {
                    return Err(fault("has an encoding that is not known here"));
                }
                size = Self::Chunks;
            }
        }
        Ok(size)
    }
}

/// The body in these chunks. `None` while the last one has not come.
fn chunks(mut bytes: &[u8]) -> Result<Option<Vec<u8>>, WireError> {
    let mut body = Vec::new();
    loop {
        let size = httparse::parse_chunk_size(bytes).map_err(|_| fault("has a chunk without a size"))?;
        let httparse::Status::Complete((begins, size)) = size else {
            return Ok(None);
        };
        let size = usize::try_from(size).unwrap_or(usize::MAX);
        bounded(size)?;
        if size == 0 {
            return Ok(Some(body));
        }
        let rest = &bytes[begins..];
        let (Some(chunk), Some(behind)) = (rest.get(..size), rest.get(size..size + LINE_ENDS.len())) else {
            return Ok(None);
        };
        if behind != LINE_ENDS {
            return Err(fault("has a chunk of another size than it says"));
        }
        body.extend_from_slice(chunk);
        bytes = &rest[size + LINE_ENDS.len()..];
    }
}
