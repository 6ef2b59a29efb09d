//! `spherecal serve`: robot, laser tracker and database as network services, and the web page.
//!
//! As soon as it listens, it prints one line with the address on stdout, so that a script can wait
//! for it. Everything else goes to stderr. Ctrl-C ends it.

use std::io::Write as _;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use clap::{Args, ValueEnum};

use super::args::ProtectionArgs;
use super::exit::{CliError, Exit, interrupt};
use super::features;
use super::live_output::stored_reports;
use super::out::errln;
use spherecal_job::{Link, open_store};
use spherecal_services::web::Page;
use spherecal_services::{Offer, Server, SharedStore};
use spherecal_store::StoreLocation;

/// What may be served.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Service {
    /// `RobotController`.
    Robot,
    /// `LaserTracker`.
    Tracker,
    /// `CalibrationStore`.
    Store,
    /// The web page, and `LiveView`. The page shows past calibrations if the store is served.
    Page,
}

/// Arguments of `serve`.
#[derive(Args, Clone, Debug)]
pub struct ServeArgs {
    /// Address for clients. A port alone serves this machine only; port 0 takes any free port.
    #[arg(long, value_name = "[HOST:]PORT", default_value = "7403")]
    pub grpc: String,
    /// What to serve: robot, tracker, store, page. Default: all of them.
    #[arg(long, value_name = "SERVICE", value_delimiter = ',')]
    pub service: Vec<Service>,
    /// Connection to the robot: sim, qemu, tcp:HOST:PORT or controller:HOST:PORT.
    #[arg(long, value_name = "LINK", default_value_t = Link::Sim)]
    pub link: Link,
    /// Database to serve: a file or postgres://USER@HOST/DATABASE. Default: calibration.db in
    /// --out.
    #[arg(long, value_name = "STORE", value_parser = super::args::StoreParser)]
    pub store: Option<StoreLocation>,
    /// Folder of the database.
    #[arg(long, value_name = "DIR", default_value = "spherecal-out")]
    pub out: PathBuf,
    /// Seed of the simulated arm's errors and noise. Use the run's seed for the same arm.
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

    /// The database that is served or shown.
    fn open_store(&self) -> Result<SharedStore, CliError> {
        let file = StoreLocation::File(self.out.join("calibration.db"));
        let store = open_store(self.store.as_ref().unwrap_or(&file), true)?;
        Ok(Arc::new(Mutex::new(store)))
    }
}

pub(super) fn run(args: &ServeArgs) -> Result<Exit, CliError> {
    features::check_link(&args.link)?;
    features::check_store(args.store.as_ref())?;
    features::check_protection(&args.protection)?;
    let interrupted = interrupt()?;
    if matches!(args.link, Link::Grpc(_)) {
        return Err(CliError::input(
            "--link or --store names another service, which cannot be served again: give clients its own address",
        ));
    }
    let mut offer = Offer::default();
    services(args, &mut offer)?;
    let store = if args.serves(Service::Store) {
        Some(args.open_store()?)
    } else {
        None
    };
    #[cfg(feature = "services")]
    offer.store.clone_from(&store);
    if args.serves(Service::Page) {
        let page = Page {
            store,
            report: Some(stored_reports()),
            ..Page::default()
        };
        offer.page = Some((page, true));
    }
    let server = Server::start(&args.grpc, &args.protection.files(), offer)?;
    let scheme = if server.is_encrypted() { "grpcs" } else { "grpc" };
    let mut out = std::io::stdout().lock();
    // A reader that closed the pipe does not matter to a server.
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

/// Adds robot and tracker, if requested.
#[cfg(not(feature = "services"))]
fn services(args: &ServeArgs, _offer: &mut Offer) -> Result<(), CliError> {
    if args.service.iter().any(|service| *service != Service::Page) {
        return Err(CliError::feature(
            "serving robot, tracker or store (--service)",
            "services",
        ));
    }
    if args.service.is_empty() {
        errln!("serving only the page: robot, tracker and store need the feature `services`");
    }
    Ok(())
}

#[cfg(feature = "services")]
use services::services;

#[cfg(feature = "services")]
mod services {
    use std::sync::Arc;

    use spherecal_campaign::TrackerError;
    use spherecal_job::connect::device;
    use spherecal_job::{Choice, JobError, PlanSection, PreparedRun};
    use spherecal_link::LinkError;
    use spherecal_services::Offer;
    use spherecal_services::grpc::{DeviceFactory, RobotFacts};

    use crate::simulated::{plant, prepare};

    use super::super::args::base;
    use super::{CliError, ServeArgs, Service};

    /// Adds robot and tracker, if requested.
    pub(super) fn services(args: &ServeArgs, offer: &mut Offer) -> Result<(), CliError> {
        if args.serves(Service::Robot) || args.serves(Service::Tracker) {
            let prepared = Arc::new(prepared(args)?);
            if args.serves(Service::Robot) {
                offer.robot = Some(robot(args, &prepared));
            }
            if args.serves(Service::Tracker) {
                let sigma_m = plant(&prepared.config).map_err(JobError::from)?.tracker.sigma_m;
                let prepared = Arc::clone(&prepared);
                let make = move || {
                    prepared
                        .simulator
                        .tracker(&prepared)
                        .map_err(|error| TrackerError::Device {
                            input: error.is_input(),
                            source: Box::new(error),
                        })
                };
                offer.tracker = Some((Box::new(make), sigma_m));
            }
        }
        Ok(())
    }

    fn prepared(args: &ServeArgs) -> Result<PreparedRun, CliError> {
        let mut config = base(args.config.as_deref(), args.seed)?;
        // The client makes the plan; a small one here gives the home position.
        config.plan = PlanSection {
            poses: 6,
            paper: false,
            accuracy_mm: None,
            choice: Choice::Grid,
            ..config.plan
        };
        Ok(prepare(&config)?)
    }

    fn robot(args: &ServeArgs, prepared: &Arc<PreparedRun>) -> (RobotFacts, DeviceFactory) {
        let facts = RobotFacts {
            robot: prepared.robot.clone(),
            tool: prepared.tool,
            procedure: prepared.config.procedure,
            home: prepared.plan.home.joints.clone(),
        };
        let (prepared, link, folder) = (Arc::clone(prepared), args.link.clone(), args.out.clone());
        let make = move || {
            device(&prepared, &link, &folder).map_err(|error| match error {
                JobError::Link(error) => error,
                other => LinkError::Device {
                    input: other.is_input(),
                    source: Box::new(other),
                },
            })
        };
        (facts, Box::new(make))
    }
}
