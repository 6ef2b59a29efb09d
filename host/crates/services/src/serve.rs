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
use tonic::transport::{Identity, ServerTlsConfig};

use crate::grpc::proto::calibration_store_server::CalibrationStoreServer;
use crate::grpc::proto::laser_tracker_server::LaserTrackerServer;
use crate::grpc::proto::live_view_server::LiveViewServer;
use crate::grpc::proto::robot_controller_server::RobotControllerServer;
use crate::grpc::{DESCRIPTORS, LiveService, RobotService, StoreService, TrackerService};
use crate::listen::{self, Listener};
use crate::offer::Offer;
use crate::{Guard, ServiceError, web};
use spherecal_budget::services::{HEADER_BYTES, LIVE_BYTES, MESSAGE_BYTES, SILENCE, STREAMS, TURN_BYTES, WINDOW_BYTES};

/// Serves what is offered until it is stopped.
pub(crate) async fn serve(
    listener: TcpListener,
    guard: Guard,
    offer: Offer,
    stopped: oneshot::Receiver<()>,
) -> Result<JoinHandle<()>, ServiceError> {
    let incoming = Listener::new(listener).into_stream();
    let mut builder = tonic::transport::Server::builder()
        .max_concurrent_streams(STREAMS)
        .concurrency_limit_per_connection(STREAMS as usize)
        .initial_stream_window_size(WINDOW_BYTES)
        .initial_connection_window_size(WINDOW_BYTES)
        .http2_max_header_list_size(HEADER_BYTES)
        .http2_max_pending_accept_reset_streams(Some(STREAMS as usize))
        .http2_keepalive_interval(Some(SILENCE))
        .http2_keepalive_timeout(Some(SILENCE));
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

/// All paths: those of the services, guarded by the token, and those of the page, guarded by its
/// own gate.
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
        services.add_service(service.max_decoding_message_size(TURN_BYTES));
    }
    if let Some((make, sigma_m)) = offer.tracker {
        health_reporter
            .set_serving::<LaserTrackerServer<TrackerService>>()
            .await;
        services.add_service(LaserTrackerServer::new(TrackerService::new(make, sigma_m)));
    }
    if let Some(store) = offer.store {
        let service = CalibrationStoreServer::new(StoreService::new(store))
            .max_decoding_message_size(MESSAGE_BYTES)
            .max_encoding_message_size(MESSAGE_BYTES);
        health_reporter
            .set_serving::<CalibrationStoreServer<StoreService>>()
            .await;
        services.add_service(service);
    }
    if let Some((page, true)) = &offer.page {
        let service = LiveViewServer::new(LiveService::new(Arc::clone(&page.hub)));
        health_reporter.set_serving::<LiveViewServer<LiveService>>().await;
        services.add_service(service.max_decoding_message_size(LIVE_BYTES));
    }
    // Reflection is guarded too: a client without access does not learn what the services are.
    let services = services
        .routes()
        .into_axum_router()
        .layer(InterceptorLayer::new(guard.clone()))
        .layer(middleware::from_fn(no_browser));
    let router = match offer.page {
        Some((page, _)) => web::router(page, guard).fallback_service(services),
        None => services,
    };
    Ok(router.layer(middleware::from_fn(listen::note_request)).into())
}

/// Refuses requests from web pages of other sites. The services use HTTP/2; a browser that a
/// foreign page sends here uses HTTP/1.1 or has no token.
async fn no_browser(request: Request, next: Next) -> Response {
    if request.version() == Version::HTTP_2 {
        next.run(request).await
    } else {
        StatusCode::NOT_FOUND.into_response()
    }
}
