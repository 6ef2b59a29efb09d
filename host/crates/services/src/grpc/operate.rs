//! `RobotController.Operate`: carries out a client's orders one after the other, on the same kind
//! of session that a campaign uses; and what a server knows of its robot.

use std::sync::atomic::AtomicBool;

use spherecal_campaign::{self as campaign, Answer, CampaignError, CampaignObserver};
use spherecal_link::{Arrival, Device, LinkError};
use spherecal_shared::Joints;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::{ApproachCommand, Event, PoseCommand, Sample};
use spherecal_shared::robot::{Robot, Tool};
use tokio::sync::watch;

use super::convert;
use super::proto::order::Command;
use super::proto::{self, Outcome};

/// A client's reply to the request for its next order.
pub(super) enum NextOrder {
    /// This.
    Order(proto::Order),
    /// Nothing for a millisecond.
    Nothing,
    /// The client has disconnected.
    Gone,
}

/// Leaves telemetry for those who watch.
struct Watched<'a> {
    newest: &'a Newest,
}

impl CampaignObserver for Watched<'_> {
    fn event(&mut self, _now_us: u64, arrival: &Arrival) {
        if let Event::Telemetry(samples) = &arrival.body
            && let Some(sample) = samples.last()
            && self.newest.receiver_count() > 0
        {
            self.newest.send_replace(Some(*sample));
        }
    }
}

/// Carries out orders until there are no more, or until the client disconnects.
/// Errors: when the link to the robot fails. A refused or failed order is an answer, not an error.
pub(super) fn operate(
    device: &mut dyn Device,
    facts: &RobotFacts,
    newest: &Newest,
    interrupt: &AtomicBool,
    mut next: impl FnMut() -> NextOrder,
    mut answer: impl FnMut(Outcome) -> bool,
) -> Result<(), CampaignError> {
    let mut watched = Watched { newest };
    let joints = facts.robot.dof();
    campaign::operate(
        device,
        &facts.robot,
        &facts.tool,
        &facts.procedure,
        &mut watched,
        interrupt,
        |port| {
            loop {
                let order = match next() {
                    NextOrder::Order(order) => order,
                    // The robot's time continues meanwhile, about as fast as real time.
                    NextOrder::Nothing => {
                        port.idle()?;
                        continue;
                    }
                    NextOrder::Gone => break,
                };
                let outcome = match command(order) {
                    Ok(order) => outcome(port.carry_out(&order)?, joints),
                    Err(reason) => Outcome {
                        reason,
                        ..Outcome::default()
                    },
                };
                if !answer(outcome) {
                    break;
                }
            }
            Ok(())
        },
    )
}

fn outcome(answer: Answer, joints: usize) -> Outcome {
    Outcome {
        done: answer.refused.is_none(),
        reason: answer.refused.unwrap_or_default(),
        events: answer
            .events
            .iter()
            .filter_map(|a| convert::event(a.event, a.sent_us, &a.body))
            .collect(),
        state: answer.sample.map(|sample| convert::state(&sample, joints)),
    }
}

fn command(order: proto::Order) -> Result<campaign::Order, convert::Malformed> {
    let joints = |values: &[f64]| {
        Joints::from_slice(values).map_err(|_| format!("{} joints are more than any supported robot has", values.len()))
    };
    Ok(match order.command.ok_or("an order without a command")? {
        Command::Move(target) => campaign::Order::Move(joints(&target.rad)?),
        Command::Approach(a) => campaign::Order::Approach(ApproachCommand {
            sphere: a.sphere,
            direction: three("direction", &a.direction)?,
        }),
        Command::Pose(p) => campaign::Order::Pose(PoseCommand {
            pose: p.pose,
            orientation: p
                .orientation
                .as_slice()
                .try_into()
                .map_err(|_| format!("orientation has {} numbers, not 4", p.orientation.len()))?,
            elbow_rad: p.elbow_rad,
            posture: joints(&p.posture_rad)?,
            record: p.record,
        }),
        Command::Decouple(_) => campaign::Order::Decouple,
        Command::Stop(_) => campaign::Order::Stop,
        Command::ClearFault(_) => campaign::Order::ClearFault,
    })
}

fn three(field: &str, values: &[f64]) -> Result<[f64; 3], convert::Malformed> {
    values
        .try_into()
        .map_err(|_| format!("{field} has {} numbers, not 3", values.len()))
}

/// Makes the robot, at the first client.
pub type DeviceFactory = Box<dyn Fn() -> Result<Box<dyn Device>, LinkError> + Send + Sync>;

/// What is known of the robot without asking it.
#[derive(Clone, Debug)]
pub struct RobotFacts {
    /// Nominal robot.
    pub robot: Robot,
    /// Nominal tool.
    pub tool: Tool,
    /// Procedure for clients that give orders.
    pub procedure: Procedure,
    /// Home frame, in rad.
    pub home: Vec<f64>,
}

/// Holds the newest telemetry for observers.
pub(super) type Newest = watch::Sender<Option<Sample>>;
