//! One server with what it offers: robot, tracker, store, health and reflection.

use std::net::SocketAddr;
use std::sync::{Arc, Mutex};

use tokio::runtime::Runtime;
use tokio::sync::oneshot;
use tonic::transport::server::TcpIncoming;

use super::guard::listen_address;
use super::proto::calibration_store_server::CalibrationStoreServer;
use super::proto::laser_tracker_server::LaserTrackerServer;
use super::proto::robot_controller_server::RobotControllerServer;
use super::robot::{DeviceFactory, RobotFacts, RobotService};
use super::store_server::StoreService;
use super::tracker::{TrackerFactory, TrackerService};
use super::{DESCRIPTORS, Guard, GuardFiles, MAX_MESSAGE, RpcError};
use crate::store::Store;

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
}

/// A server that runs until it is dropped.
pub struct Server {
    runtime: Option<Runtime>,
    address: SocketAddr,
    encrypted: bool,
    stop: Option<oneshot::Sender<()>>,
    /// Outlives the runtime: a store may not be dropped inside of one.
    _store: Option<Arc<Mutex<Store>>>,
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
        let store = offer.store.clone();
        let (stop, stopped) = oneshot::channel::<()>();
        let address = runtime.block_on(async move {
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
            let (health_reporter, health) = tonic_health::server::health_reporter();
            let reflection = tonic_reflection::server::Builder::configure()
                .register_encoded_file_descriptor_set(DESCRIPTORS)
                .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
                .build_v1()
                .map_err(|e| RpcError::transport("reflection", &e))?;
            // Whoever may not use the services need not know what they are.
            let layer = tonic::service::InterceptorLayer::new(guard);
            let mut router = builder.layer(layer).add_service(health).add_service(reflection);
            if let Some((facts, make)) = offer.robot {
                let service = RobotControllerServer::new(RobotService::new(facts, make));
                health_reporter
                    .set_serving::<RobotControllerServer<RobotService>>()
                    .await;
                router = router.add_service(service.max_decoding_message_size(MAX_MESSAGE));
            }
            if let Some((make, sigma_m)) = offer.tracker {
                health_reporter
                    .set_serving::<LaserTrackerServer<TrackerService>>()
                    .await;
                router = router.add_service(LaserTrackerServer::new(TrackerService::new(make, sigma_m)));
            }
            if let Some(store) = offer.store {
                let service = CalibrationStoreServer::new(StoreService::new(store))
                    .max_decoding_message_size(MAX_MESSAGE)
                    .max_encoding_message_size(MAX_MESSAGE);
                health_reporter
                    .set_serving::<CalibrationStoreServer<StoreService>>()
                    .await;
                router = router.add_service(service);
            }
            tokio::spawn(async move {
                let ended = router
                    .serve_with_incoming_shutdown(incoming, async {
                        let _ = stopped.await;
                    })
                    .await;
                if let Err(error) = ended {
                    tracing::error!(%error, "the services have ended");
                }
            });
            Ok::<_, RpcError>(address)
        })?;
        Ok(Self {
            runtime: Some(runtime),
            address,
            encrypted,
            stop: Some(stop),
            _store: store,
        })
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
        if let Some(stop) = self.stop.take() {
            // The server may have ended already.
            let _ = stop.send(());
        }
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(std::time::Duration::from_secs(2));
        }
    }
}
