//! `spherecal plant --fci` and `--fri` (`--ur`: module `ur_side`): the simulated arm behind a robot's own interface, in real
//! time.

use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use spherecal_fci::TCP_PORT;
use spherecal_fci::robot::{RobotConfig, Tolerance, start_robot};
use spherecal_fci::wire::Version;
use spherecal_fri::robot::{CabinetConfig, start_cabinet};
use spherecal_fri::wire::{Framing, SessionState};

use clap::Args;

use super::args::{base, on_preset};
use super::exit::{CliError, Exit, interrupt};
use super::out::{announce, errln, warn_if_open};
use crate::simulated;
use spherecal_job::{self as job, Config, JobError};
use spherecal_link::native::Undeclared;
use spherecal_shared::robot::BUILT_IN;
use spherecal_sim::GuidedArm;

/// Interval at which the simulated application and Ctrl-C are looked after.
const LOOK: Duration = Duration::from_millis(50);
/// Time without a motion after which the simulated application starts the next one.
const NEXT_MOTION: Duration = Duration::from_millis(500);

/// Preset of an arm behind a robot's own interface, whose torque control hides its motors.
const INTERFACE_PRESET: &str = "typical";

/// Arguments of `plant`.
#[derive(Args, Clone, Debug)]
pub struct PlantArgs {
    /// Address for controllers. A port alone serves this machine only; port 0 takes any free port.
    /// Default: 7401; with --fci 1337, the only port that official clients know.
    #[arg(long, value_name = "[HOST:]PORT", conflicts_with = "fri")]
    pub listen: Option<String>,
    /// Serve the drive link to a controller board at this serial port, in real time (default 3,000,000 baud): the board
    /// moves the simulated arm.
    #[arg(long, value_name = "DEVICE[@BAUD]", conflicts_with_all = ["listen", "fci", "fri", "ur", "once"])]
    pub serial: Option<String>,
    /// Serve the drive link over UDP, in real time, to a controller board or `--link udp:`. A port alone serves this machine
    /// only.
    #[arg(long, value_name = "[HOST:]PORT", conflicts_with_all = ["serial", "listen", "fci", "fri", "ur", "once"])]
    pub udp: Option<String>,
    /// Be a Panda or an FR3 for clients of the Franka Control Interface, in real time.
    #[arg(long, conflicts_with_all = ["fri", "real_time", "once"])]
    pub fci: bool,
    /// Version of the Franka Control Interface: 4 and 5 are a Panda, 6 to 10 an FR3.
    #[arg(long, value_name = "4..10", requires = "fci")]
    pub version: Option<u16>,
    /// Be a KUKA cabinet with an LBR that sends to the client at this address, in real time.
    #[arg(long, value_name = "HOST:PORT", conflicts_with_all = ["real_time", "once"])]
    pub fri: Option<SocketAddr>,
    /// With --fri: where the cabinet sends from. A client that is told the cabinet's address hears no other; a real
    /// cabinet has port 30200. Default: any free port.
    #[arg(long, value_name = "HOST:PORT", requires = "fri")]
    pub from: Option<SocketAddr>,
    /// With --fri: frame each message with its length and a checksum, as version 2.7 of the interface does.
    #[arg(long, requires = "fri")]
    pub framed: bool,
    /// Be a robot of Universal Robots for clients of RTDE at this address, in real time: at rest, or guided by --guide. Its
    /// primary interface is three ports below. Real robots, and some clients, know port 30004 only.
    #[arg(long, value_name = "[HOST:]PORT", conflicts_with_all = ["fci", "fri", "listen", "real_time", "once", "tolerant"])]
    pub ur: Option<String>,
    /// With --ur: be a CB3 (125 Hz; a UR5 without --config), not an e-Series robot (500 Hz).
    #[arg(long, requires = "ur")]
    pub cb3: bool,
    /// With --ur: have the software PolyScope X 10.12.1, with a Robot API in place of the dashboard: five ports below RTDE's, and
    /// at port 80 where that is 30004.
    #[arg(long, requires = "ur", conflicts_with = "cb3")]
    pub polyscope_x: bool,
    /// With --ur: what the robot says of its own calibration (CSV without a header; a line for each joint: theta in rad, a and d
    /// in m, alpha in rad, as its controller has them). Default: the nominal robot.
    #[arg(long, value_name = "FILE.csv", requires = "ur")]
    pub dh: Option<PathBuf>,
    /// Stiffness of the cabinet's joint impedance under the overlay, in N m/rad. The application
    /// sets 0.
    #[arg(long, value_name = "NM_RAD", requires = "fri", default_value_t = 0.0)]
    pub stiffness: f64,
    /// The cabinet's application starts its first motion this long after a client answers, as a person does who has
    /// to confirm it. In s.
    #[arg(long, value_name = "S", requires = "fri", default_value_t = 0.0)]
    pub start_after: f64,
    /// Wait up to 100 ms for each answer of a motion, so that a computer without real time causes
    /// no reflex. A real robot does not wait.
    #[arg(long)]
    pub tolerant: bool,
    /// A simulated hand guides the arm, which then follows no command: to the joint angles of this table
    /// (CSV without a header, one angle in rad for each joint in a line), with 1.7 s at each, and 5 s at the first.
    #[arg(long, value_name = "FILE.csv")]
    pub guide: Option<PathBuf>,
    /// Seed of the arm's errors and noise. Use the run's seed for the same arm.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Configuration of the run, for the same arm and plate.
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Errors of the simulated arm: a preset, instead of the one that the configuration names. Other fields of its
    /// `[plant]` stay. Default: as_measured; with --fci, --fri or --ur, and without --config, typical. With as_measured the motors show, and the program prints the
    /// lines of [cell.drive] that the run needs then.
    #[arg(long, value_name = "NAME")]
    pub preset: Option<String>,
    /// Run in real time at 1 kHz, and do not wait for commands.
    #[arg(long)]
    pub real_time: bool,
    /// End when the first controller has disconnected.
    #[arg(long)]
    pub once: bool,
}

impl PlantArgs {
    /// The configuration from the arguments, checked.
    ///
    /// # Errors
    /// A file or a value that cannot be used.
    pub fn configuration(&self) -> Result<Config, JobError> {
        let mut config = base(self.config.as_deref(), self.seed)?;
        let own_interface = self.fci || self.fri.is_some() || self.ur.is_some();
        if let Some(preset) = &self.preset {
            config = on_preset(config, preset)?;
        } else if own_interface && self.config.is_none() {
            config = config.on_preset(INTERFACE_PRESET);
        }
        simulated::check(&config)?;
        Ok(config)
    }
}

/// Time that the simulated hand rests at each pose, in s.
const HAND_RESTS_S: f64 = 1.7;

/// Lines of `N` numbers whose sizes are below `most`; `what` says what they are.
pub(super) fn lines<const N: usize>(path: &Path, most: f64, what: &str) -> Result<Vec<[f64; N]>, CliError> {
    let text = spherecal_model::read_text(path, 1 << 20, "numbers, with commas").map_err(CliError::input)?;
    let numbers = |(line, number): (&str, usize)| {
        let read: Option<Vec<f64>> = line.split(',').map(|cell| cell.trim().parse().ok()).collect();
        let possible = |read: &[f64; N]| read.iter().all(|x| x.abs() < most);
        let read = read.and_then(|r| <[f64; N]>::try_from(r).ok()).filter(possible);
        read.ok_or_else(|| CliError::input(format!("{}: line {number}: give {what}, with commas", path.display())))
    };
    text.lines().zip(1..).map(numbers).collect()
}

/// The arm that a simulated hand guides to the poses of a file.
pub(super) fn guided<const N: usize>(config: &Config, path: &Path) -> Result<GuidedArm<N>, CliError> {
    let poses = lines(path, 10.0, &format!("{N} joint angles in rad a line"))?;
    let model = job::loaded_model(config)?;
    GuidedArm::new(&model, &poses, HAND_RESTS_S, config.seed)
        .map_err(CliError::input)?
        .ok_or_else(|| CliError::input(format!("{}: give at least one line of angles", path.display())))
}

/// `[HOST:]PORT` of an option; a port alone is on this machine only.
pub(super) fn address(option: &str, text: &str) -> Result<SocketAddr, CliError> {
    text.parse()
        .or_else(|_| {
            text.parse()
                .map(|port: u16| SocketAddr::from((Ipv4Addr::LOCALHOST, port)))
        })
        .map_err(|_| CliError::input(format!("{option}: \"{text}\" is no address: give PORT or IP:PORT")))
}

/// `spherecal plant --fci`
pub(super) fn franka(args: &PlantArgs) -> Result<Exit, CliError> {
    let number = args.version.unwrap_or(Version::V10.number());
    let version =
        Version::from_number(number).map_err(|_| CliError::input(format!("--version {number}: give 4 to 10")))?;
    let mut config = args.configuration()?;
    if args.config.is_none() {
        version.robot().clone_into(&mut config.robot);
    }
    if BUILT_IN.contains(&config.robot.as_str()) && !Version::ROBOTS.contains(&config.robot.as_str()) {
        return Err(CliError::input(format!(
            "--fci: robot is \"{}\", which does not speak the Franka Control Interface: write robot = \"panda\" or \
             robot = \"fr3\" in the configuration, or leave --config out",
            config.robot
        )));
    }
    let mut undeclared = Undeclared::default();
    let arm: Box<dyn spherecal_fci::robot::ArmHardware> = if let Some(path) = &args.guide {
        Box::new(guided::<7>(&config, path)?)
    } else {
        let arm = simulated::robot(&config, (0.0, 0.0))?;
        undeclared = arm.undeclared();
        Box::new(arm)
    };
    let mut side = RobotConfig::new(version);
    side.address = match &args.listen {
        Some(text) => address("--listen", text)?,
        None => SocketAddr::from((Ipv4Addr::LOCALHOST, TCP_PORT)),
    };
    if args.tolerant {
        side.tolerance = Tolerance::tolerant();
    }
    warn_if_open("plant", side.address);
    let asked = side.address;
    let interrupt = interrupt()?;
    let side = start_robot(side, arm)
        .map_err(|error| CliError::input(format!("cannot listen at {asked}: {error}; is another robot running?")))?;
    side.controls().guiding.store(args.guide.is_some(), Ordering::Relaxed);
    announce(&format!(
        "Franka Control Interface, version {number} ({}), on franka:{}",
        config.robot,
        side.address()
    ));
    tell(&undeclared);
    wait(&interrupt, || ());
    let s = side.shut_down();
    errln!(
        "{} periods ({} behind the wall clock), {} commands, {} missing, {} late, {} after a stop",
        s.periods,
        s.slipped,
        s.commands,
        s.missing,
        s.late,
        s.commands_after_stop
    );
    Ok(Exit::Done)
}

/// `spherecal plant --fri`
pub(super) fn kuka(args: &PlantArgs, client: SocketAddr) -> Result<Exit, CliError> {
    if !(0.0..=5000.0).contains(&args.stiffness) {
        return Err(CliError::input("--stiffness: give 0 to 5000 N m/rad"));
    }
    if !(0.0..=3600.0).contains(&args.start_after) {
        return Err(CliError::input("--start-after: give 0 to 3600 s"));
    }
    let config = args.configuration()?;
    // As much damping as stiffness for an inertia of 1 kg m2 and Lehr's damping ratio 0.7.
    let damping = 1.4 * args.stiffness.sqrt();
    let mut undeclared = Undeclared::default();
    let arm: Box<dyn spherecal_fri::robot::ArmHardware> = if let Some(path) = &args.guide {
        Box::new(guided::<7>(&config, path)?)
    } else {
        let arm = simulated::robot(&config, (args.stiffness, damping))?;
        undeclared = arm.undeclared();
        Box::new(arm)
    };
    let mut side = CabinetConfig {
        client,
        address: args.from,
        framing: if args.framed { Framing::Framed } else { Framing::Bare },
        ..CabinetConfig::new()
    };
    let model = job::loaded_model(&config)?;
    for (limit, joint) in side.torque_limit.iter_mut().zip(&model.robot.joints) {
        *limit = joint.limits.torque_nm;
    }
    if args.tolerant {
        side.tolerance = spherecal_fri::robot::Tolerance::tolerant();
    }
    warn_if_open("plant", client);
    let interrupt = interrupt()?;
    let side = start_cabinet(side, arm).map_err(|error| CliError::job(format!("cannot send to {client}: {error}")))?;
    announce(&format!(
        "Fast Robot Interface ({}), sending to fri:{client}",
        config.robot
    ));
    tell(&undeclared);
    side.controls().guiding.store(args.guide.is_some(), Ordering::Relaxed);
    // The application: a person confirms each motion at once, but the first one when it is time.
    let mut answered: Option<Instant> = None;
    let mut without_motion = Instant::now();
    wait(&interrupt, || {
        if side.statistics().answered > 0 {
            answered.get_or_insert_with(Instant::now);
        }
        if answered.is_none_or(|since| since.elapsed().as_secs_f64() < args.start_after) {
            return;
        }
        let moving = matches!(
            side.statistics().session,
            Some(SessionState::CommandingWait | SessionState::CommandingActive)
        );
        let command = &side.controls().command;
        if moving {
            without_motion = Instant::now();
        } else if !command.load(Ordering::Relaxed) {
            command.store(true, Ordering::Relaxed);
        } else if without_motion.elapsed() > NEXT_MOTION {
            // Off and on again starts the next motion.
            command.store(false, Ordering::Relaxed);
            without_motion = Instant::now();
        }
    });
    let s = side.shut_down();
    errln!(
        "{} periods ({} behind the wall clock), {} answered, {} missing, {} late, {} torques after a stop",
        s.periods,
        s.slipped,
        s.answered,
        s.missing,
        s.late,
        s.torques_after_stop
    );
    Ok(Exit::Done)
}

/// Says what the run has to be told, because the robot does not say it over its interface.
fn tell(undeclared: &Undeclared) {
    let Undeclared {
        motor_kg_m2,
        latency_us,
    } = undeclared;
    if motor_kg_m2.iter().all(|inertia| *inertia == 0.0) && *latency_us == 0 {
        return;
    }
    let motors: Vec<f64> = motor_kg_m2
        .iter()
        .map(|inertia| (inertia * 1e4).round() / 1e4)
        .collect();
    errln!(
        "this robot has motors or a delay that its interface does not tell: the run's configuration needs\n\n[cell.drive]\n\
         motor_kg_m2 = {motors:?}\nlatency_us = {latency_us}\n"
    );
}

/// Until Ctrl-C.
pub(super) fn wait(interrupt: &AtomicBool, mut look: impl FnMut()) {
    while !interrupt.load(Ordering::Relaxed) {
        look();
        std::thread::sleep(LOOK);
    }
}
