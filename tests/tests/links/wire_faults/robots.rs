//! The two robots in a simulated world, and what happens to them.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::{Duration, Instant};

use spherecal::job::{Config, Link};
use spherecal::sim::RobotArm;
use spherecal::simulated;
use spherecal_cyclic::testing::{LOCAL, World};
use spherecal_cyclic::{Machine as _, Process, Running};
use spherecal_fci::robot::{self as fci, RobotConfig, RobotSide, start_robot};
use spherecal_fci::wire::{FlangeLoad, Version};
use spherecal_fri::robot::{self as fri, CabinetConfig, CabinetSide, Tolerance, start_cabinet};
use spherecal_fri::wire::SessionState;

/// How often the cabinet's application looks after its motion.
const LOOK: Duration = Duration::from_millis(20);
/// How long it rests between two motions.
const NEXT_MOTION: Duration = Duration::from_millis(500);
/// Which datagrams are lost.
const SEED: u64 = 1;

/// What the robot counted, restarts included.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counts {
    /// Commands that answer a state in which no motion ran any more. A client must never send one.
    pub(super) after_stop: u64,
    /// States of a motion without an answer in time.
    pub(super) missing: u64,
}

/// A robot, and what a test does to it while a job runs. Nothing of this waits.
pub(super) trait Robot: Send + Sync {
    /// How the host reaches it.
    fn link(&self) -> Link;
    /// Its time, and the network between.
    fn world(&self) -> &World;
    /// Whether the arm follows torques.
    fn is_moving(&self) -> bool;
    /// The robot ends its motion by itself: by a reflex (Franka), or because the application ends (KUKA).
    fn trip(&self);
    /// The user stop (Franka) or a safety stop (KUKA), pressed or released.
    fn stop(&self, pressed: bool);
    /// On or off. The arm stays where it is.
    fn switch(&self, on: bool);
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
    world: World,
    config: RobotConfig,
    arm: Arc<Mutex<RobotArm>>,
    touched: Arc<AtomicBool>,
    side: Mutex<Option<RobotSide>>,
    earlier: Mutex<Counts>,
}

impl Franka {
    /// The arm of `config` behind this version of the interface. The robot waits for `patience` for an answer.
    pub(super) fn start(config: &Config, version: Version, patience: Duration) -> Arc<Self> {
        let world = World::new(SEED);
        let arm = simulated::robot(config, (0.0, 0.0)).expect("an arm");
        let mut config = RobotConfig {
            machine: world.machine(),
            ..RobotConfig::for_tests(version)
        };
        config.tolerance.patience = patience;
        // A robot that restarts has the same address.
        let probe = world.listen(LOCAL).expect("a free port");
        config.address = probe.address().expect("an address");
        drop(probe);
        let this = Arc::new(Self {
            world,
            config,
            arm: Arc::new(Mutex::new(arm)),
            touched: Arc::default(),
            side: Mutex::default(),
            earlier: Mutex::default(),
        });
        this.switch(true);
        this
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
            host: self.config.address.ip().to_string(),
            port: self.config.address.port(),
        }
    }

    fn world(&self) -> &World {
        &self.world
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

    fn switch(&self, on: bool) {
        let mut side = locked(&self.side);
        if let Some(old) = side.take() {
            locked(&self.earlier).add(&Self::of(&old.shut_down()));
        }
        let arm = Touched {
            arm: Arc::clone(&self.arm),
            touched: Arc::clone(&self.touched),
        };
        *side = on.then(|| start_robot(self.config.clone(), Box::new(arm)).expect("a robot"));
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
    world: World,
    config: CabinetConfig,
    arm: Arc<Mutex<RobotArm>>,
    side: Mutex<Option<CabinetSide>>,
    earlier: Mutex<Counts>,
    /// The application has ended its motion, and has not yet looked after it again.
    tripped: AtomicBool,
    _application: Running,
}

/// The application of a cabinet, as long as that exists.
struct Application {
    kuka: Weak<Kuka>,
    without_motion: Instant,
}

impl Process for Application {
    /// Wants its motion, and half a second after its end the next one.
    fn turn(&mut self, now: Instant) -> Instant {
        if let Some(kuka) = self.kuka.upgrade()
            && let Some(side) = locked(&kuka.side).as_ref()
        {
            let command = &side.controls().command;
            let session = side.statistics().session;
            if matches!(
                session,
                Some(SessionState::CommandingWait | SessionState::CommandingActive)
            ) {
                self.without_motion = now;
            } else if !command.load(Ordering::Relaxed) {
                // The cabinet must see that the motion is over before the next one.
                command.store(!kuka.tripped.swap(false, Ordering::Relaxed), Ordering::Relaxed);
            } else if now > self.without_motion + NEXT_MOTION {
                command.store(false, Ordering::Relaxed);
                self.without_motion = now;
            }
        }
        now + LOOK
    }
}

impl Kuka {
    /// The arm of `config` behind a cabinet that waits for `patience` for an answer.
    pub(super) fn start(config: &Config, patience: Duration) -> Arc<Self> {
        let world = World::new(SEED);
        let arm = Arc::new(Mutex::new(simulated::robot(config, (0.0, 0.0)).expect("an arm")));
        let probe = world.datagrams(LOCAL).expect("a free port");
        let client: SocketAddr = probe.address().expect("an address");
        drop(probe);
        let config = CabinetConfig {
            machine: world.machine(),
            client,
            tolerance: Tolerance { patience },
            ..CabinetConfig::new()
        };
        let this = Arc::new_cyclic(|kuka| {
            let application = Application {
                kuka: Weak::clone(kuka),
                without_motion: world.now(),
            };
            let application = world.run("application", Box::new(application));
            Self {
                world,
                config,
                arm,
                side: Mutex::default(),
                earlier: Mutex::default(),
                tripped: AtomicBool::new(false),
                _application: application.expect("a process"),
            }
        });
        this.switch(true);
        this
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
        Link::Fri(self.config.client)
    }

    fn world(&self) -> &World {
        &self.world
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
            self.tripped.store(true, Ordering::Relaxed);
        }
    }

    fn stop(&self, pressed: bool) {
        if let Some(side) = locked(&self.side).as_ref() {
            side.controls().safety.store(2 * u8::from(pressed), Ordering::Relaxed);
        }
    }

    fn switch(&self, on: bool) {
        let mut side = locked(&self.side);
        if let Some(old) = side.take() {
            locked(&self.earlier).add(&Self::of(&old.shut_down()));
        }
        let arm = Box::new(Arc::clone(&self.arm));
        *side = on.then(|| start_cabinet(self.config.clone(), arm).expect("a cabinet"));
    }

    fn counts(&self) -> Counts {
        let mut counts = *locked(&self.earlier);
        if let Some(side) = locked(&self.side).as_ref() {
            counts.add(&Self::of(&side.statistics()));
        }
        counts
    }
}
