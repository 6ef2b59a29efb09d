//! A store behind the service `CalibrationStore`: one more backend of
//! [`Store`](crate::store::Store), which turns its calls into requests.

use std::collections::BTreeMap;

use spherecal_shared::protocol::host::{Contact, Coupled, Event, FaultReport, PhaseChange, Recording};
use tokio::runtime::Runtime;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;
use tonic::{Response, Status};

use super::convert;
use super::guard::Credentials;
use super::proto::calibration_store_client::CalibrationStoreClient;
use super::proto::{
    BeginSessionRequest, EventBatch, EventPlace, Greeting, LaserShots, ListRunsRequest, PlacedEvent, Rejection,
    ResultName, Run, RunData, RunId, RunState, StoredResult,
};
use super::{MAX_MESSAGE, Peer, RpcError};
use crate::identify::Sphere;
use crate::store::{LaserShot, NewRun, Placed, RunInfo, SessionEnd};

type Client = CalibrationStoreClient<InterceptedService<Channel, Credentials>>;

/// The other side's store.
pub(crate) struct RemoteStore {
    runtime: Runtime,
    peer: String,
    client: Client,
}

/// What was measured in a run, read in one piece.
pub(crate) struct RemoteRun {
    pub(crate) sessions: Vec<SessionEnd>,
    pub(crate) spheres: Vec<Sphere>,
    pub(crate) recordings: Vec<Recording>,
    /// Sphere and pose of what was given up.
    pub(crate) rejected: Vec<(u32, u32)>,
    pub(crate) contacts: Vec<Contact>,
    pub(crate) couplings: Vec<Coupled>,
    pub(crate) phases: Vec<PhaseChange>,
    pub(crate) faults: Vec<FaultReport>,
    pub(crate) laser: Vec<LaserShot>,
    /// Session and greeting by nonce.
    pub(crate) greetings: BTreeMap<u32, (i64, i64)>,
}

impl RemoteStore {
    /// Connects.
    pub(crate) fn connect(peer: &Peer) -> Result<Self, RpcError> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let (channel, credentials) = runtime.block_on(peer.connect())?;
        let client = CalibrationStoreClient::with_interceptor(channel, credentials)
            .max_decoding_message_size(MAX_MESSAGE)
            .max_encoding_message_size(MAX_MESSAGE);
        Ok(Self {
            runtime,
            peer: peer.to_string(),
            client,
        })
    }

    fn ask<T>(&mut self, request: impl AsyncFnOnce(&mut Client) -> Result<Response<T>, Status>) -> Result<T, RpcError> {
        let answer = self.runtime.block_on(request(&mut self.client));
        answer
            .map(Response::into_inner)
            .map_err(|status| RpcError::status(&self.peer, &status))
    }

    fn nonsense(&self, what: impl Into<String>) -> RpcError {
        RpcError::Nonsense {
            peer: self.peer.clone(),
            what: what.into(),
        }
    }

    pub(crate) fn create_run(&mut self, new: &NewRun) -> Result<i64, RpcError> {
        let message = convert::new_run_out(new).map_err(|e| self.nonsense(e))?;
        Ok(self.ask(async |c| c.create_run(message).await)?.run)
    }

    pub(crate) fn begin_session(&mut self, run: i64, started_utc: &str) -> Result<i64, RpcError> {
        let message = BeginSessionRequest {
            run,
            started_utc: started_utc.to_owned(),
        };
        Ok(self.ask(async |c| c.begin_session(message).await)?.session)
    }

    pub(crate) fn end_session(&mut self, run: i64, session: i64, end: &SessionEnd) -> Result<(), RpcError> {
        let message = convert::session_out(run, session, end);
        self.ask(async |c| c.end_session(message).await).map(|_| ())
    }

    pub(crate) fn set_state(&mut self, run: i64, state: &str) -> Result<(), RpcError> {
        let state = state.to_owned();
        self.ask(async |c| c.set_state(RunState { run, state }).await)
            .map(|_| ())
    }

    pub(crate) fn append(&mut self, run: i64, events: &[Placed<'_>], rewrite: bool) -> Result<(), RpcError> {
        let events: Vec<_> = events
            .iter()
            .filter_map(|placed| {
                Some(PlacedEvent {
                    session: placed.session,
                    event: placed.event,
                    what: Some(convert::event(placed.arrival)?),
                })
            })
            .collect();
        if events.is_empty() {
            return Ok(());
        }
        self.ask(async |c| c.append(EventBatch { run, events, rewrite }).await)
            .map(|_| ())
    }

    pub(crate) fn forget_after(&mut self, run: i64, session: i64, event: i64) -> Result<(), RpcError> {
        self.ask(async |c| c.forget_after(EventPlace { run, session, event }).await)
            .map(|_| ())
    }

    pub(crate) fn put_greeting(&mut self, run: i64, session: i64, greeting: i64, nonce: u32) -> Result<(), RpcError> {
        let message = Greeting {
            run,
            session,
            greeting,
            nonce,
        };
        self.ask(async |c| c.put_greeting(message).await).map(|_| ())
    }

    pub(crate) fn reject_pose(&mut self, run: i64, sphere: u32, pose: u32, reason: &str) -> Result<(), RpcError> {
        let message = Rejection {
            run,
            sphere,
            pose,
            reason: reason.to_owned(),
        };
        self.ask(async |c| c.reject_pose(message).await).map(|_| ())
    }

    pub(crate) fn put_laser(&mut self, run: i64, shots: &[LaserShot]) -> Result<(), RpcError> {
        let shots = convert::laser_out(shots);
        self.ask(async |c| c.put_laser(LaserShots { run, shots }).await)
            .map(|_| ())
    }

    pub(crate) fn put_result(&mut self, run: i64, name: &str, json: &str) -> Result<(), RpcError> {
        let message = StoredResult {
            run,
            name: name.to_owned(),
            json: json.to_owned(),
        };
        self.ask(async |c| c.put_result(message).await).map(|_| ())
    }

    pub(crate) fn result(&mut self, run: i64, name: &str) -> Result<Option<String>, RpcError> {
        let name = name.to_owned();
        let answer = self.ask(async |c| c.get_result(ResultName { run, name }).await)?;
        Ok(Some(answer.json).filter(|json| !json.is_empty()))
    }

    /// The newest run.
    pub(crate) fn last_run(&mut self) -> Result<Option<RunInfo>, RpcError> {
        let request = ListRunsRequest {
            last: true,
            ..ListRunsRequest::default()
        };
        Ok(self.list(request)?.pop())
    }

    /// Runs of one arm, or of all if `arm` is empty, oldest first.
    pub(crate) fn runs_of(&mut self, arm: &str) -> Result<Vec<RunInfo>, RpcError> {
        self.list(ListRunsRequest {
            arm: arm.to_owned(),
            last: false,
        })
    }

    fn list(&mut self, request: ListRunsRequest) -> Result<Vec<RunInfo>, RpcError> {
        let answer = self.ask(async |c| c.list_runs(request).await)?;
        answer.runs.into_iter().map(|run| self.run_info(run)).collect()
    }

    fn run_info(&self, run: Run) -> Result<RunInfo, RpcError> {
        let about = run.about.ok_or_else(|| self.nonsense("a run without a description"))?;
        let json = |field: &str, e: serde_json::Error| self.nonsense(format!("{field}: {e}"));
        Ok(RunInfo {
            run: run.run,
            created_utc: about.created_utc,
            seed: about.seed,
            link: about.link,
            robot: serde_json::from_str(&about.robot_json).map_err(|e| json("robot_json", e))?,
            tool: serde_json::from_str(&about.tool_json).map_err(|e| json("tool_json", e))?,
            config_toml: about.config_toml,
            plan_json: about.plan_json,
            program: about.program,
            state: run.state,
            arm: about.arm,
        })
    }

    /// Everything that was measured in a run.
    pub(crate) fn read(&mut self, run: i64) -> Result<RemoteRun, RpcError> {
        let data: RunData = self.ask(async |c| c.read_run(RunId { run }).await)?;
        let mut read = RemoteRun {
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
            greetings: data
                .greetings
                .iter()
                .map(|g| (g.nonce, (g.session, g.greeting)))
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
