//! `spherecal serve`: robot, laser tracker and database as network services, and
//! the web page.
//!
//! It prints one line on stdout as soon as it listens, with the address, so
//! that a script can wait for it; everything else goes to stderr. Ctrl-C ends it.

use std::io::Write as _;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use clap::{Args, ValueEnum};

use super::args::ProtectionArgs;
use super::exit::{CliError, Exit};
use super::out::errln;
use super::run::interrupt;
use crate::job::{self, Config, Link, Prepared};
use crate::link::LinkError;
use crate::rpc::{Offer, RobotFacts, Server};
use crate::store::{Place, Store};
use crate::web::Page;

/// What may be served.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Service {
    /// `RobotController`.
    Robot,
    /// `LaserTracker`.
    Tracker,
    /// `CalibrationStore`.
    Store,
    /// The web page, and `LiveView`; past calibrations are on it where the store is served.
    Page,
}

/// Arguments of `serve`.
#[derive(Args, Clone, Debug)]
pub struct ServeArgs {
    /// Where clients connect; a port alone is on this machine only, 0 takes any.
    #[arg(long, value_name = "[HOST:]PORT", default_value = "7403")]
    pub grpc: String,
    /// What is served: robot, tracker, store, page; all of them if nothing is said.
    #[arg(long, value_name = "SERVICE", value_delimiter = ',')]
    pub service: Vec<Service>,
    /// What stands behind the robot: sim, qemu, tcp:HOST:PORT or controller:HOST:PORT.
    #[arg(long, value_name = "LINK", default_value_t = Link::Sim)]
    pub link: Link,
    /// Database that is served: a file or postgres://USER@HOST/DATABASE;
    /// calibration.db in --out if none is given.
    #[arg(long, value_name = "STORE")]
    pub store: Option<Place>,
    /// Folder of the database.
    #[arg(long, value_name = "DIR", default_value = "spherecal-out")]
    pub out: PathBuf,
    /// Seed of the simulated arm's errors and noise: that of the run, for the same arm.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Configuration of the run, for the same arm and plate.
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    #[command(flatten)]
    pub protection: ProtectionArgs,
}

impl ServeArgs {
    fn serves(&self, service: Service) -> bool {
        self.service.is_empty() || self.service.contains(&service)
    }

    fn prepare(&self) -> Result<Prepared, CliError> {
        let mut config = match &self.config {
            Some(path) => Config::read(path)?,
            None => Config::default(),
        };
        if let Some(seed) = self.seed {
            config.seed = seed;
        }
        // The plan is the client's affair; a small one tells where home is.
        config.plan = job::PlanSection {
            poses: 6,
            paper: false,
            accuracy_mm: None,
            choice: job::Choice::Grid,
            ..config.plan
        };
        Ok(job::prepare(&config)?)
    }
}

/// `spherecal serve`
pub(super) fn run(args: &ServeArgs) -> Result<Exit, CliError> {
    let interrupted = interrupt()?;
    if matches!(args.link, Link::Grpc(_)) {
        return Err(CliError::input(
            "a service behind a service is not served: give clients the address of the first",
        ));
    }
    let mut offer = Offer::default();
    if args.serves(Service::Robot) || args.serves(Service::Tracker) {
        let prepared = Arc::new(args.prepare()?);
        if args.serves(Service::Robot) {
            offer.robot = Some(robot(args, &prepared));
        }
        if args.serves(Service::Tracker) {
            let sigma_m = prepared.plant.tracker.sigma_m;
            let prepared = Arc::clone(&prepared);
            offer.tracker = Some((Box::new(move || job::simulated_tracker(&prepared)), sigma_m));
        }
    }
    if args.serves(Service::Store) {
        let file = Place::File(args.out.join("calibration.db"));
        let store = Store::at(args.store.as_ref().unwrap_or(&file), true)?;
        offer.store = Some(Arc::new(Mutex::new(store)));
    }
    if args.serves(Service::Page) {
        let page = Page {
            store: offer.store.clone(),
            ..Page::default()
        };
        offer.page = Some((page, true));
    }
    let server = Server::start(&args.grpc, &args.protection.files(), offer)?;
    let scheme = if server.is_encrypted() { "grpcs" } else { "grpc" };
    let mut out = std::io::stdout().lock();
    // A reader that has gone does not matter to a server.
    let _ = writeln!(out, "services on {scheme}:{}", server.address()).and_then(|()| out.flush());
    drop(out);
    if args.serves(Service::Page) {
        errln!("page on {}", server.page_url());
    }
    while !interrupted.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_millis(50));
    }
    drop(server);
    Ok(Exit::Done)
}

fn robot(args: &ServeArgs, prepared: &Arc<Prepared>) -> (RobotFacts, crate::rpc::DeviceFactory) {
    let facts = RobotFacts {
        robot: prepared.robot.clone(),
        tool: prepared.tool,
        procedure: prepared.config.procedure,
        home: prepared.plan.home.joints.clone(),
    };
    let (prepared, link, folder) = (Arc::clone(prepared), args.link.clone(), args.out.clone());
    let make = move || {
        job::device(&prepared, &link, &folder).map_err(|error| match error {
            job::JobError::Link(error) => error,
            other => LinkError::Drive(other.to_string()),
        })
    };
    (facts, Box::new(make))
}
