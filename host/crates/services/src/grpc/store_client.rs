//! A store behind the service `CalibrationStore`: turns the calls of the trait of that name into
//! requests.

use std::path::{Path, PathBuf};

use spherecal_shared::protocol::host::Event;
use tokio::runtime::Runtime;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;
use tonic::{Response, Status};

use super::convert;
use super::peer::{Credentials, connect, own_runtime, within};
use super::proto::calibration_store_client::CalibrationStoreClient;
use super::proto::{
    BeginSessionRequest, EventBatch, EventPlace, Handshake, LaserShots, ListRunsRequest, PlacedEvent, Rejection,
    ResultName, Run, RunData, RunId, RunState, StoredResult,
};
use crate::ServiceError;
use crate::budget::ANSWER;
use spherecal_budget::services::MESSAGE_BYTES;
use spherecal_model::LaserShot;
use spherecal_store::{CalibrationStore, NewRun, Peer, Placed, RunInfo, SessionEnd, StoreError, StoredRun};

type StoreClient = CalibrationStoreClient<InterceptedService<Channel, Credentials>>;

/// The other side's store.
pub struct RemoteStore {
    runtime: Runtime,
    peer: String,
    /// The peer, as a path for messages.
    path: PathBuf,
    client: StoreClient,
    /// See [`CalibrationStore::chosen_run`].
    chosen: Option<i64>,
}

impl RemoteStore {
    /// Connects.
    ///
    /// # Errors
    /// When nothing answers there.
    pub fn connect(peer: &Peer) -> Result<Self, ServiceError> {
        let runtime = own_runtime()?;
        let (channel, credentials) = runtime.block_on(connect(peer))?;
        let client = CalibrationStoreClient::with_interceptor(channel, credentials)
            .max_decoding_message_size(MESSAGE_BYTES)
            .max_encoding_message_size(MESSAGE_BYTES);
        Ok(Self {
            runtime,
            peer: peer.to_string(),
            path: PathBuf::from(peer.to_string()),
            client,
            chosen: None,
        })
    }

    fn ask<T>(
        &mut self,
        request: impl AsyncFnOnce(&mut StoreClient) -> Result<Response<T>, Status>,
    ) -> Result<T, ServiceError> {
        let Self {
            runtime, peer, client, ..
        } = self;
        let answer = async {
            let answer = request(client).await;
            answer
                .map(Response::into_inner)
                .map_err(|status| ServiceError::status(peer, &status))
        };
        runtime.block_on(within(ANSWER, peer, "did not answer", answer))
    }

    fn nonsense(&self, what: impl Into<String>) -> ServiceError {
        ServiceError::Nonsense {
            peer: self.peer.clone(),
            what: what.into(),
        }
    }

    fn write_events(&mut self, run: i64, events: &[Placed<'_>], rewrite: bool) -> Result<(), StoreError> {
        let events: Vec<_> = events
            .iter()
            .filter_map(|placed| {
                Some(PlacedEvent {
                    session: placed.session,
                    event: placed.event,
                    // The low half of the number is the controller's own number.
                    what: Some(convert::event(placed.event as u32, 0, placed.body)?),
                })
            })
            .collect();
        if events.is_empty() {
            return Ok(());
        }
        self.ask(async |c| c.append(EventBatch { run, events, rewrite }).await)?;
        Ok(())
    }

    fn list(&mut self, request: ListRunsRequest) -> Result<Vec<RunInfo>, StoreError> {
        let answer = self.ask(async |c| c.list_runs(request).await)?;
        let runs = answer.runs.into_iter().map(|run| self.run_info(run));
        Ok(runs.collect::<Result<_, _>>()?)
    }

    fn run_info(&self, run: Run) -> Result<RunInfo, ServiceError> {
        let about = run.about.ok_or_else(|| self.nonsense("a run without a description"))?;
        let about = convert::new_run(about).map_err(|e| self.nonsense(e))?;
        Ok(RunInfo {
            run: run.run,
            state: run.state,
            about,
        })
    }

    /// Everything that was measured in a run.
    fn read(&mut self, run: i64) -> Result<StoredRun, ServiceError> {
        let data: RunData = self.ask(async |c| c.read_run(RunId { run }).await)?;
        let mut read = StoredRun {
            sessions: data.sessions.into_iter().map(convert::session).collect(),
            spheres: convert::spheres(&data.spheres).map_err(|e| self.nonsense(e))?,
            recordings: data
                .recordings
                .into_iter()
                .map(convert::recording)
                .collect::<Result<_, _>>()
                .map_err(|e| self.nonsense(e))?,
            rejected: data.rejected.iter().map(|r| (r.sphere, r.pose)).collect(),
            contacts: Vec::new(),
            couplings: Vec::new(),
            phases: Vec::new(),
            faults: Vec::new(),
            laser: convert::laser(data.laser).map_err(|e| self.nonsense(e))?,
            handshakes: data
                .handshakes
                .iter()
                .map(|g| (g.nonce, (g.session, g.handshake)))
                .collect(),
        };
        for event in data.events {
            match convert::arrival(event).map_err(|e| self.nonsense(e))?.body {
                Event::Contact(contact) => read.contacts.push(contact),
                Event::Coupled(coupled) => read.couplings.push(coupled),
                Event::Phase(phase) => read.phases.push(phase),
                Event::Fault(fault) => read.faults.push(fault),
                _ => {}
            }
        }
        Ok(read)
    }
}

impl From<ServiceError> for StoreError {
    fn from(error: ServiceError) -> Self {
        Self::Remote {
            input: error.is_input(),
            source: Box::new(error),
        }
    }
}

impl CalibrationStore for RemoteStore {
    fn path(&self) -> &Path {
        &self.path
    }

    fn is_file(&self) -> bool {
        false
    }

    fn chosen_run(&self) -> Option<i64> {
        self.chosen
    }

    fn choose_run(&mut self, run: i64) {
        self.chosen = Some(run);
    }

    fn create_run(&mut self, new: &NewRun) -> Result<i64, StoreError> {
        let message = convert::new_run_out(new).map_err(|e| self.nonsense(e))?;
        let run = self.ask(async |c| c.create_run(message).await)?.run;
        self.chosen = Some(run);
        Ok(run)
    }

    fn newest_run(&mut self) -> Result<Option<RunInfo>, StoreError> {
        let request = ListRunsRequest {
            last: true,
            ..ListRunsRequest::default()
        };
        Ok(self.list(request)?.pop())
    }

    fn runs_of(&mut self, arm: &str) -> Result<Vec<RunInfo>, StoreError> {
        self.list(ListRunsRequest {
            arm: arm.to_owned(),
            last: false,
        })
    }

    fn read_run(&mut self, run: i64) -> Result<StoredRun, StoreError> {
        Ok(self.read(run)?)
    }

    fn begin_session(&mut self, run: i64, started_utc: &str) -> Result<i64, StoreError> {
        self.chosen = Some(run);
        let message = BeginSessionRequest {
            run,
            started_utc: started_utc.to_owned(),
        };
        Ok(self.ask(async |c| c.begin_session(message).await)?.session)
    }

    fn end_session(&mut self, run: i64, session: i64, end: &SessionEnd) -> Result<(), StoreError> {
        let message = convert::session_out(run, session, end);
        self.ask(async |c| c.end_session(message).await)?;
        Ok(())
    }

    fn set_state(&mut self, run: i64, state: &str) -> Result<(), StoreError> {
        let state = state.to_owned();
        self.ask(async |c| c.set_state(RunState { run, state }).await)?;
        Ok(())
    }

    fn put_handshake(&mut self, run: i64, session: i64, handshake: i64, nonce: u32) -> Result<(), StoreError> {
        let message = Handshake {
            run,
            session,
            handshake,
            nonce,
        };
        self.ask(async |c| c.put_handshake(message).await)?;
        Ok(())
    }

    fn append(&mut self, run: i64, events: &[Placed<'_>]) -> Result<(), StoreError> {
        self.write_events(run, events, false)
    }

    fn rewrite(&mut self, run: i64, events: &[Placed<'_>]) -> Result<(), StoreError> {
        self.write_events(run, events, true)
    }

    fn forget_after(&mut self, run: i64, session: i64, event: i64) -> Result<(), StoreError> {
        self.ask(async |c| c.forget_after(EventPlace { run, session, event }).await)?;
        Ok(())
    }

    fn reject_pose(&mut self, run: i64, sphere: u32, pose: u32, reason: &str) -> Result<(), StoreError> {
        let message = Rejection {
            run,
            sphere,
            pose,
            reason: reason.to_owned(),
        };
        self.ask(async |c| c.reject_pose(message).await)?;
        Ok(())
    }

    fn put_laser(&mut self, run: i64, shots: &[LaserShot]) -> Result<(), StoreError> {
        let shots = convert::laser_out(shots);
        self.ask(async |c| c.put_laser(LaserShots { run, shots }).await)?;
        Ok(())
    }

    fn put_result(&mut self, run: i64, name: &str, json: &str) -> Result<(), StoreError> {
        let message = StoredResult {
            run,
            name: name.to_owned(),
            json: json.to_owned(),
        };
        self.ask(async |c| c.put_result(message).await)?;
        Ok(())
    }

    fn result(&mut self, run: i64, name: &str) -> Result<Option<String>, StoreError> {
        let name = name.to_owned();
        let answer = self.ask(async |c| c.get_result(ResultName { run, name }).await)?;
        Ok(Some(answer.json).filter(|json| !json.is_empty()))
    }
}
