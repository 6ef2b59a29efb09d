//! One server with what it offers: robot, tracker, store, health and reflection,
//! and the web page on the same port.

use std::net::SocketAddr;
use std::sync::{Arc, Mutex};

use axum::extract::Request;
use axum::http::{StatusCode, Version};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse as _, Response};
use tokio::runtime::Runtime;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;
use tonic::service::{InterceptorLayer, Routes, RoutesBuilder};
use tonic::transport::server::TcpIncoming;

use super::guard::listen_address;
use super::live::{LiveService, MAX_LIVE};
use super::proto::calibration_store_server::CalibrationStoreServer;
use super::proto::laser_tracker_server::LaserTrackerServer;
use super::proto::live_view_server::LiveViewServer;
use super::proto::robot_controller_server::RobotControllerServer;
use super::robot::{DeviceFactory, RobotFacts, RobotService};
use super::store_server::StoreService;
use super::tracker::{TrackerFactory, TrackerService};
use super::{DESCRIPTORS, Guard, GuardFiles, MAX_MESSAGE, RpcError};
use crate::live::{Hub, Message, WAITING};
use crate::store::Store;
use crate::web::{self, Page};

/// How long open connections may take to end.
const LAST: std::time::Duration = std::time::Duration::from_secs(1);

/// What a server offers; what is left out is answered UNIMPLEMENTED.
#[derive(Default)]
pub struct Offer {
    /// A robot, and what makes it at the first client.
    pub robot: Option<(RobotFacts, DeviceFactory)>,
    /// What makes a laser tracker for each client, and the standard deviation
    /// of its coordinates, in m.
    pub tracker: Option<(TrackerFactory, f64)>,
    /// The database.
    pub store: Option<Arc<Mutex<Store>>>,
    /// The web page, and whether runs of other programs are shown on it.
    pub page: Option<(Page, bool)>,
}

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
    /// Outlive the runtime: a store may not be dropped inside of one.
    _stores: [Option<Arc<Mutex<Store>>>; 2],
}

impl Server {
    /// Listens at `address` (`HOST:PORT`, or a port alone for this machine) and
    /// serves in threads of its own.
    ///
    /// # Errors
    /// An address that cannot be had, or one beyond loopback without protection.
    pub fn start(address: &str, files: &GuardFiles, offer: Offer) -> Result<Self, RpcError> {
        let wanted = listen_address(address)?;
        let guard = Guard::new(wanted, files)?;
        let encrypted = guard.is_encrypted();
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build()?;
        let listen = |source| RpcError::Listen {
            address: wanted.to_string(),
            source,
        };
        let page = offer.page.as_ref().map(|(page, _)| page.clone());
        let stores = [offer.store.clone(), page.as_ref().and_then(|page| page.store.clone())];
        let (stop, stopped) = oneshot::channel::<()>();
        let (address, ended) = runtime.block_on(async move {
            let listener = tokio::net::TcpListener::bind(wanted).await.map_err(listen)?;
            let address = listener.local_addr().map_err(listen)?;
            let incoming = TcpIncoming::from(listener).with_nodelay(Some(true));
            let mut builder = tonic::transport::Server::builder();
            if let Some(tls) = guard.tls.clone() {
                builder = builder.tls_config(tls).map_err(|e| RpcError::File {
                    path: "--tls-cert, --tls-key".to_owned(),
                    what: RpcError::transport("", &e).to_string(),
                    remedy: "give a certificate chain and its key, in PEM",
                })?;
            }
            // Browsers speak HTTP/1.1 where there is no TLS.
            let router = builder
                .accept_http1(offer.page.is_some())
                .add_routes(routes(offer, guard).await?);
            let ended = tokio::spawn(async move {
                let ended = router
                    .serve_with_incoming_shutdown(incoming, async {
                        let _ = stopped.await;
                    })
                    .await;
                if let Err(error) = ended {
                    tracing::error!(%error, "the services have ended");
                }
            });
            Ok::<_, RpcError>((address, ended))
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

    /// Shows a run of this program on the page; its messages go into what is
    /// returned. `None` where there is no page.
    pub fn show(&mut self) -> Option<mpsc::Sender<Message>> {
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
            // What was said to the page reaches it first.
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
                // Browsers hear the last words; who does not listen is not waited for.
                let _ = runtime.block_on(async { tokio::time::timeout(LAST, ended).await });
            }
            runtime.shutdown_timeout(LAST);
        }
    }
}

/// All paths: the services', guarded by the token, and the page's, by its own gate.
async fn routes(offer: Offer, guard: Guard) -> Result<Routes, RpcError> {
    let (health_reporter, health) = tonic_health::server::health_reporter();
    let reflection = tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(DESCRIPTORS)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        .build_v1()
        .map_err(|e| RpcError::transport("reflection", &e))?;
    let mut services = RoutesBuilder::default();
    services.add_service(health).add_service(reflection);
    if let Some((facts, make)) = offer.robot {
        let service = RobotControllerServer::new(RobotService::new(facts, make));
        health_reporter
            .set_serving::<RobotControllerServer<RobotService>>()
            .await;
        services.add_service(service.max_decoding_message_size(MAX_MESSAGE));
    }
    if let Some((make, sigma_m)) = offer.tracker {
        health_reporter
            .set_serving::<LaserTrackerServer<TrackerService>>()
            .await;
        services.add_service(LaserTrackerServer::new(TrackerService::new(make, sigma_m)));
    }
    if let Some(store) = offer.store {
        let service = CalibrationStoreServer::new(StoreService::new(store))
            .max_decoding_message_size(MAX_MESSAGE)
            .max_encoding_message_size(MAX_MESSAGE);
        health_reporter
            .set_serving::<CalibrationStoreServer<StoreService>>()
            .await;
        services.add_service(service);
    }
    if let Some((page, true)) = &offer.page {
        let service = LiveViewServer::new(LiveService::new(Arc::clone(&page.hub)));
        health_reporter.set_serving::<LiveViewServer<LiveService>>().await;
        services.add_service(service.max_decoding_message_size(MAX_LIVE));
    }
    // Whoever may not use the services need not know what they are.
    let services = services
        .routes()
        .into_axum_router()
        .layer(InterceptorLayer::new(guard.clone()))
        .layer(middleware::from_fn(no_browser));
    Ok(match offer.page {
        Some((page, _)) => web::router(page, guard).fallback_service(services).into(),
        None => services.into(),
    })
}

/// Services are spoken to in HTTP/2, and by no page of any site: a browser that
/// a strange page sends here speaks HTTP/1.1, or has no token.
async fn no_browser(request: Request, next: Next) -> Response {
    if request.version() == Version::HTTP_2 {
        next.run(request).await
    } else {
        StatusCode::NOT_FOUND.into_response()
    }
}
