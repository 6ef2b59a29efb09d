//! What one peer may take of a server, and how long a client waits for one: every limit of the web page and of the
//! services, in one place.
//!
//! | what | limit | why |
//! |---|---|---|
//! | connections | [`CONNECTIONS`], [`CONNECTIONS_OF_ONE_ADDRESS`] | a server has few honest clients |
//! | first request | [`FIRST_REQUEST`] | a peer earns its connection by a request |
//! | streams, unread bytes, headers of a connection | [`STREAMS`], [`WINDOW`], [`HEADERS`] | memory |
//! | bytes of a robot's turn | [`TURN_BYTES`] | memory |
//! | responses that nobody has read | [`RESPONSES`], each [`RESPONSE`] | memory |
//! | silence of a connection | [`SILENCE`] | half-open connections |
//! | first answer to a client | [`HANDSHAKE`] | a server earns its client by an answer |
//! | answer to a client | [`ANSWER`], [`SHOT`], [`TURN`] | a client that waits holds an arm |

use std::time::Duration;

/// Most connections at one time. Together with the limits of one connection this limits the memory of a server.
pub(crate) const CONNECTIONS: usize = 128;
/// Most connections of one address beyond loopback.
pub(crate) const CONNECTIONS_OF_ONE_ADDRESS: usize = 32;
/// Time within which a connection must send its first complete request, TLS handshake included.
pub(crate) const FIRST_REQUEST: Duration = Duration::from_secs(5);
/// Time after which a connection without a complete request is closed first, where there are too many.
pub(crate) const LATE: Duration = Duration::from_secs(1);
/// Most responses that wait to be read, each of at most some MB. One more closes the connection that has left one
/// unread for the longest time: an honest client reads within milliseconds.
pub(crate) const RESPONSES: usize = 32;
/// Time within which a response must be read. A large report takes some seconds over a slow network.
pub(crate) const RESPONSE: Duration = Duration::from_millis(if cfg!(test) { 500 } else { 30_000 });
/// Age up to which the report of a run in progress is shown again. To write one takes about a second of one core.
pub(crate) const REPORT: Duration = Duration::from_secs(5);
/// Most streams of one connection at one time.
#[cfg(feature = "grpc")]
pub(crate) const STREAMS: u32 = 32;
/// Bytes that one connection may have sent and nobody has read yet.
#[cfg(feature = "grpc")]
pub(crate) const WINDOW: u32 = 256 * 1024;
/// Most bytes of the headers of one request.
#[cfg(feature = "grpc")]
pub(crate) const HEADERS: u32 = 16 * 1024;
/// Most bytes of a message to a robot: an order, or a host's frames of one period, of which each has 2,304 bytes at most.
#[cfg(feature = "grpc")]
pub(crate) const TURN_BYTES: usize = 256 * 1024;
/// Time after which a silent peer is asked whether it lives, and time for its answer. A machine that computes may
/// hold a process up for some seconds.
#[cfg(feature = "grpc")]
pub(crate) const SILENCE: Duration = Duration::from_secs(20);
/// Time within which a server must answer a client's first request, connection included.
#[cfg(feature = "grpc")]
pub(crate) const HANDSHAKE: Duration = Duration::from_millis(if cfg!(test) { 500 } else { 5_000 });
/// Time within which a server must answer any other request. A store waits 10 s for a lock, and a slow disk takes 8 s;
/// the host keeps its controller alive for 30 s while it stores.
#[cfg(feature = "grpc")]
pub(crate) const ANSWER: Duration = Duration::from_millis(if cfg!(test) { 500 } else { 30_000 });
/// Time within which a tracker must give a shot. A person may have to find the reflector again.
#[cfg(feature = "grpc")]
pub(crate) const SHOT: Duration = Duration::from_millis(if cfg!(test) { 500 } else { 120_000 });
/// Time within which a robot must answer for one period, like a controller on TCP.
#[cfg(feature = "grpc")]
pub(crate) const TURN: Duration = Duration::from_mins(1);
