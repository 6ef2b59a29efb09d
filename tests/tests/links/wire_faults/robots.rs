//! The two robots behind networks that can fail, and what happens to them.

use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use spherecal::job::{Config, Link};
use spherecal::sim::RobotArm;
use spherecal::simulated;
use spherecal_cyclic::testing::{Connected, Faults, LOCAL, Relay};
use spherecal_fci::robot::{self as fci, RobotConfig, RobotSide};
use spherecal_fci::wire::{FlangeLoad, Version};
use spherecal_fri::robot::{self as fri, CabinetConfig, CabinetSide, Tolerance};
use spherecal_fri::wire::SessionState;

/// How long a robot that restarts is off.
const OFF: Duration = Duration::from_secs(1);
/// How long the cabinet's application rests between two motions.
const NEXT_MOTION: Duration = Duration::from_millis(500);
/// How long a robot waits for an answer where the test machine may be slow.
pub(super) const LONG: Duration = Duration::from_millis(100);
/// The same where the network loses much: each loss costs this time.
pub(super) const SHORT: Duration = Duration::from_millis(30);
/// Which datagrams are lost.
const SEED: u64 = 1;
/// Bytes of Franka's request to connect.
const CONNECT_BYTES: usize = 16;

/// What the robot counted, restarts included.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counts {
    /// Commands that answer a state in which no motion ran any more. A client must never send one.
    pub(super) after_stop: u64,
    /// States of a motion without an answer in time.
    pub(super) missing: u64,
}

/// A robot, and what a test does to it while a job runs.
pub(super) trait Robot: Send + Sync {
    /// How the host reaches it, through the network.
    fn link(&self) -> Link;
    /// The network between.
    fn faults(&self) -> &Faults;
    /// Whether the arm follows torques.
    fn is_moving(&self) -> bool;
    /// The robot ends its motion by itself: by a reflex (Franka), or because the application ends (KUKA).
    fn trip(&self);
    /// The user stop (Franka) or a safety stop (KUKA), pressed or released.
    fn stop(&self, pressed: bool);
    /// Off for a second, and on again. The arm stays where it is.
    fn restart(&self);
    /// What it counted.
    fn counts(&self) -> Counts;
}

fn locked<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// An arm whose robot feels a touch while `touched` is set, until the robot stops.
struct Touched {
    arm: Arc<Mutex<RobotArm>>,
    touched: Arc<AtomicBool>,
}

impl Touched {
    fn with_touch(&self, mut state: fci::ArmState) -> fci::ArmState {
        if self.touched.load(Ordering::Relaxed) {
            // More than the last joint's threshold, which no procedure can raise above its torque limit of 12 N m.
            state.tau_external[6] += 20.0;
        }
        state
    }
}

impl fci::ArmHardware for Touched {
    fn state(&self) -> fci::ArmState {
        self.with_touch(fci::ArmHardware::state(&self.arm))
    }

    fn step(&mut self, command: fci::ArmCommand) -> fci::ArmState {
        let state = fci::ArmHardware::step(&mut self.arm, command);
        if !matches!(command, fci::ArmCommand::Torque(_)) {
            self.touched.store(false, Ordering::Relaxed);
        }
        self.with_touch(state)
    }

    fn set_load(&mut self, load: &FlangeLoad) {
        fci::ArmHardware::set_load(&mut self.arm, load);
    }
}

/// A Panda or an FR3.
pub(super) struct Franka {
    config: RobotConfig,
    arm: Arc<Mutex<RobotArm>>,
    touched: Arc<AtomicBool>,
    side: Mutex<Option<RobotSide>>,
    earlier: Mutex<Counts>,
    network: Connected,
}

impl Franka {
    /// The arm of `config` behind this version of the interface. The robot waits for `patience` for an answer.
    pub(super) fn start(config: &Config, version: Version, patience: Duration) -> Arc<Self> {
        let arm = simulated::robot(config, (0.0, 0.0)).expect("an arm");
        let arm = Arc::new(Mutex::new(arm));
        let touched = Arc::new(AtomicBool::new(false));
        let mut config = RobotConfig::for_tests(version);
        config.tolerance.patience = patience;
        let side = Self::switch_on(&config, &arm, &touched);
        // A robot that restarts has the same address.
        config.address = side.address();
        let network = Connected::before(side.address(), SEED, CONNECT_BYTES);
        Arc::new(Self {
            config,
            arm,
            touched,
            side: Mutex::new(Some(side)),
            earlier: Mutex::default(),
            network,
        })
    }

    fn switch_on(config: &RobotConfig, arm: &Arc<Mutex<RobotArm>>, touched: &Arc<AtomicBool>) -> RobotSide {
        let arm = Touched {
            arm: Arc::clone(arm),
            touched: Arc::clone(touched),
        };
        RobotSide::start(config.clone(), Box::new(arm)).expect("a robot")
    }

    fn of(statistics: &fci::RobotStatistics) -> Counts {
        Counts {
            after_stop: statistics.commands_after_stop,
            missing: statistics.missing,
        }
    }
}

impl Robot for Franka {
    fn link(&self) -> Link {
        Link::Franka {
            host: self.network.address.ip().to_string(),
            port: self.network.address.port(),
        }
    }

    fn faults(&self) -> &Faults {
        &self.network.faults
    }

    fn is_moving(&self) -> bool {
        let side = locked(&self.side);
        side.as_ref()
            .is_some_and(|side| side.statistics().mode == Some(spherecal_fci::wire::RobotMode::Move))
    }

    fn trip(&self) {
        self.touched.store(true, Ordering::Relaxed);
    }

    fn stop(&self, pressed: bool) {
        if let Some(side) = locked(&self.side).as_ref() {
            side.controls().user_stop.store(pressed, Ordering::Relaxed);
        }
    }

    fn restart(&self) {
        let mut side = locked(&self.side);
        if let Some(old) = side.take() {
            locked(&self.earlier).add(&Self::of(&old.shut_down()));
        }
        std::thread::sleep(OFF);
        *side = Some(Self::switch_on(&self.config, &self.arm, &self.touched));
    }

    fn counts(&self) -> Counts {
        let mut counts = *locked(&self.earlier);
        if let Some(side) = locked(&self.side).as_ref() {
            counts.add(&Self::of(&side.statistics()));
        }
        counts
    }
}

impl Counts {
    fn add(&mut self, other: &Self) {
        self.after_stop += other.after_stop;
        self.missing += other.missing;
    }
}

/// An LBR iiwa 7 and its cabinet, with the application that starts its motion again and again.
pub(super) struct Kuka {
    config: CabinetConfig,
    arm: Arc<Mutex<RobotArm>>,
    /// Where the host listens.
    client: SocketAddr,
    side: Mutex<Option<CabinetSide>>,
    earlier: Mutex<Counts>,
    relay: Relay,
}

impl Kuka {
    /// The arm of `config` behind a cabinet that waits for `patience` for an answer.
    pub(super) fn start(config: &Config, patience: Duration) -> Arc<Self> {
        let arm = Arc::new(Mutex::new(simulated::robot(config, (0.0, 0.0)).expect("an arm")));
        let probe = UdpSocket::bind(LOCAL).expect("a free port");
        let client = probe.local_addr().expect("an address");
        drop(probe);
        let relay = Relay::start(SEED);
        relay.set_b(client.port());
        let config = CabinetConfig {
            client: relay.for_a,
            tolerance: Tolerance { patience },
            ..CabinetConfig::new()
        };
        let side = CabinetSide::start(config.clone(), Box::new(Arc::clone(&arm))).expect("a cabinet");
        let this = Arc::new(Self {
            config,
            arm,
            client,
            side: Mutex::new(Some(side)),
            earlier: Mutex::default(),
            relay,
        });
        let application = Arc::downgrade(&this);
        std::thread::spawn(move || {
            let mut without_motion = Instant::now();
            while let Some(this) = application.upgrade() {
                this.apply(&mut without_motion);
                drop(this);
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        this
    }

    /// The application: wants its motion, and half a second after its end the next one.
    fn apply(&self, without_motion: &mut Instant) {
        let side = locked(&self.side);
        let Some(side) = side.as_ref() else { return };
        let command = &side.controls().command;
        let session = side.statistics().session;
        if matches!(
            session,
            Some(SessionState::CommandingWait | SessionState::CommandingActive)
        ) {
            *without_motion = Instant::now();
        } else if !command.load(Ordering::Relaxed) {
            command.store(true, Ordering::Relaxed);
        } else if without_motion.elapsed() > NEXT_MOTION {
            command.store(false, Ordering::Relaxed);
            *without_motion = Instant::now();
        }
    }

    fn of(statistics: &fri::CabinetStatistics) -> Counts {
        Counts {
            after_stop: statistics.torques_after_stop,
            missing: statistics.missing,
        }
    }
}

impl Robot for Kuka {
    fn link(&self) -> Link {
        Link::Fri(self.client)
    }

    fn faults(&self) -> &Faults {
        &self.relay.faults
    }

    fn is_moving(&self) -> bool {
        let side = locked(&self.side);
        side.as_ref()
            .is_some_and(|side| side.statistics().session == Some(SessionState::CommandingActive))
    }

    fn trip(&self) {
        if let Some(side) = locked(&self.side).as_ref() {
            // The application starts it again by itself.
            side.controls().command.store(false, Ordering::Relaxed);
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn stop(&self, pressed: bool) {
        if let Some(side) = locked(&self.side).as_ref() {
            side.controls().safety.store(2 * u8::from(pressed), Ordering::Relaxed);
        }
    }

    fn restart(&self) {
        let mut side = locked(&self.side);
        if let Some(old) = side.take() {
            locked(&self.earlier).add(&Self::of(&old.shut_down()));
        }
        std::thread::sleep(OFF);
        let arm = Box::new(Arc::clone(&self.arm));
        *side = Some(CabinetSide::start(self.config.clone(), arm).expect("a cabinet"));
    }

    fn counts(&self) -> Counts {
        let mut counts = *locked(&self.earlier);
        if let Some(side) = locked(&self.side).as_ref() {
            counts.add(&Self::of(&side.statistics()));
        }
        counts
    }
}
