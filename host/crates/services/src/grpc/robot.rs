//! The service `RobotController`: one robot, one client at a time.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use spherecal_shared::protocol::frame::{self, Accumulator};
use spherecal_shared::protocol::host::{Event, Uplink};
use tokio::sync::{Mutex, OwnedMutexGuard, mpsc, watch};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};

use super::convert;
use super::operate::{DeviceFactory, Newest, NextOrder, RobotFacts, operate};
use super::proto::robot_controller_server::RobotController;
use super::proto::{
    ControllerTurn, DescribeRequest, HostTurn, JointLimit, Order, Outcome, RobotDescription, RobotState, WatchRequest,
};
use spherecal_link::Device;

/// The robot. It is created for the first client and then kept in its state.
type KeptDevice = Option<Box<dyn Device>>;

#[derive(Clone)]
pub(crate) struct RobotService {
    facts: Arc<RobotFacts>,
    make: Arc<DeviceFactory>,
    device: Arc<Mutex<KeptDevice>>,
    newest: Arc<Newest>,
}

impl RobotService {
    pub(crate) fn new(facts: RobotFacts, make: DeviceFactory) -> Self {
        Self {
            facts: Arc::new(facts),
            make: Arc::new(make),
            device: Arc::default(),
            newest: Arc::new(watch::channel(None).0),
        }
    }

    /// Takes control of the robot, if it is free.
    async fn hold(&self) -> Result<OwnedMutexGuard<KeptDevice>, Status> {
        let mut held = Arc::clone(&self.device)
            .try_lock_owned()
            .map_err(|_| Status::resource_exhausted("another client has the robot"))?;
        if held.is_none() {
            let make = Arc::clone(&self.make);
            // Connecting to a drive or starting QEMU takes time.
            let made = tokio::task::spawn_blocking(move || make())
                .await
                .map_err(|e| Status::internal(e.to_string()))?;
            *held = Some(made.map_err(|e| Status::unavailable(e.to_string()))?);
        }
        Ok(held)
    }
}

/// Reads telemetry from the controller's bytes, for observers.
fn hear(accumulator: &mut Accumulator, bytes: &[u8], newest: &Newest) {
    if newest.receiver_count() == 0 {
        return;
    }
    for &byte in bytes {
        accumulator.push(byte, &mut |frame| {
            if let Ok((_, uplink)) = frame.and_then(frame::decode::<Uplink>)
                && let Event::Telemetry(samples) = &uplink.body
                && let Some(sample) = samples.last()
            {
                newest.send_replace(Some(*sample));
            }
        });
    }
}

#[tonic::async_trait]
impl RobotController for RobotService {
    async fn describe(&self, _request: Request<DescribeRequest>) -> Result<Response<RobotDescription>, Status> {
        let robot = &self.facts.robot;
        Ok(Response::new(RobotDescription {
            robot: robot.name.to_string(),
            joints: robot.dof() as u32,
            limits: robot
                .joints
                .iter()
                .map(|j| JointLimit {
                    min_rad: j.limits.min_rad,
                    max_rad: j.limits.max_rad,
                    velocity_rad_s: j.limits.velocity_rad_s,
                    torque_nm: j.limits.torque_nm,
                })
                .collect(),
            home_rad: self.facts.home.clone(),
            program: concat!("spherecal ", env!("CARGO_PKG_VERSION")).to_owned(),
        }))
    }

    type AttachStream = ReceiverStream<Result<ControllerTurn, Status>>;

    async fn attach(&self, request: Request<Streaming<HostTurn>>) -> Result<Response<Self::AttachStream>, Status> {
        let mut held = self.hold().await?;
        let mut turns = request.into_inner();
        let (answers, stream) = mpsc::channel(1);
        let newest = Arc::clone(&self.newest);
        tokio::spawn(async move {
            let Some(device) = held.as_mut() else { return };
            let (begun_us, begun_ticks) = (device.now_us(), device.ticks());
            let (mut up, mut accumulator) = (Vec::new(), Accumulator::new());
            // However the client disconnects, the robot stays where it is and holds.
            while let Ok(Some(turn)) = turns.message().await {
                up.clear();
                let stepped = match turn.move_plate {
                    Some(place) => Ok(device.move_plate(place)),
                    None => device.step(&turn.frames, &mut up).map(|()| false),
                };
                hear(&mut accumulator, &up, &newest);
                let failed = stepped.is_err();
                let answer = stepped
                    .map(|plate_moved| ControllerTurn {
                        frames: up.clone(),
                        now_us: device.now_us().saturating_sub(begun_us),
                        ticks: device.ticks().saturating_sub(begun_ticks),
                        plate_moved,
                        in_real_time: !device.waits(),
                    })
                    .map_err(|e| Status::unavailable(e.to_string()));
                if answers.send(answer).await.is_err() {
                    return;
                }
                if failed {
                    // A device that failed for good is created again for the next client.
                    *held = None;
                    return;
                }
            }
        });
        Ok(Response::new(ReceiverStream::new(stream)))
    }

    type OperateStream = ReceiverStream<Result<Outcome, Status>>;

    async fn operate(&self, request: Request<Streaming<Order>>) -> Result<Response<Self::OperateStream>, Status> {
        let mut held = self.hold().await?;
        let mut orders = request.into_inner();
        let (forward, mut waiting) = mpsc::channel::<Order>(1);
        let (answers, stream) = mpsc::channel(1);
        let interrupt = Arc::new(AtomicBool::new(false));
        let left = Arc::clone(&interrupt);
        let refused = answers.clone();
        tokio::spawn(async move {
            loop {
                match orders.message().await {
                    Ok(Some(order)) => {
                        if forward.send(order).await.is_err() {
                            return;
                        }
                    }
                    Ok(None) => return,
                    // The connection broke: stop the work in progress.
                    Err(_) => return left.store(true, Ordering::Relaxed),
                }
            }
        });
        let (facts, newest) = (Arc::clone(&self.facts), Arc::clone(&self.newest));
        // Orders last for seconds: a thread of its own.
        tokio::task::spawn_blocking(move || {
            let Some(device) = held.as_mut() else { return };
            let result = operate(
                device.as_mut(),
                &facts,
                &newest,
                &interrupt,
                || match waiting.try_recv() {
                    Ok(order) => NextOrder::Order(order),
                    Err(mpsc::error::TryRecvError::Empty) => {
                        std::thread::sleep(std::time::Duration::from_millis(1));
                        NextOrder::Nothing
                    }
                    Err(mpsc::error::TryRecvError::Disconnected) => NextOrder::Gone,
                },
                |outcome| answers.blocking_send(Ok(outcome)).is_ok(),
            );
            if let Err(error) = result {
                let _ = refused.blocking_send(Err(Status::unavailable(error.to_string())));
                *held = None;
            }
        });
        Ok(Response::new(ReceiverStream::new(stream)))
    }

    type WatchStream = ReceiverStream<Result<RobotState, Status>>;

    async fn watch(&self, _request: Request<WatchRequest>) -> Result<Response<Self::WatchStream>, Status> {
        let mut newest = self.newest.subscribe();
        let joints = self.facts.robot.dof();
        let (states, stream) = mpsc::channel(4);
        tokio::spawn(async move {
            while newest.changed().await.is_ok() {
                let sample = *newest.borrow_and_update();
                let Some(sample) = sample else { continue };
                if states.send(Ok(convert::state(&sample, joints))).await.is_err() {
                    return;
                }
                tokio::time::sleep(std::time::Duration::from_millis(50)).await;
            }
        });
        Ok(Response::new(ReceiverStream::new(stream)))
    }
}
