//! The services and the page on one port.

use std::sync::Arc;

use axum::extract::Request;
use axum::http::{StatusCode, Version};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse as _, Response};
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tonic::service::{InterceptorLayer, Routes, RoutesBuilder};
use tonic::transport::server::TcpIncoming;
use tonic::transport::{Identity, ServerTlsConfig};

use crate::grpc::proto::calibration_store_server::CalibrationStoreServer;
use crate::grpc::proto::laser_tracker_server::LaserTrackerServer;
use crate::grpc::proto::live_view_server::LiveViewServer;
use crate::grpc::proto::robot_controller_server::RobotControllerServer;
use crate::grpc::{DESCRIPTORS, LiveService, MAX_LIVE, MAX_MESSAGE, RobotService, StoreService, TrackerService};
use crate::offer::Offer;
use crate::{Guard, ServiceError, web};

/// Serves what is offered until it is stopped.
pub(crate) async fn serve(
    listener: TcpListener,
    guard: Guard,
    offer: Offer,
    stopped: oneshot::Receiver<()>,
) -> Result<JoinHandle<()>, ServiceError> {
    let incoming = TcpIncoming::from(listener).with_nodelay(Some(true));
    let mut builder = tonic::transport::Server::builder();
    if let Some((certificate, key)) = &guard.tls {
        let tls = ServerTlsConfig::new().identity(Identity::from_pem(certificate, key));
        builder = builder.tls_config(tls).map_err(|e| ServiceError::File {
            path: "--tls-cert, --tls-key".to_owned(),
            what: ServiceError::transport("", &e).to_string(),
            remedy: "give a certificate chain and its key, in PEM",
        })?;
    }
    // Browsers speak HTTP/1.1 where there is no TLS.
    let router = builder
        .accept_http1(offer.page.is_some())
        .add_routes(routes(offer, guard).await?);
    Ok(tokio::spawn(async move {
        let ended = router
            .serve_with_incoming_shutdown(incoming, async {
                let _ = stopped.await;
            })
            .await;
        if let Err(error) = ended {
            tracing::error!(%error, "the services have ended");
        }
    }))
}

/// All paths: the services', guarded by the token, and the page's, by its own gate.
async fn routes(offer: Offer, guard: Guard) -> Result<Routes, ServiceError> {
    let (health_reporter, health) = tonic_health::server::health_reporter();
    let reflection = tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(DESCRIPTORS)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        .build_v1()
        .map_err(|e| ServiceError::transport("reflection", &e))?;
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
