//! Arguments that several commands share.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::out::errln;
use clap::Args;
use clap::builder::TypedValueParser;

use super::progress::Planning;
use crate::simulated::{self, SimulatedCell, SimulationError};
use spherecal_job::{self as job, Config, ConfigError, JobError, Link, PreparedRun, Simulator, TaughtWaypoints};
use spherecal_services::GuardFiles;
use spherecal_store::{Peer, StoreLocation, UnknownScheme};

/// Arguments of everything that plans or measures.
#[derive(Args, Clone, Debug)]
pub struct RunArgs {
    /// Seed of all random draws: the arm's errors, the noise, the taught waypoints.
    #[arg(long, help_heading = "Plan", value_name = "N")]
    pub seed: Option<u64>,
    /// Poses over all spheres.
    #[arg(long, help_heading = "Plan", value_name = "N", conflicts_with = "paper")]
    pub poses: Option<usize>,
    /// Mean error of the TCP that the result must surely keep, in mm. As few poses are planned as are predicted to reach it,
    /// and the run ends before the last of them once its evaluation says that it is reached.
    #[arg(long, help_heading = "Plan", value_name = "MM", conflicts_with_all = ["poses", "paper"])]
    pub accuracy_mm: Option<f64>,
    /// Use the paper's whole grid: 625 poses per sphere, as far as the arm reaches.
    #[arg(long, help_heading = "Plan")]
    pub paper: bool,
    /// Connection to controller and arm. sim: both simulated in this program. qemu: controller on
    /// an emulated board. serial:DEVICE or serial:DEVICE@BAUD: a controller board. tcp:HOST:PORT: a
    /// drive (simulator or gateway). udp:HOST:PORT: the same over UDP, in real time. franka:HOST: a Panda or FR3. fri:PORT: a KUKA LBR that sends to
    /// this port. ur:HOST: an e-Series robot, a UR20 or a UR30. controller:HOST:PORT: `spherecal controller`. grpc:HOST:PORT
    /// or grpcs:HOST:PORT: `spherecal serve`.
    #[arg(long, help_heading = "Connection", value_name = "LINK", default_value_t = Link::Sim)]
    pub link: Link,
    /// Folder of the database and of all results.
    #[arg(long, help_heading = "Results", value_name = "DIR", default_value = "spherecal-out")]
    pub out: PathBuf,
    /// Database: a file, postgres://USER@HOST/DATABASE or grpc:HOST:PORT. Default: calibration.db
    /// in --out.
    #[arg(long, help_heading = "Results", value_name = "STORE", value_parser = StoreParser)]
    pub store: Option<StoreLocation>,
    /// Laser tracker behind gRPC: grpc:HOST:PORT or grpcs:HOST:PORT. Default: a simulated one.
    #[arg(long, help_heading = "Connection", value_name = "PEER", value_parser = peer)]
    pub tracker: Option<Peer>,
    /// Name of this arm (its serial number), for history and trend.
    #[arg(long, help_heading = "Results", value_name = "NAME")]
    pub arm: Option<String>,
    /// Configuration file. It needs only the fields that differ from the defaults (`spherecal
    /// config --print` shows all).
    #[arg(long, help_heading = "Plan", value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Robot: a built-in name (`spherecal robot list`), or a .toml or .urdf file. It replaces that of the
    /// configuration.
    #[arg(long, help_heading = "Plan", value_name = "NAME|FILE")]
    pub robot: Option<String>,
    /// Errors of the simulated arm: a preset, instead of the one that the configuration names. Other fields of its
    /// `[plant]` stay. as_measured (the default) is as hard to calibrate as real arms, typical is three times easier.
    #[arg(long, help_heading = "Plan", value_name = "PRESET")]
    pub preset: Option<String>,
    /// Start the descents at the waypoints that `spherecal teach` wrote.
    #[arg(long, help_heading = "Plan", value_name = "FILE.toml")]
    pub waypoints: Option<PathBuf>,
    /// Inject faults: a preset (`human_push`; a wrong name lists all) or a file (`spherecal-lab faults
    /// --show PRESET` prints one).
    #[arg(long, help_heading = "Connection", value_name = "FILE.toml|PRESET")]
    pub inject: Option<String>,
    /// Continue the last run in --out at the pose where it stopped. With --accuracy-mm also a run that ended because a
    /// worse accuracy was reached.
    #[arg(long, help_heading = "Results", conflicts_with_all = ["poses", "paper", "config", "robot", "seed", "preset", "waypoints"])]
    pub resume: bool,
    /// Show the run on a web page while it lasts. A port alone serves this machine only; port 0
    /// takes any free port.
    #[arg(long, help_heading = "Viewers", value_name = "[HOST:]PORT")]
    pub serve: Option<String>,
    /// Protection of --serve.
    #[command(flatten)]
    pub protection: ProtectionArgs,
    /// Show the run on the page of a `spherecal serve`: grpc:HOST:PORT or grpcs:HOST:PORT. Not
    /// needed if --store or --link is that server.
    #[arg(long, help_heading = "Viewers", value_name = "PEER", value_parser = peer)]
    pub publish: Option<Peer>,
    /// Print one JSON document on stdout and nothing else.
    #[arg(long, help_heading = "Results")]
    pub json: bool,
}

/// Files that protect a server that other machines can reach.
#[derive(Args, Clone, Debug, Default)]
pub struct ProtectionArgs {
    /// Certificate chain, PEM: clients then use grpcs, and browsers https.
    #[arg(long, help_heading = "Protection of a server", value_name = "FILE.pem")]
    pub tls_cert: Option<PathBuf>,
    /// Private key of the certificate, PEM.
    #[arg(long, help_heading = "Protection of a server", value_name = "FILE.pem")]
    pub tls_key: Option<PathBuf>,
    /// File with the token that clients must show. A client reads its token from SPHERECAL_TOKEN;
    /// the page asks for it.
    #[arg(long, help_heading = "Protection of a server", value_name = "FILE")]
    pub token_file: Option<PathBuf>,
}

impl ProtectionArgs {
    /// The files, as a server takes them.
    pub fn files(&self) -> GuardFiles {
        GuardFiles {
            certificate: self.tls_cert.clone(),
            key: self.tls_key.clone(),
            token: self.token_file.clone(),
        }
    }
}

/// The configuration from a file, or the defaults; `seed` replaces the seed.
pub(super) fn base(file: Option<&Path>, seed: Option<u64>) -> Result<Config, JobError> {
    let mut config = file.map(Config::read).transpose()?.unwrap_or_default();
    if let Some(seed) = seed {
        config.seed = seed;
    }
    Ok(config)
}

/// The configuration with the errors of a preset, except those that its `[plant]` states itself.
/// Errors: an unknown preset, or one that leaves the arm as it is, because `[plant]` states every field.
pub(super) fn on_preset(config: Config, preset: &str) -> Result<Config, JobError> {
    let before = simulated::plant(&config)?;
    let named = config.plant.get("preset").and_then(|name| name.as_str()) == Some(preset);
    let config = config.on_preset(preset);
    if !named && simulated::plant(&config)? == before {
        return Err(SimulationError::Section(format!(
            "--preset {preset} changes nothing: [plant] of the configuration states every field; leave --preset out, or remove \
             the fields that the preset shall set"
        ))
        .into());
    }
    Ok(config)
}

impl RunArgs {
    /// The configuration from the arguments, checked.
    ///
    /// # Errors
    /// A file or a value that cannot be used.
    pub fn configuration(&self) -> Result<Config, JobError> {
        let mut config = base(self.config.as_deref(), self.seed)?;
        if let Some(robot) = &self.robot {
            config.robot.clone_from(robot);
        }
        if let Some(preset) = &self.preset {
            config = on_preset(config, preset)?;
        }
        // Without a configuration, a robot that tells which one it is decides.
        if self.config.is_none()
            && self.robot.is_none()
            && let Some(robot) = self.link.robot()?
        {
            robot.clone_into(&mut config.robot);
        }
        if let Some(poses) = self.poses {
            if poses == 0 {
                return Err(ConfigError::Range {
                    field: "--poses",
                    value: 0.0,
                    remedy: "give at least 1, or use --paper",
                }
                .into());
            }
            config.plan.poses = poses;
            config.plan.paper = false;
            config.plan.accuracy_mm = None;
        }
        if self.accuracy_mm.is_some() {
            config.plan.accuracy_mm = self.accuracy_mm;
            config.plan.paper = false;
        }
        if self.paper {
            config.plan.paper = true;
        }
        if let Some(arm) = &self.arm {
            config.arm.clone_from(arm);
        }
        simulated::check(&config)?;
        Ok(config)
    }

    /// The plan of that configuration, with the taught waypoints.
    ///
    /// # Errors
    /// Any error in the input.
    pub fn prepare(&self) -> Result<PreparedRun, JobError> {
        self.prepare_from(&self.configuration()?, SimulatedCell::sound())
    }

    /// The same of a configuration that was read before. A robot that says which one it is takes one client at a time:
    /// it cannot be asked again while it is connected.
    ///
    /// # Errors
    /// Any error in the input.
    pub fn prepare_from(&self, config: &Config, simulator: Arc<dyn Simulator>) -> Result<PreparedRun, JobError> {
        let planning = Planning::show(self.json);
        let mut prepared = job::prepare(config, simulator)?;
        drop(planning);
        if let Some(path) = &self.waypoints {
            let waypoints = TaughtWaypoints::read(path)?;
            waypoints.apply(&prepared.robot, &prepared.tool, &mut prepared.plan)?;
            prepared.untaught = None;
        }
        Ok(prepared)
    }

    /// The database.
    pub fn database(&self) -> StoreLocation {
        database(self.store.as_ref(), &self.out)
    }

    /// The server whose page shows the run.
    pub fn shown_by(&self) -> Option<Peer> {
        let store = match &self.store {
            Some(StoreLocation::Service(peer)) => Some(peer),
            _ => None,
        };
        let link = match &self.link {
            Link::Grpc(peer) => Some(peer),
            _ => None,
        };
        self.publish.as_ref().or(store).or(link).cloned()
    }
}

/// The given store, or the file in the output folder.
fn database(store: Option<&StoreLocation>, out: &std::path::Path) -> StoreLocation {
    store
        .cloned()
        .unwrap_or_else(|| StoreLocation::File(out.join("calibration.db")))
}

/// `grpc:HOST:PORT` or `grpcs:HOST:PORT`.
fn peer(text: &str) -> Result<Peer, BadValue> {
    Peer::parse(text).ok_or(BadValue("give grpc:HOST:PORT or grpcs:HOST:PORT"))
}

/// Reads `--store`. An unusable value is not repeated: it may hold a password.
#[derive(Clone, Copy, Debug)]
pub(super) struct StoreParser;

impl TypedValueParser for StoreParser {
    type Value = StoreLocation;

    fn parse_ref(
        &self,
        command: &clap::Command,
        _: Option<&clap::Arg>,
        value: &std::ffi::OsStr,
    ) -> Result<StoreLocation, clap::Error> {
        let refuse = |why: String| {
            clap::Error::raw(clap::error::ErrorKind::ValueValidation, format!("--store: {why}\n")).with_cmd(command)
        };
        let text = value
            .to_str()
            .ok_or_else(|| refuse("the value is not UTF-8".to_owned()))?;
        let place: StoreLocation = text
            .parse()
            .map_err(|unknown: UnknownScheme| refuse(unknown.to_string()))?;
        if place.has_password() {
            errln!(
                "spherecal: warning: other users of this computer can read the password of --store in the list of \
                 processes: put it into PGPASSWORD or ~/.pgpass, and leave it out of the address"
            );
        }
        Ok(place)
    }
}

/// Says what to give instead of an argument's unusable value.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("{0}")]
pub(super) struct BadValue(pub(super) &'static str);

/// Arguments of what works on a stored run.
#[derive(Args, Clone, Debug)]
pub struct StoredArgs {
    /// Folder of the database and of all results.
    #[arg(long, value_name = "DIR", default_value = "spherecal-out")]
    pub out: PathBuf,
    /// Database: a file, postgres://USER@HOST/DATABASE or grpc:HOST:PORT. Default: calibration.db
    /// in --out.
    #[arg(long, value_name = "STORE", value_parser = StoreParser)]
    pub store: Option<StoreLocation>,
    /// Arm whose last run is meant. Required in a database that several robots share.
    #[arg(long, value_name = "NAME", default_value = "")]
    pub arm: String,
    /// Print one JSON document on stdout and nothing else.
    #[arg(long)]
    pub json: bool,
}

impl StoredArgs {
    /// The database.
    pub fn database(&self) -> StoreLocation {
        database(self.store.as_ref(), &self.out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if --preset drops what the configuration says of the arm, or if a preset that changes nothing passes in
    // silence.
    #[test]
    fn a_preset_keeps_what_the_configuration_says() {
        let read = |text: &str| Config::parse("cell.toml", text).expect("a configuration");
        let own = read("[plant]\npreset = \"harsh\"\n[plant.friction]\ncoulomb_nm = [1.5, 1.5]\n");
        let plant = |config: &Config| simulated::plant(config).expect("a plant");
        let typical = plant(&Config::default().on_preset("typical"));
        let plant = plant(&on_preset(own, "typical").expect("both"));
        assert_eq!(plant.friction.coulomb_nm, [1.5, 1.5]);
        assert_ne!(typical.friction.coulomb_nm, [1.5, 1.5]);
        assert_eq!(plant.elasticity, typical.elasticity);
        let whole = crate::cli::document::documented(&Config::default()).expect("a text");
        let refused = on_preset(read(&whole), "typical")
            .expect_err("it states everything")
            .to_string();
        assert!(refused.contains("--preset typical changes nothing"), "{refused}");
        on_preset(read(""), "as_measured").expect("the default, named");
    }
}
