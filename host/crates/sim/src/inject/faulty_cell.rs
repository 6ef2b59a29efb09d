//! Controller and drive in lock-step, with injected faults between them.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveReceiver, DriveState};
use spherecal_shared::protocol::frame::{LinkCounters, MAX_FRAME};
use spherecal_shared::protocol::host::Phase;

use super::fault::InjectedFault;
use super::host_faults::{HostFaults, HostKilled, end_process};
use super::listener::PhaseListener;
use super::plan::{FaultPlan, InjectError};
use super::scheduler::{FaultyDrive, Scheduler};
use spherecal_link::{Controller, Device, LinkError, Lossy, check_hello};

use crate::lossy::{InjectedCounter, LossyLink};
use crate::plant::{Disturbance, TorqueSensorFault};

/// Periods without a new command after which a drive closes its brakes, as docs/drive-link.md says:
/// nobody monitors the effect of the last torque.
pub(super) const PATIENCE: u32 = 10;
/// Bytes of the host that wait while the controller is not ticked.
const WAITING: usize = 4 * MAX_FRAME;

/// Creates a fresh controller, to replace one that is reset.
pub type Restart = Box<dyn FnMut() -> Result<Box<dyn Controller>, LinkError> + Send>;

/// A fault that has begun or ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Happened {
    /// Control period, from 1.
    pub tick: u64,
    /// Phase that the controller had reported by then.
    pub phase: Phase,
    /// The fault.
    pub what: InjectedFault,
    /// Whether it began; else it ended.
    pub begins: bool,
}

/// A controller and a drive, stepped one control period at a time, with the planned faults.
pub struct FaultyCell {
    controller: Box<dyn Controller>,
    drive: FaultyDrive,
    restart: Restart,
    hello: DriveHello,
    scheduler: Scheduler,
    listener: PhaseListener,
    pub(super) rng: ChaCha8Rng,
    pub(super) active: Vec<InjectedFault>,
    resets: bool,
    /// The last state of the drive, and the last state that the controller received.
    pub(super) state: DriveState,
    pub(super) told: Option<DriveState>,
    pub(super) queue: VecDeque<DriveState>,
    pub(super) receiver: DriveReceiver,
    pub(super) frames: u32,
    pub(super) command: Option<DriveCommand>,
    /// Periods since the last command.
    pub(super) unanswered: u32,
    waiting: Vec<u8>,
    up: Vec<u8>,
    moving: Option<([f64; 3], u32)>,
    missed: u64,
    ticks: u64,
    /// The host link, once it was bad.
    link: Option<LossyLink>,
    down: Vec<u8>,
    /// Number of periods without a host, once the host is to be killed.
    killed: Option<u64>,
    /// Whether this process ends when the host is to be killed.
    ends_process: bool,
    injected: InjectedCounter,
    host_faults: HostFaults,
    happened: Arc<Mutex<Vec<Happened>>>,
}

impl FaultyCell {
    /// Joins a controller and a drive for a robot with `joints` joints.
    ///
    /// # Errors
    /// A drive that [`LocalDevice`](spherecal_link::LocalDevice) would refuse, a plan with a number out of range,
    /// or a plan that needs the simulated arm where there is none.
    pub fn new(
        mut controller: Box<dyn Controller>,
        drive: FaultyDrive,
        joints: usize,
        plan: &FaultPlan,
        restart: Restart,
    ) -> Result<Self, FaultyCellError> {
        plan.check(joints)?;
        let disturbable = matches!(drive, FaultyDrive::Simulated(_));
        for (entry, number) in plan.faults.iter().zip(1..) {
            if entry.what.wants_plant() && !disturbable {
                return Err(InjectError::NotHere {
                    number,
                    name: entry.what.name(),
                    why: "this fault needs the simulated arm: use --link sim or --link qemu",
                }
                .into());
            }
        }
        let hello = drive.drive().hello().clone();
        check_hello(&hello, joints)?;
        controller.connect(&hello)?;
        Ok(Self {
            controller,
            drive,
            restart,
            scheduler: Scheduler::new(plan, f64::from(hello.period_us) * 1e-6),
            listener: PhaseListener::default(),
            rng: ChaCha8Rng::seed_from_u64(plan.seed ^ 0x5eed),
            active: Vec::new(),
            resets: false,
            state: DriveState::default(),
            told: None,
            queue: VecDeque::new(),
            receiver: DriveReceiver::new(),
            frames: 0,
            command: None,
            unanswered: 0,
            waiting: Vec::new(),
            up: Vec::new(),
            moving: None,
            missed: 0,
            ticks: 0,
            link: None,
            down: Vec::new(),
            killed: None,
            ends_process: false,
            injected: InjectedCounter::default(),
            host_faults: HostFaults::default(),
            happened: Arc::default(),
            hello,
        })
    }

    /// Every fault that has begun or ended so far. The handle stays valid.
    pub fn happened(&self) -> Arc<Mutex<Vec<Happened>>> {
        Arc::clone(&self.happened)
    }

    /// Counts of the changed frames of the host link. The handle stays valid.
    pub fn injected(&self) -> InjectedCounter {
        self.injected.clone()
    }

    /// Makes this process end, as by `kill -9`, when the host is to be killed; otherwise the period
    /// fails with [`HostKilled`].
    pub fn ending_process(mut self) -> Self {
        self.ends_process = true;
        self
    }

    /// The faults of the host's own computer, for the journal that writes to its disk.
    pub fn host_faults(&self) -> HostFaults {
        self.host_faults.clone()
    }

    /// Counters of the drive link, if its states were sent as frames.
    pub fn drive_counters(&self) -> LinkCounters {
        self.receiver.counters()
    }

    fn begin(&mut self, what: InjectedFault) {
        let disturbance = match what {
            InjectedFault::EncoderStuck { joint } => Disturbance::StickEncoder(joint - 1, true),
            InjectedFault::TorqueBias { joint, nm } => {
                Disturbance::Torque(joint - 1, Some(TorqueSensorFault::Bias(nm)))
            }
            InjectedFault::TorqueDead { joint } => Disturbance::Torque(joint - 1, Some(TorqueSensorFault::Dead)),
            InjectedFault::Payload { kg } => Disturbance::Payload(kg),
            InjectedFault::Obstacle { ahead_m, stiffness_n_m } => Disturbance::ObstacleAhead(ahead_m, stiffness_n_m),
            InjectedFault::MagnetLost => Disturbance::Magnet(false),
            InjectedFault::SphereMissing => Disturbance::TakeNearestSphere,
            InjectedFault::SphereMoved { by_m, over_s } => {
                let ticks = (over_s * 1e6 / f64::from(self.hello.period_us)).round().max(1.0);
                self.moving = Some((by_m.map(|x| x / ticks), ticks as u32));
                return;
            }
            InjectedFault::HumanPush { force_n } => Disturbance::Push(force_n),
            InjectedFault::ControllerReset => {
                self.resets = true;
                return;
            }
            InjectedFault::HostLink(config) => {
                let link = self.link.get_or_insert_with(|| LossyLink::new(config));
                return link.turn(config);
            }
            InjectedFault::HostKilled { away_s } => {
                self.killed = Some((away_s * 1e6 / f64::from(self.hello.period_us)) as u64);
                return;
            }
            InjectedFault::DiskFull => return self.host_faults.fill(true),
            // The plan was checked, so the duration is valid.
            InjectedFault::DatabaseLocked { wall_s } => {
                return self
                    .host_faults
                    .lock(Duration::try_from_secs_f64(wall_s).unwrap_or_default());
            }
            _ => {
                self.active.push(what);
                return;
            }
        };
        self.drive.disturb(&disturbance);
    }

    fn end(&mut self, what: InjectedFault) {
        let disturbance = match what {
            InjectedFault::EncoderStuck { joint } => Disturbance::StickEncoder(joint - 1, false),
            InjectedFault::TorqueBias { joint, .. } | InjectedFault::TorqueDead { joint } => {
                Disturbance::Torque(joint - 1, None)
            }
            InjectedFault::Payload { .. } => Disturbance::Payload(0.0),
            InjectedFault::Obstacle { .. } => Disturbance::Obstacle(None),
            InjectedFault::MagnetLost => Disturbance::Magnet(true),
            InjectedFault::SphereMissing => Disturbance::RestoreSpheres,
            InjectedFault::HumanPush { .. } => Disturbance::Push([0.0; 3]),
            InjectedFault::HostLink(_) => {
                if let Some(link) = &mut self.link {
                    link.turn(Lossy::default());
                }
                return;
            }
            InjectedFault::DiskFull => return self.host_faults.fill(false),
            _ => {
                if let Some(at) = self.active.iter().position(|a| *a == what) {
                    self.active.remove(at);
                }
                return;
            }
        };
        self.drive.disturb(&disturbance);
    }

    /// Begins and ends what is due.
    fn advance(&mut self) {
        let mut changes = Vec::new();
        self.scheduler
            .at(self.ticks, |what, begins| changes.push((what, begins)));
        for (what, begins) in changes {
            self.happened
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .push(Happened {
                    tick: self.ticks,
                    phase: self.listener.phase(),
                    what,
                    begins,
                });
            if begins {
                self.begin(what);
            } else {
                self.end(what);
            }
        }
        if let Some((by_m, left)) = self.moving {
            self.drive.disturb(&Disturbance::MoveNearestSphere(by_m));
            self.moving = (left > 1).then_some((by_m, left - 1));
        }
    }

    fn restart(&mut self) -> Result<(), LinkError> {
        self.resets = false;
        self.controller = (self.restart)()?;
        self.controller.connect(&self.hello)?;
        self.listener.restarted();
        self.waiting.clear();
        self.command = None;
        Ok(())
    }

    fn period(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        let command = self.delivered();
        let drive = self.drive.drive_mut();
        drive.exchange(command.as_ref(), &mut self.state)?;
        let missed = drive.missed();
        self.missed = self.missed.saturating_add(u64::from(missed));
        self.ticks += 1;
        self.advance();
        if self.resets {
            self.restart()?;
        }
        let now_us = self.now_us();
        let down = match &mut self.link {
            Some(link) => {
                self.down.clear();
                link.down(now_us, down, &mut self.down);
                &self.down
            }
            None => down,
        };
        let silent = self.active.contains(&InjectedFault::HostSilent);
        if silent {
            self.waiting.clear();
        } else if self.waiting.len() + down.len() <= WAITING {
            self.waiting.extend_from_slice(down);
        }
        let Some(state) = self.heard() else {
            // The controller is not ticked; the drive continues with the last torque for a while.
            self.unanswered = self.unanswered.saturating_add(1);
            return Ok(());
        };
        self.controller.missed(missed);
        self.up.clear();
        let command = self.controller.exchange(now_us, &state, &self.waiting, &mut self.up)?;
        self.waiting.clear();
        self.command = Some(command);
        self.unanswered = 0;
        self.told = Some(state);
        let (scheduler, tick) = (&mut self.scheduler, self.ticks);
        self.listener
            .hear(&self.up, |phase, count| scheduler.entered(phase, count, tick));
        match &mut self.link {
            _ if silent => {}
            Some(link) => {
                link.up(now_us, &self.up, up);
                self.injected.set(link.injected());
            }
            None => up.extend_from_slice(&self.up),
        }
        Ok(())
    }
}

impl Device for FaultyCell {
    fn simulated(&self) -> Option<bool> {
        Some(self.hello.simulated)
    }

    fn now_us(&self) -> u64 {
        let periods = self.ticks.saturating_sub(1).saturating_add(self.missed);
        periods.saturating_mul(u64::from(self.hello.period_us))
    }

    fn ticks(&self) -> u64 {
        self.ticks
    }

    fn move_plate(&mut self, place: u32) -> bool {
        self.drive.drive_mut().move_plate(place)
    }

    fn step(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        self.period(down, up)?;
        let Some(away) = self.killed.take() else {
            return Ok(());
        };
        // Nobody receives what was said in this period or in those without a host.
        for _ in 0..away {
            up.clear();
            self.period(&[], up)?;
        }
        up.clear();
        if self.ends_process {
            end_process();
        }
        Err(LinkError::device(HostKilled))
    }
}

/// Why there is no such device.
#[derive(Debug, thiserror::Error)]
pub enum FaultyCellError {
    /// The plan was refused.
    #[error(transparent)]
    Inject(#[from] InjectError),
    /// Drive or controller were refused.
    #[error(transparent)]
    Link(#[from] LinkError),
}
