//! Accepts connections within bounds, in front of the web page and the services.
//!
//! A server has few honest clients. It keeps at most [`CONNECTIONS`] connections open, and at most
//! [`CONNECTIONS_OF_ONE_ADDRESS`] of one address on the network. When one more arrives, a connection is
//! closed: first those that sent no complete request within [`LATE`](spherecal_budget::services::LATE), then the one that has been
//! silent longest. So idle connections cannot lock out a client. A connection that sends no
//! complete request within [`HANDSHAKE`] is always closed.

use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::{Duration, Instant};

use axum::extract::Request;
use axum::middleware::Next;
use axum::response::Response;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::oneshot;

use crate::responses::{OpenConnection, Responses};
use spherecal_budget::HANDSHAKE;
use spherecal_budget::services::{CONNECTIONS, CONNECTIONS_OF_ONE_ADDRESS, WAITING};

/// Wait after an accept that failed, for example because no file descriptor is free.
const AFTER_FAILURE: Duration = Duration::from_millis(50);

#[derive(Default)]
struct Open(Mutex<Vec<Arc<OpenConnection>>>);

impl Open {
    /// Registers a connection. If there are too many, closes the least useful one.
    fn admit(&self, entry: &Arc<OpenConnection>) {
        let mut open = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        open.retain(|e| e.is_open());
        let own = |e: &OpenConnection| e.peer == entry.peer;
        let of_peer = open.iter().filter(|e| own(e)).count();
        let crowded = !entry.peer.is_loopback() && of_peer >= CONNECTIONS_OF_ONE_ADDRESS;
        if crowded || open.len() >= CONNECTIONS {
            let least = (0..open.len())
                .filter(|&k| !crowded || own(&open[k]))
                .min_by_key(|&k| (!open[k].is_late(), open[k].last()));
            if let Some(k) = least {
                open.swap_remove(k).close();
            }
        }
        open.push(Arc::clone(entry));
    }

    /// Closes connections that never sent a complete request.
    fn sweep(&self) {
        let mut open = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        open.retain(|e| e.is_open());
        for entry in open.iter() {
            if !entry.proven.load(Ordering::Relaxed) && entry.opened.elapsed() > HANDSHAKE {
                entry.close();
            }
        }
    }
}

/// Listens at `address`; must be called within a runtime.
/// Errors: the address is in use or not available.
pub(crate) fn bound(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() {
        TcpSocket::new_v4()?
    } else {
        TcpSocket::new_v6()?
    };
    // A server that was just stopped may be started again at once.
    #[cfg(unix)]
    socket.set_reuseaddr(true)?;
    socket.bind(address)?;
    socket.listen(WAITING)
}

/// A listener that keeps the bounds of this module.
pub(crate) struct Listener {
    socket: TcpListener,
    open: Arc<Open>,
    responses: Arc<Responses>,
    /// Ends with the listener.
    sweeper: tokio::task::JoinHandle<()>,
}

impl Listener {
    /// Limits a listener; must be called within a runtime.
    pub(crate) fn new(listener: TcpListener) -> Self {
        let open = Arc::new(Open::default());
        let responses = Arc::new(Responses::default());
        let (swept, unread) = (Arc::clone(&open), Arc::clone(&responses));
        let sweeper = tokio::spawn(async move {
            loop {
                tokio::time::sleep(Duration::from_secs(1)).await;
                swept.sweep();
                unread.sweep();
            }
        });
        Self {
            socket: listener,
            open,
            responses,
            sweeper,
        }
    }

    /// The next connection. A failed accept is repeated.
    pub(crate) async fn next(&self) -> (Connection, SocketAddr) {
        loop {
            match self.socket.accept().await {
                Ok((stream, peer)) => {
                    // Without this option small messages are delayed, but still arrive.
                    let _ = stream.set_nodelay(true);
                    return (self.bounded(stream, peer), peer);
                }
                Err(error) => {
                    tracing::warn!(%error, "a connection could not be accepted");
                    tokio::time::sleep(AFTER_FAILURE).await;
                }
            }
        }
    }

    fn bounded(&self, stream: TcpStream, peer: SocketAddr) -> Connection {
        let (close, closed) = oneshot::channel();
        let entry = Arc::new(OpenConnection {
            peer: peer.ip().to_canonical(),
            opened: Instant::now(),
            last_ms: AtomicU64::new(0),
            proven: AtomicBool::new(false),
            close: Mutex::new(Some(close)),
        });
        self.open.admit(&entry);
        Connection {
            stream,
            closed,
            entry,
            responses: Arc::clone(&self.responses),
        }
    }

    /// Connections one after another, until the server drops the stream.
    #[cfg(feature = "grpc")]
    pub(crate) fn into_stream(self) -> impl tokio_stream::Stream<Item = io::Result<Connection>> {
        let (out, connections) = tokio::sync::mpsc::channel(1);
        tokio::spawn(async move {
            loop {
                tokio::select! {
                    (connection, _) = self.next() => {
                        if out.send(Ok(connection)).await.is_err() {
                            return;
                        }
                    }
                    () = out.closed() => return,
                }
            }
        });
        tokio_stream::wrappers::ReceiverStream::new(connections)
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        self.sweeper.abort();
    }
}

#[cfg(not(feature = "grpc"))]
impl axum::serve::Listener for Listener {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Connection, SocketAddr) {
        self.next().await
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.socket.local_addr()
    }
}

/// Marks the connection of a request as one that sends requests.
#[derive(Clone)]
pub(crate) struct Proof {
    connection: Arc<OpenConnection>,
    responses: Arc<Responses>,
}

/// A connection that can be closed from outside, with the time of its last byte.
pub(crate) struct Connection {
    stream: TcpStream,
    /// Ends when the connection is to be closed.
    closed: oneshot::Receiver<()>,
    entry: Arc<OpenConnection>,
    /// Responses of the whole server that wait to be read.
    responses: Arc<Responses>,
}

impl Connection {
    fn proof(&self) -> Proof {
        Proof {
            connection: Arc::clone(&self.entry),
            responses: Arc::clone(&self.responses),
        }
    }

    /// Fails if the connection was closed from outside; otherwise wakes when it is.
    fn check(&mut self, cx: &mut Context<'_>) -> io::Result<()> {
        match Pin::new(&mut self.closed).poll(cx) {
            Poll::Pending => Ok(()),
            Poll::Ready(_) => Err(io::ErrorKind::ConnectionAborted.into()),
        }
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.entry.close();
    }
}

impl AsyncRead for Connection {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        self.check(cx)?;
        let before = buf.filled().len();
        ready!(Pin::new(&mut self.stream).poll_read(cx, buf))?;
        if buf.filled().len() > before {
            self.entry.touch();
        }
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Connection {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        self.check(cx)?;
        let written = ready!(Pin::new(&mut self.stream).poll_write(cx, buf))?;
        self.entry.touch();
        Poll::Ready(Ok(written))
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        self.check(cx)?;
        let written = ready!(Pin::new(&mut self.stream).poll_write_vectored(cx, bufs))?;
        self.entry.touch();
        Poll::Ready(Ok(written))
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}

#[cfg(feature = "grpc")]
impl tonic::transport::server::Connected for Connection {
    type ConnectInfo = Proof;

    fn connect_info(&self) -> Proof {
        self.proof()
    }
}

#[cfg(not(feature = "grpc"))]
impl axum::extract::connect_info::Connected<axum::serve::IncomingStream<'_, Listener>> for Proof {
    fn connect_info(stream: axum::serve::IncomingStream<'_, Listener>) -> Self {
        stream.io().proof()
    }
}

/// Records that the connection has sent a complete request, and limits the time for which its response may wait to be
/// read.
pub(crate) async fn note_request(request: Request, next: Next) -> Response {
    #[cfg(feature = "grpc")]
    let proof = request.extensions().get::<Proof>().cloned();
    #[cfg(not(feature = "grpc"))]
    let proof = request
        .extensions()
        .get::<axum::extract::ConnectInfo<Proof>>()
        .map(|info| info.0.clone());
    let Some(proof) = proof else {
        return next.run(request).await;
    };
    proof.connection.proven.store(true, Ordering::Relaxed);
    // Every answer of the store is one message. The other services send for as long as their client listens, and
    // files, which have a dot in their name too, are in the program itself.
    let ends = !request.uri().path().contains('.') || request.uri().path().contains(".CalibrationStore/");
    let response = next.run(request).await;
    if ends {
        proof.responses.hold(response, proof.connection)
    } else {
        response
    }
}
