//! The host's end of a robot behind `RobotController.Attach`.

use spherecal_shared::robot::{JointLimits, Robot};
use tokio::runtime::Runtime;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;

use super::peer::{connect, within};
use super::proto::robot_controller_client::RobotControllerClient;
use super::proto::{ControllerTurn, DescribeRequest, HostTurn};
use crate::ServiceError;
use spherecal_budget::link::PERIOD;
use spherecal_budget::services::MESSAGE_BYTES;
use spherecal_link::tcp::check_limits;
use spherecal_link::{Device, LinkError};
use spherecal_store::Peer;

/// A robot whose controller is behind gRPC.
pub struct RemoteRobot {
    runtime: Runtime,
    peer: String,
    down: mpsc::Sender<HostTurn>,
    up: Streaming<ControllerTurn>,
    now_us: u64,
    ticks: u64,
    /// Whether the robot's time goes on between two turns.
    in_real_time: bool,
}

fn failed(error: ServiceError) -> LinkError {
    LinkError::Device {
        input: error.is_input(),
        source: Box::new(error),
    }
}

impl RemoteRobot {
    /// Connects, checks that the robot there is `robot`, and takes control of it.
    ///
    /// # Errors
    /// Nothing answers there, another client controls the robot, or it is another robot.
    pub fn attach(peer: &Peer, robot: &Robot) -> Result<Self, LinkError> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|e| failed(e.into()))?;
        let name = peer.to_string();
        let (down, turns) = mpsc::channel(1);
        let (limits, up) = runtime
            .block_on(async {
                let status = |status| ServiceError::status(&name, &status);
                let (channel, credentials) = connect(peer).await?;
                let mut client = RobotControllerClient::with_interceptor(channel, credentials)
                    .max_decoding_message_size(MESSAGE_BYTES);
                let begun = async {
                    let about = client.describe(DescribeRequest {}).await.map_err(status)?.into_inner();
                    let up = client.attach(ReceiverStream::new(turns)).await.map_err(status)?;
                    Ok::<_, ServiceError>((about.limits, up.into_inner()))
                };
                // The device is made now: it may wait for a person at the cabinet.
                within(PERIOD, &name, "did not answer", begun).await
            })
            .map_err(failed)?;
        if limits.len() != robot.dof() {
            return Err(LinkError::OtherRobot {
                drive: limits.len(),
                robot: robot.dof(),
            });
        }
        let limits: Vec<JointLimits> = limits
            .iter()
            .map(|l| JointLimits {
                min_rad: l.min_rad,
                max_rad: l.max_rad,
                velocity_rad_s: l.velocity_rad_s,
                torque_nm: l.torque_nm,
            })
            .collect();
        check_limits(&limits, robot)?;
        Ok(Self {
            runtime,
            peer: name,
            down,
            up,
            now_us: 0,
            ticks: 0,
            in_real_time: false,
        })
    }

    fn turn(&mut self, turn: HostTurn) -> Result<ControllerTurn, ServiceError> {
        let gone = |what: &str| ServiceError::Transport {
            peer: self.peer.clone(),
            what: what.to_owned(),
        };
        self.runtime.block_on(async {
            let answer = async {
                // The server's last message contains its reason, if it has one.
                let _ = self.down.send(turn).await;
                match self.up.message().await {
                    Ok(Some(answer)) => Ok(answer),
                    Ok(None) => Err(gone("the connection was closed")),
                    Err(status) => Err(ServiceError::status(&self.peer, &status)),
                }
            };
            within(PERIOD, &self.peer, "answered no period", answer).await
        })
    }
}

impl Device for RemoteRobot {
    fn now_us(&self) -> u64 {
        self.now_us
    }

    fn ticks(&self) -> u64 {
        self.ticks
    }

    fn step(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        let answer = self
            .turn(HostTurn {
                frames: down.to_vec(),
                move_plate: None,
            })
            .map_err(failed)?;
        up.extend_from_slice(&answer.frames);
        self.now_us = answer.now_us;
        self.ticks = answer.ticks;
        self.in_real_time = answer.in_real_time;
        Ok(())
    }

    fn waits(&self) -> bool {
        !self.in_real_time
    }

    fn move_plate(&mut self, place: u32) -> bool {
        let turn = HostTurn {
            frames: Vec::new(),
            move_plate: Some(place),
        };
        // A link that has failed reports it at the next period.
        self.turn(turn).is_ok_and(|answer| answer.plate_moved)
    }
}
