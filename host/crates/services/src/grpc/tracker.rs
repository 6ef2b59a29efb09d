//! The service `LaserTracker`, and its client.

use std::sync::Arc;

use tokio::runtime::Runtime;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};

use super::peer::{connect, own_runtime, within};
use super::proto::laser_tracker_client::LaserTrackerClient;
use super::proto::laser_tracker_server::LaserTracker;
use super::proto::{Shot, ShotRequest, Station, TrackerDescribeRequest, TrackerDescription};
use crate::ServiceError;
use crate::budget::{ANSWER, SHOT};
use spherecal_campaign::{Tracker, TrackerError};
use spherecal_model::TrackerSession;
use spherecal_store::Peer;

/// Makes a tracker for one client's measurements.
pub type TrackerFactory = Box<dyn Fn() -> Result<Box<dyn Tracker + Send>, TrackerError> + Send + Sync>;

#[derive(Clone)]
pub(crate) struct TrackerService {
    make: Arc<TrackerFactory>,
    sigma_m: f64,
}

impl TrackerService {
    pub(crate) fn new(make: TrackerFactory, sigma_m: f64) -> Self {
        Self {
            make: Arc::new(make),
            sigma_m,
        }
    }
}

fn session(station: i32) -> Result<TrackerSession, Status> {
    match Station::try_from(station) {
        Ok(Station::BaseArcs) => Ok(TrackerSession::BaseArcs),
        Ok(Station::ToolArcs) => Ok(TrackerSession::ToolArcs),
        Ok(Station::Measurement) => Ok(TrackerSession::Measurement),
        Ok(Station::Unspecified) | Err(_) => Err(Status::invalid_argument(
            "station is not specified: say what the shot is for",
        )),
    }
}

#[tonic::async_trait]
impl LaserTracker for TrackerService {
    async fn describe(
        &self,
        _request: Request<TrackerDescribeRequest>,
    ) -> Result<Response<TrackerDescription>, Status> {
        Ok(Response::new(TrackerDescription {
            tracker: "simulated laser tracker".to_owned(),
            sigma_m: self.sigma_m,
        }))
    }

    type MeasureStream = ReceiverStream<Result<Shot, Status>>;

    async fn measure(&self, request: Request<Streaming<ShotRequest>>) -> Result<Response<Self::MeasureStream>, Status> {
        let mut tracker = (self.make)().map_err(|e| Status::unavailable(e.to_string()))?;
        let mut requests = request.into_inner();
        let (shots, stream) = mpsc::channel(1);
        tokio::spawn(async move {
            while let Ok(Some(request)) = requests.message().await {
                let shot = session(request.station).and_then(|session| {
                    let (q_rad, point_m) = tracker
                        .shot(session, &request.q_rad)
                        .map_err(|e| Status::invalid_argument(e.to_string()))?;
                    Ok(Shot {
                        q_rad,
                        point_m: point_m.to_vec(),
                    })
                });
                let failed = shot.is_err();
                if shots.send(shot).await.is_err() || failed {
                    return;
                }
            }
        });
        Ok(Response::new(ReceiverStream::new(stream)))
    }
}

/// A laser tracker behind gRPC.
pub struct RemoteTracker {
    runtime: Runtime,
    peer: String,
    requests: mpsc::Sender<ShotRequest>,
    shots: Streaming<Shot>,
}

impl RemoteTracker {
    /// Connects to a tracker.
    ///
    /// # Errors
    /// When nothing answers there, or there is no tracker.
    pub fn connect(peer: &Peer) -> Result<Self, ServiceError> {
        let runtime = own_runtime()?;
        let name = peer.to_string();
        let (requests, stream) = mpsc::channel(1);
        let shots = runtime.block_on(async {
            let (channel, credentials) = connect(peer).await?;
            let mut client = LaserTrackerClient::with_interceptor(channel, credentials);
            let answer = async {
                let answer = client.measure(ReceiverStream::new(stream)).await;
                answer
                    .map(Response::into_inner)
                    .map_err(|status| ServiceError::status(&name, &status))
            };
            within(ANSWER, &name, "did not answer", answer).await
        })?;
        Ok(Self {
            runtime,
            peer: name,
            requests,
            shots,
        })
    }
}

fn failed(error: ServiceError) -> TrackerError {
    TrackerError::Device {
        input: error.is_input(),
        source: Box::new(error),
    }
}

impl Tracker for RemoteTracker {
    fn shot(&mut self, session: TrackerSession, q: &[f64]) -> Result<(Vec<f64>, [f64; 3]), TrackerError> {
        let station = match session {
            TrackerSession::BaseArcs => Station::BaseArcs,
            TrackerSession::ToolArcs => Station::ToolArcs,
            TrackerSession::Measurement => Station::Measurement,
        };
        let request = ShotRequest {
            station: station.into(),
            q_rad: q.to_vec(),
        };
        let Self {
            runtime,
            peer,
            requests,
            shots,
        } = self;
        let answer = async {
            // The other side's reason is in what it sends last.
            let _ = requests.send(request).await;
            match shots.message().await {
                Ok(Some(shot)) => Ok(shot),
                Ok(None) => Err(ServiceError::Transport {
                    peer: peer.clone(),
                    what: "the connection was closed".to_owned(),
                }),
                Err(status) => Err(ServiceError::status(peer, &status)),
            }
        };
        let shot = runtime.block_on(within(SHOT, peer, "gave no shot", answer));
        let shot = shot.map_err(failed)?;
        let point = <[f64; 3]>::try_from(shot.point_m.as_slice()).ok();
        match point {
            Some(point) if shot.q_rad.len() == q.len() => Ok((shot.q_rad, point)),
            _ => Err(failed(ServiceError::Nonsense {
                peer: self.peer.clone(),
                what: format!(
                    "a shot with {} joints and {} coordinates",
                    shot.q_rad.len(),
                    shot.point_m.len()
                ),
            })),
        }
    }
}
