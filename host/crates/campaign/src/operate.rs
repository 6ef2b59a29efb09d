//! Single orders: the steps of Algorithm 2 for a client that decides between the steps, on a
//! campaign's session.

use std::sync::atomic::AtomicBool;

use spherecal_shared::Joints;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::{
    ApproachCommand, Command, FaultReport, ImpedanceCommand, Phase, PoseCommand, Sample,
};
use spherecal_shared::robot::{Robot, Tool};

use super::observe::CampaignObserver;
use super::procedure::Campaign;
use super::session::{Session, Waited};
use super::{Assignment, CampaignError, RunOptions};
use spherecal_link::{Arrival, Device, Journal, JournalError};
use spherecal_plan::Plan;

/// Time that one order may take, in s of device time.
const ORDER_S: f64 = 120.0;

/// One step of the procedure.
#[derive(Clone, Debug, PartialEq)]
pub enum Order {
    /// Move in free space to joint angles, in rad.
    Move(Joints),
    /// From the approach frame: tare, descend, touch, couple.
    Approach(ApproachCommand),
    /// Turn about the coupled sphere, and record there if requested.
    Pose(PoseCommand),
    /// Leave the sphere.
    Decouple,
    /// Hold by a Cartesian spring, or change it.
    Impedance(ImpedanceCommand),
    /// Stop any motion and hold.
    Stop,
    /// Leave a fault.
    ClearFault,
}

/// How an order ended.
#[derive(Clone, Debug, Default)]
pub struct Answer {
    /// Why it was not done, in words; `None` if it was.
    pub refused: Option<String>,
    /// What came meanwhile, in order.
    pub events: Vec<Arrival>,
    /// The newest sample of the control loop.
    pub sample: Option<Sample>,
}

/// Keeps events until they are asked for.
#[derive(Default)]
struct Tray(std::sync::Arc<std::sync::Mutex<Vec<Arrival>>>);

impl Journal for Tray {
    fn append(&mut self, events: &[Arrival]) -> Result<(), JournalError> {
        if let Ok(mut tray) = self.0.lock() {
            tray.extend_from_slice(events);
        }
        Ok(())
    }

    fn reject(&mut self, _: u32, _: u32, _: &str) -> Result<(), JournalError> {
        Ok(())
    }
}

/// Where orders are given.
pub struct ManualControl<'a> {
    session: Session<'a>,
    tray: Tray,
}

/// Performs the handshake, configures the controller, and lets `work` give orders. In every case
/// the arm is told to stop at the end.
///
/// # Errors
/// The link fails, the controller does not match this program, or `work` reports an error.
pub fn operate(
    device: &mut dyn Device,
    robot: &Robot,
    tool: &Tool,
    procedure: &Procedure,
    observer: &mut dyn CampaignObserver,
    interrupt: &AtomicBool,
    work: impl FnOnce(&mut ManualControl<'_>) -> Result<(), CampaignError>,
) -> Result<(), CampaignError> {
    let tray = Tray::default();
    let mut journal = Tray(std::sync::Arc::clone(&tray.0));
    let lead_us = u64::from(RunOptions::default().lead_ms) * 1000;
    let mut session = Session::new(device, &mut journal, observer, interrupt, lead_us);
    let (plan, done) = (Plan::default(), std::collections::BTreeSet::new());
    let assignment = Assignment {
        robot,
        tool,
        procedure,
        plan: &plan,
        done: &done,
        seated: &[],
        options: RunOptions::default(),
    };
    Campaign::new(&assignment).begin(&mut session)?;
    let mut port = ManualControl { session, tray };
    let result = work(&mut port);
    if !matches!(port.session.phase, Phase::Idle | Phase::Coupled | Phase::Fault) {
        // A refusal changes nothing: the arm holds.
        let _ = port.session.ask("stop", Command::Stop)?;
    }
    port.session.drain(20)?;
    match result {
        // The client disconnected; the arm was stopped.
        Err(CampaignError::Interrupted) => Ok(()),
        other => other,
    }
}

impl ManualControl<'_> {
    /// Carries out one order and waits for its end.
    ///
    /// # Errors
    /// The link fails or the user interrupts. A refusal or a fault is an answer, not an error.
    pub fn carry_out(&mut self, order: &Order) -> Result<Answer, CampaignError> {
        let refused = self.attempt(order)?;
        // Send the acknowledgements before the client decides on the next step.
        self.session.drain(2)?;
        let events = self.tray.0.lock().map(|mut t| std::mem::take(&mut *t));
        Ok(Answer {
            refused,
            events: events.unwrap_or_default(),
            sample: self.session.sample(),
        })
    }

    /// One control period without an order: the controller receives a sign of life from its host.
    ///
    /// # Errors
    /// When the link fails.
    pub fn idle(&mut self) -> Result<(), CampaignError> {
        self.session.step()
    }

    /// Device time, in µs.
    pub fn now_us(&self) -> u64 {
        self.session.now_us()
    }

    /// The newest sample of the control loop.
    pub fn sample(&self) -> Option<Sample> {
        self.session.sample()
    }

    /// The fault in which the arm is.
    pub fn fault(&self) -> Option<FaultReport> {
        let faulted = self.session.phase == Phase::Fault;
        self.session.pending_fault.filter(|_| faulted)
    }

    fn attempt(&mut self, order: &Order) -> Result<Option<String>, CampaignError> {
        let session = &mut self.session;
        session.coupled = None;
        session.recorded = None;
        session.passed = None;
        let (what, command) = match order {
            Order::Move(target) => ("move", Command::Move { target: target.clone() }),
            Order::Approach(approach) => ("approach", Command::Approach(*approach)),
            Order::Pose(pose) => ("take a pose", Command::Pose(pose.clone())),
            Order::Decouple => ("decouple", Command::Decouple),
            Order::Impedance(spring) => ("hold by a spring", Command::Impedance(*spring)),
            Order::Stop => ("stop", Command::Stop),
            Order::ClearFault => {
                session.clear_fault()?;
                return Ok(None);
            }
        };
        if let Err(refusal) = session.ask(what, command)? {
            return Ok(Some(refusal.to_string()));
        }
        let ended = |s: &Session<'_>| {
            let ended = match order {
                Order::Move(_) | Order::Decouple => s.rests(),
                Order::Impedance(_) => s.phase == Phase::Impedance,
                Order::Approach(a) => s.phase == Phase::Coupled && s.coupled.is_some_and(|c| c.sphere == a.sphere),
                Order::Pose(p) => {
                    let there = s.recorded.is_some_and(|(_, pose)| pose == p.pose) || s.passed == Some(p.pose);
                    there && s.phase == Phase::Coupled
                }
                Order::Stop | Order::ClearFault => true,
            };
            ended.then_some(())
        };
        match session.wait(what, ORDER_S, ended)? {
            Waited::Got(()) => Ok(None),
            Waited::Fault(report) => Ok(Some(format!(
                "fault while {:?}: {:?} (value {}, limit {}): clear the fault first",
                report.phase, report.fault, report.value, report.limit
            ))),
        }
    }
}
