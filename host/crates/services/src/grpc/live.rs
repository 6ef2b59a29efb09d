//! The service `LiveView` and its client: shows runs of other programs on this server's page.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Request, Response, Status, Streaming};

use super::peer::connect;
use super::proto::live_view_client::LiveViewClient;
use super::proto::live_view_server::LiveView;
use super::proto::{LiveMessage, Published};
use crate::ServiceError;
use crate::live::{Hub, ViewerMessage, WAITING};
use spherecal_store::Peer;

/// Time until a lost server is tried again.
const AGAIN: Duration = Duration::from_secs(2);
/// How long the last messages may take.
const LAST: Duration = Duration::from_secs(2);

#[derive(Clone)]
pub(crate) struct LiveService {
    hub: Arc<Hub>,
}

impl LiveService {
    pub(crate) fn new(hub: Arc<Hub>) -> Self {
        Self { hub }
    }
}

#[tonic::async_trait]
impl LiveView for LiveService {
    async fn publish(&self, request: Request<Streaming<LiveMessage>>) -> Result<Response<Published>, Status> {
        let mut messages = request.into_inner();
        let (mut run, mut count) = (None, 0);
        let ended = loop {
            match messages.message().await {
                Ok(Some(message)) => {
                    let understood =
                        serde_json::from_str(&message.json)
                            .map_err(|e| e.to_string())
                            .and_then(|message| {
                                let taken = self.hub.take(&mut run, message);
                                taken
                                    .then_some(())
                                    .ok_or_else(|| "the scene comes first, and once".to_owned())
                            });
                    if let Err(reason) = understood {
                        break Err(Status::invalid_argument(format!("message {}: {reason}", count + 1)));
                    }
                    count += 1;
                }
                Ok(None) => break Ok(Response::new(Published { messages: count })),
                Err(status) => break Err(status),
            }
        };
        self.hub.gone(run);
        ended
    }
}

/// A run that is shown on another server's page for as long as this exists.
pub struct Publisher {
    done: Receiver<()>,
}

impl Publisher {
    /// Shows a run, whose messages go into the returned channel. A server that does not answer is
    /// tried again and again, and delays nothing.
    ///
    /// # Errors
    /// When no thread can be started.
    pub fn start(peer: Peer) -> Result<(mpsc::Sender<ViewerMessage>, Self), ServiceError> {
        let (out, messages) = mpsc::channel(WAITING);
        let (finished, done) = channel();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        std::thread::Builder::new().name("publish".to_owned()).spawn(move || {
            runtime.block_on(publish(&peer, messages));
            // The caller may no longer be waiting.
            let _ = finished.send(());
        })?;
        Ok((out, Self { done }))
    }

    /// After its sender was dropped, waits a short time for the last messages to be sent.
    pub fn finish(self) {
        let _ = self.done.recv_timeout(LAST);
    }
}

async fn publish(peer: &Peer, mut messages: mpsc::Receiver<ViewerMessage>) {
    let mut scene = None;
    let mut complained = false;
    loop {
        match connected(peer, &mut scene, &mut messages).await {
            Ok(()) => return,
            Err(error) => {
                if let ServiceError::Status {
                    code: Code::Unimplemented | Code::Unauthenticated | Code::InvalidArgument,
                    ..
                } = error
                {
                    tracing::warn!("the run is not shown: {error}");
                    return;
                }
                if !complained {
                    tracing::warn!("the run is not shown for now: {error}");
                    complained = true;
                }
            }
        }
        // Messages from the meantime are lost; the scene is kept.
        let again = tokio::time::sleep(AGAIN);
        tokio::pin!(again);
        loop {
            tokio::select! {
                () = &mut again => break,
                message = messages.recv() => match message {
                    Some(message) => note_scene(&mut scene, &message),
                    None => return,
                },
            }
        }
    }
}

fn note_scene(scene: &mut Option<ViewerMessage>, message: &ViewerMessage) {
    if matches!(message, ViewerMessage::Scene(_)) {
        *scene = Some(message.clone());
    }
}

/// One connection, until the run or the connection ends.
async fn connected(
    peer: &Peer,
    scene: &mut Option<ViewerMessage>,
    messages: &mut mpsc::Receiver<ViewerMessage>,
) -> Result<(), ServiceError> {
    let name = peer.to_string();
    let (channel, credentials) = connect(peer).await?;
    let mut client = LiveViewClient::with_interceptor(channel, credentials);
    let (out, stream) = mpsc::channel(1);
    let call = client.publish(ReceiverStream::new(stream));
    tokio::pin!(call);
    let mut next = scene.clone();
    loop {
        let message = if let Some(message) = next.take() {
            message
        } else {
            tokio::select! {
                message = messages.recv() => match message {
                    Some(message) => message,
                    None => break,
                },
                ended = &mut call => return ended.map(|_| ()).map_err(|s| ServiceError::status(&name, &s)),
            }
        };
        note_scene(scene, &message);
        let Ok(json) = serde_json::to_string(&message) else {
            continue;
        };
        tokio::select! {
            sent = out.send(LiveMessage { json }) => if sent.is_err() { break },
            ended = &mut call => return ended.map(|_| ()).map_err(|s| ServiceError::status(&name, &s)),
        }
    }
    drop(out);
    call.await.map(|_| ()).map_err(|s| ServiceError::status(&name, &s))
}
