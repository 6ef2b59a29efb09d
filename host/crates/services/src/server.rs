//! One server on one port: the web page and, with the feature `grpc`, robot, tracker, store, health
//! and reflection.

use std::net::SocketAddr;
use std::sync::Arc;

use tokio::runtime::Runtime;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;

use super::guard::listen_address;
#[cfg(not(feature = "grpc"))]
use super::listen::Listener;
use super::listen::bound;
use super::live::{Hub, ViewerMessage, WAITING};
use super::offer::Offer;
use super::{Guard, GuardFiles, ServiceError, SharedStore};

/// How long open connections may take to end.
const LAST: std::time::Duration = std::time::Duration::from_secs(1);

/// A server that runs until it is dropped.
pub struct Server {
    runtime: Option<Runtime>,
    address: SocketAddr,
    encrypted: bool,
    stop: Option<oneshot::Sender<()>>,
    /// Ends with the last connection.
    ended: Option<JoinHandle<()>>,
    hub: Option<Arc<Hub>>,
    /// Runs of this program that are shown.
    shows: Vec<JoinHandle<()>>,
    /// Must outlive the runtime: a store must not be dropped inside one.
    _stores: Vec<SharedStore>,
}

impl Server {
    /// Refuses an address that is none, and protection that is missing or cannot be read, before anything
    /// is opened.
    ///
    /// # Errors
    /// Like [`start`](Self::start), but for an address that is in use.
    pub fn check(address: &str, files: &GuardFiles) -> Result<(), ServiceError> {
        Guard::new(listen_address(address)?, files).map(|_| ())
    }

    /// Listens at `address` (`HOST:PORT`, or a port alone for this machine) and serves in its own
    /// threads.
    ///
    /// # Errors
    /// The address is in use or not available, or lies beyond loopback without protection.
    pub fn start(address: &str, files: &GuardFiles, offer: Offer) -> Result<Self, ServiceError> {
        let wanted = listen_address(address)?;
        let guard = Guard::new(wanted, files)?;
        let encrypted = guard.is_encrypted();
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build()?;
        let listen = |source| ServiceError::Listen {
            address: wanted.to_string(),
            source,
        };
        let page = offer.page.as_ref().map(|(page, _)| page.clone());
        let stores = offer.stores();
        let (stop, stopped) = oneshot::channel::<()>();
        let (address, ended) = runtime.block_on(async move {
            let listener = bound(wanted).map_err(listen)?;
            let address = listener.local_addr().map_err(listen)?;
            let ended = Box::pin(serve(listener, guard, offer, stopped)).await?;
            Ok::<_, ServiceError>((address, ended))
        })?;
        Ok(Self {
            runtime: Some(runtime),
            address,
            encrypted,
            stop: Some(stop),
            ended: Some(ended),
            hub: page.map(|page| page.hub),
            shows: Vec::new(),
            _stores: stores,
        })
    }

    /// Shows a run of this program on the page; its messages go into the returned channel. `None`
    /// without a page.
    pub fn show(&mut self) -> Option<mpsc::Sender<ViewerMessage>> {
        let (out, messages) = mpsc::channel(WAITING);
        let hub = Arc::clone(self.hub.as_ref()?);
        self.shows.push(self.runtime.as_ref()?.spawn(hub.show(messages)));
        Some(out)
    }

    /// The page as a browser names it.
    pub fn page_url(&self) -> String {
        let scheme = if self.encrypted { "https" } else { "http" };
        format!("{scheme}://{}/", self.address)
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Whether clients must use TLS.
    pub fn is_encrypted(&self) -> bool {
        self.encrypted
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if let Some(runtime) = &self.runtime {
            // Messages that were already sent reach the page first.
            for show in self.shows.drain(..) {
                let _ = runtime.block_on(async { tokio::time::timeout(LAST, show).await });
            }
        }
        if let Some(hub) = &self.hub {
            hub.close();
        }
        if let Some(stop) = self.stop.take() {
            // The server may have ended already.
            let _ = stop.send(());
        }
        if let Some(runtime) = self.runtime.take() {
            if let Some(ended) = self.ended.take() {
                // Browsers receive the last messages; the server waits for them for a limited time.
                let _ = runtime.block_on(async { tokio::time::timeout(LAST, ended).await });
            }
            runtime.shutdown_timeout(LAST);
        }
    }
}

/// Serves the page, and nothing else, until it is stopped.
#[cfg(not(feature = "grpc"))]
#[expect(clippy::unused_async, reason = "the form of the function that serves gRPC too")]
async fn serve(
    listener: tokio::net::TcpListener,
    guard: Guard,
    offer: Offer,
    stopped: oneshot::Receiver<()>,
) -> Result<JoinHandle<()>, ServiceError> {
    let router = offer
        .page
        .map(|(page, _)| super::web::router(page, guard))
        .unwrap_or_default();
    let router = router
        .layer(axum::middleware::from_fn(crate::listen::note_request))
        .into_make_service_with_connect_info::<crate::listen::Proof>();
    Ok(tokio::spawn(async move {
        let ended = axum::serve(Listener::new(listener), router)
            .with_graceful_shutdown(async {
                let _ = stopped.await;
            })
            .await;
        if let Err(error) = ended {
            tracing::error!(%error, "the page has ended");
        }
    }))
}

#[cfg(feature = "grpc")]
use super::serve::serve;
