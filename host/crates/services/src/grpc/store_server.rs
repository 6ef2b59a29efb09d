//! The service `CalibrationStore`: gives other machines access to this machine's database.

use std::sync::Arc;

use spherecal_shared::protocol::host::Event;
use tonic::{Request, Response, Status};

use super::convert::{self, Malformed};
use super::proto::calibration_store_server::CalibrationStore;
use super::proto::{
    BeginSessionRequest, Done, EventBatch, EventPlace, Handshake, LaserShots, ListRunsRequest, NewRun, Rejection,
    ResultName, Run, RunData, RunId, RunList, RunState, SessionEnd, SessionId, StoredResult,
};
use crate::SharedStore;
use spherecal_store::{Placed, RunInfo, StoreError};

/// The service. It uses one connection to the database and handles one request at a time, so the
/// work of several clients is serialised.
#[derive(Clone)]
pub(crate) struct StoreService {
    store: SharedStore,
}

impl StoreService {
    pub(crate) fn new(store: SharedStore) -> Self {
        Self { store }
    }

    /// Works with the store on a thread that may wait.
    async fn with<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut dyn spherecal_store::CalibrationStore) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<Response<T>, Status> {
        let store = Arc::clone(&self.store);
        let done = tokio::task::spawn_blocking(move || {
            // A panic in another request leaves the database at its last commit.
            let mut store = store.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            work(store.as_mut())
        });
        match done.await {
            Ok(Ok(value)) => Ok(Response::new(value)),
            Ok(Err(error)) if error.is_input() => Err(Status::failed_precondition(error.to_string())),
            Ok(Err(error)) => Err(Status::unavailable(error.to_string())),
            Err(error) => Err(Status::internal(error.to_string())),
        }
    }
}

fn malformed(what: Malformed) -> Status {
    Status::invalid_argument(what)
}

/// A run without its data, for the wire.
fn run(info: &RunInfo) -> Result<Run, Malformed> {
    Ok(Run {
        run: info.run,
        state: info.state.clone(),
        about: Some(convert::new_run_out(&info.about)?),
    })
}

/// Everything that was measured in a run.
fn data(store: &mut dyn spherecal_store::CalibrationStore, run: i64) -> Result<RunData, StoreError> {
    let stored = store.read_run(run)?;
    let events = [
        stored.phases.into_iter().map(Event::Phase).collect::<Vec<_>>(),
        stored.contacts.into_iter().map(Event::Contact).collect(),
        stored.couplings.into_iter().map(Event::Coupled).collect(),
        stored.faults.into_iter().map(Event::Fault).collect(),
    ];
    Ok(RunData {
        sessions: stored
            .sessions
            .iter()
            .zip(1..)
            .map(|(end, session)| convert::session_out(run, session, end))
            .collect(),
        spheres: convert::spheres_out(&stored.spheres),
        recordings: stored.recordings.iter().map(convert::recording_out).collect(),
        rejected: stored
            .rejected
            .iter()
            .map(|&(sphere, pose)| Rejection {
                run,
                sphere,
                pose,
                reason: String::new(),
            })
            .collect(),
        events: events
            .iter()
            .flatten()
            .filter_map(|body| convert::event(0, 0, body))
            .collect(),
        laser: convert::laser_out(&stored.laser),
        handshakes: stored
            .handshakes
            .iter()
            .map(|(&nonce, &(session, handshake))| Handshake {
                run,
                session,
                handshake,
                nonce,
            })
            .collect(),
    })
}

#[tonic::async_trait]
impl CalibrationStore for StoreService {
    async fn create_run(&self, request: Request<NewRun>) -> Result<Response<RunId>, Status> {
        let new = convert::new_run(request.into_inner()).map_err(malformed)?;
        self.with(move |store| {
            Ok(RunId {
                run: store.create_run(&new)?,
            })
        })
        .await
    }

    async fn begin_session(&self, request: Request<BeginSessionRequest>) -> Result<Response<SessionId>, Status> {
        let m = request.into_inner();
        self.with(move |store| {
            Ok(SessionId {
                session: store.begin_session(m.run, &m.started_utc)?,
            })
        })
        .await
    }

    async fn put_handshake(&self, request: Request<Handshake>) -> Result<Response<Done>, Status> {
        let m = request.into_inner();
        self.with(move |store| {
            store
                .put_handshake(m.run, m.session, m.handshake, m.nonce)
                .map(|()| Done {})
        })
        .await
    }

    async fn append(&self, request: Request<EventBatch>) -> Result<Response<Done>, Status> {
        let m = request.into_inner();
        let events = m.events.into_iter().map(|placed| {
            let what = placed.what.ok_or_else(|| "a place without an event".to_owned())?;
            Ok((placed.session, placed.event, convert::arrival(what)?.body))
        });
        let events: Vec<(i64, i64, Event)> = events.collect::<Result<_, Malformed>>().map_err(malformed)?;
        self.with(move |store| {
            let placed: Vec<Placed<'_>> = events
                .iter()
                .map(|(session, event, body)| Placed {
                    session: *session,
                    event: *event,
                    body,
                })
                .collect();
            let written = if m.rewrite {
                store.rewrite(m.run, &placed)
            } else {
                store.append(m.run, &placed)
            };
            written.map(|()| Done {})
        })
        .await
    }

    async fn forget_after(&self, request: Request<EventPlace>) -> Result<Response<Done>, Status> {
        let m = request.into_inner();
        self.with(move |store| store.forget_after(m.run, m.session, m.event).map(|()| Done {}))
            .await
    }

    async fn reject_pose(&self, request: Request<Rejection>) -> Result<Response<Done>, Status> {
        let m = request.into_inner();
        self.with(move |store| store.reject_pose(m.run, m.sphere, m.pose, &m.reason).map(|()| Done {}))
            .await
    }

    async fn end_session(&self, request: Request<SessionEnd>) -> Result<Response<Done>, Status> {
        let m = request.into_inner();
        let (run, session) = (m.run, m.session);
        let end = convert::session(m);
        self.with(move |store| store.end_session(run, session, &end).map(|()| Done {}))
            .await
    }

    async fn set_state(&self, request: Request<RunState>) -> Result<Response<Done>, Status> {
        let m = request.into_inner();
        convert::state_of_run(&m.state).map_err(malformed)?;
        self.with(move |store| store.set_state(m.run, &m.state).map(|()| Done {}))
            .await
    }

    async fn put_laser(&self, request: Request<LaserShots>) -> Result<Response<Done>, Status> {
        let m = request.into_inner();
        let shots = convert::laser(m.shots).map_err(malformed)?;
        self.with(move |store| store.put_laser(m.run, &shots).map(|()| Done {}))
            .await
    }

    async fn put_result(&self, request: Request<StoredResult>) -> Result<Response<Done>, Status> {
        let m = request.into_inner();
        self.with(move |store| store.put_result(m.run, &m.name, &m.json).map(|()| Done {}))
            .await
    }

    async fn get_result(&self, request: Request<ResultName>) -> Result<Response<StoredResult>, Status> {
        let m = request.into_inner();
        self.with(move |store| {
            Ok(StoredResult {
                json: store.result(m.run, &m.name)?.unwrap_or_default(),
                run: m.run,
                name: m.name,
            })
        })
        .await
    }

    async fn list_runs(&self, request: Request<ListRunsRequest>) -> Result<Response<RunList>, Status> {
        let m = request.into_inner();
        let runs = self
            .with(move |store| {
                Ok(if m.last {
                    store.last_run()?.into_iter().collect()
                } else {
                    store.runs_of(&m.arm)?
                })
            })
            .await?
            .into_inner();
        let runs = runs
            .iter()
            .map(run)
            .collect::<Result<_, _>>()
            .map_err(Status::internal)?;
        Ok(Response::new(RunList { runs }))
    }

    async fn read_run(&self, request: Request<RunId>) -> Result<Response<RunData>, Status> {
        let run = request.into_inner().run;
        self.with(move |store| data(store, run)).await
    }
}
