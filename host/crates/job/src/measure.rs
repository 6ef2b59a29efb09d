//! Runs the campaign over a link into the store, and reads the recordings back.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::channel;
use std::time::Instant;

use spherecal_campaign::{self as campaign, Assignment, CampaignObserver, Outcome, Tracker, measure_laser};
use spherecal_link::Device;
use spherecal_plan::Plan;
use spherecal_store::time::now_utc;
use spherecal_store::{CalibrationStore, NewRun, Peer, RunInfo, SessionEnd, StoredPose};

use super::accuracy::StoredAccuracy;
use super::early_end::EarlyEnd;
use super::journal::{REPEATED_SESSION, StoreJournal, run_key};
use super::link::{Link, LinkRecord};
use super::{Config, ConnectedDevice, Connection, JobError, Measurements, PreparedRun};

/// Where and with whom a campaign is run.
pub struct Site<'a> {
    /// The link.
    pub link: &'a Link,
    /// A laser tracker behind gRPC. If none, the simulated tracker of a plant in this process.
    pub tracker: Option<&'a Peer>,
    /// Folder for logs of the controller; it exists.
    pub folder: &'a Path,
    /// Where it is stored.
    pub store: &'a mut dyn CalibrationStore,
    /// Who watches.
    pub observer: &'a mut dyn CampaignObserver,
    /// Set to stop.
    pub interrupt: &'a AtomicBool,
    /// The device, if [`connect_early`](crate::connect_early) has connected it.
    pub device: Option<Box<dyn Device>>,
}
/// What was measured.
#[derive(Clone, Debug)]
pub struct MeasuredRun {
    /// Number of the run in the store.
    pub run: i64,
    /// What this session came to.
    pub outcome: Outcome,
}

/// Runs the campaign, and then the laser measurements. With `resume` it continues a run: on the
/// same arm if the arm lives on, or by repeating the run from its start if the arm was simulated in
/// a process that has ended.
///
/// # Errors
/// Any error that stops the campaign. The recordings made until then are in the store.
pub fn measure(prepared: &PreparedRun, site: Site<'_>, resume: Option<&RunInfo>) -> Result<MeasuredRun, JobError> {
    let begun = Instant::now();
    let repeats = site.link.simulated();
    if let Link::Fri(address) = site.link {
        site.observer.note(&format!(
            "waiting for the cabinet at UDP port {}: start the application on the cabinet",
            address.port()
        ));
    }
    let connection = Connection {
        link: site.link,
        folder: site.folder,
        early: site.device,
        repeated: resume.is_some() && repeats,
        in_file: site.store.is_file(),
    };
    let ConnectedDevice {
        mut device,
        journal: faulty,
        injected,
    } = prepared.simulator.connect(prepared, connection)?;
    let device = device.as_mut();
    let prepared = &*prepared.for_arm(device.simulated());
    let plan = &prepared.plan;
    let had = resume
        .map(|info| site.store.read_run(info.run))
        .transpose()?
        .unwrap_or_default();
    let (run, done, seated) = match resume {
        Some(info) if repeats => (info.run, BTreeSet::new(), Vec::new()),
        Some(info) => (info.run, had.done(), had.couplings.clone()),
        None => (
            create_run(prepared, site.link, site.store)?,
            BTreeSet::new(),
            Vec::new(),
        ),
    };
    let key = match resume {
        Some(info) => Some(run_key(info)),
        None => site.store.last_run()?.as_ref().map(run_key),
    };
    if let Some(key) = key {
        site.observer.run(&key);
    }
    let repeated = repeats && had.sessions.len() as i64 >= REPEATED_SESSION;
    let session = if repeated {
        REPEATED_SESSION
    } else {
        site.store.begin_session(run, &now_utc())?
    };
    let path = site.store.path().to_owned();
    let mut so_far = Measurements::before(prepared, site.link);
    if resume.is_some() && !repeats {
        so_far.recordings.clone_from(&had.recordings);
        so_far.couplings.clone_from(&had.couplings);
        so_far.faults.clone_from(&had.faults);
    }
    let (told, stored) = channel();
    let mut journal = if repeated {
        site.observer.note(&format!(
            "the simulated arm starts from the beginning: the run is repeated, and its first {} recordings must come out the same",
            had.recordings.len()
        ));
        StoreJournal::repeated(site.store, run, &had.recordings)
    } else {
        StoreJournal::live(site.store, run, session, had.handshakes)
    }
    .telling(told);
    let mut observer = EarlyEnd::new(site.observer, stored, so_far);
    let assignment = Assignment {
        robot: &prepared.robot,
        tool: &prepared.tool,
        procedure: &site.link.adapt(prepared.procedure()?),
        plan,
        done: &done,
        seated: &seated,
        options: prepared.config.campaign.options(),
    };
    let (outcome, result) = match faulty {
        None => campaign::run(&assignment, device, &mut journal, &mut observer, site.interrupt),
        Some(faulty) => {
            let mut journal = faulty(&mut journal, path);
            campaign::run(&assignment, device, journal.as_mut(), &mut observer, site.interrupt)
        }
    };
    let ended_early = observer.ended();
    let passed_over = journal.passed_over();
    if passed_over > 0 {
        site.observer.note(&format!(
            "the controller still held {passed_over} events of another run: they were skipped"
        ));
    }
    if result.is_ok() {
        journal.finish()?;
    }
    drop(journal);
    let end = SessionEnd {
        firmware: outcome.firmware.clone(),
        simulated_us: outcome.simulated_us,
        ticks: outcome.ticks,
        wall_s: begun.elapsed().as_secs_f64(),
        link_json: json(&LinkRecord {
            ends: [outcome.link, outcome.statistics.link],
            injected: injected(),
            late: outcome.statistics.late,
            drive: outcome.drive,
            simulated: outcome.statistics.simulated,
        })?,
        telemetry_json: json(&outcome.telemetry)?,
    };
    let ended = site.store.end_session(run, session, &end);
    // What ended the campaign is told, not what follows from it.
    result?;
    ended?;
    if prepared.config.laser.enabled {
        let tracker: Option<Box<dyn Tracker>> = match site.tracker {
            Some(peer) => Some(remote_tracker(peer)?),
            None if site.link.simulated() => Some(prepared.simulator.tracker(prepared)?),
            None => None,
        };
        if let Some(mut tracker) = tracker {
            let shots = measure_laser(&prepared.robot, &prepared.tool, prepared.config.seed, tracker.as_mut())?;
            site.store.put_laser(run, &shots)?;
        }
    }
    StoredAccuracy::end(site.store, run, ended_early)?;
    site.store.set_state(run, "measured")?;
    Ok(MeasuredRun { run, outcome })
}

/// Checks that a laser tracker answers at `peer`: it is needed only when the campaign has ended.
///
/// # Errors
/// Nothing answers there, or this program was built without the feature `services`.
pub fn check_tracker(peer: &Peer) -> Result<(), JobError> {
    remote_tracker(peer).map(drop)
}

#[cfg(feature = "services")]
fn remote_tracker(peer: &Peer) -> Result<Box<dyn Tracker>, JobError> {
    Ok(Box::new(spherecal_services::grpc::RemoteTracker::connect(peer)?))
}

#[cfg(not(feature = "services"))]
fn remote_tracker(_peer: &Peer) -> Result<Box<dyn Tracker>, JobError> {
    Err(JobError::Feature {
        what: "a laser tracker behind gRPC (--tracker)",
        feature: "services",
    })
}

/// Stores a new run with its preparation and link. Returns its number.
///
/// # Errors
/// When the store fails.
pub fn create_run(prepared: &PreparedRun, link: &Link, store: &mut dyn CalibrationStore) -> Result<i64, JobError> {
    let poses = prepared
        .plan
        .spheres
        .iter()
        .flat_map(|visit| visit.poses.iter().filter(|p| !p.via).map(|p| (visit.sphere_id, p)))
        .map(|(sphere, pose)| StoredPose {
            sphere,
            pose: pose.id,
            orientation: pose.orientation,
            elbow_rad: pose.elbow_rad,
        })
        .collect();
    Ok(store.create_run(&NewRun {
        created_utc: now_utc(),
        seed: prepared.config.seed,
        link: link.to_string(),
        robot: prepared.robot.clone(),
        tool: prepared.tool,
        config_toml: prepared.config.to_toml()?,
        plan_json: json(&prepared.plan)?,
        program: concat!("spherecal ", env!("CARGO_PKG_VERSION")).to_owned(),
        spheres: prepared.spheres.clone(),
        poses,
        arm: prepared.config.arm.clone(),
    })?)
}

/// Reads back all measurements of a run.
///
/// # Errors
/// When the database fails or a value does not decode.
pub fn read(store: &mut dyn CalibrationStore, info: &RunInfo) -> Result<Measurements, JobError> {
    let undecodable = |what: &'static str| {
        move |e: serde_json::Error| JobError::Encode {
            what,
            message: format!("{e}; it was written by another version"),
        }
    };
    let mut config = Config::stored(&info.about.config_toml)?;
    let accuracy = StoredAccuracy::read(store, info.run)?;
    config.plan.accuracy_mm = accuracy.asked_mm(config.plan.accuracy_mm);
    let plan: Plan = serde_json::from_str(&info.about.plan_json).map_err(undecodable("the stored plan"))?;
    let stored = store.read_run(info.run)?;
    let mut link = LinkRecord::default();
    for session in &stored.sessions {
        link.add(&LinkRecord::stored(&session.link_json));
    }
    Ok(Measurements {
        seed: info.about.seed,
        link_name: info.about.link.clone(),
        robot: info.about.robot.clone(),
        tool: info.about.tool,
        config,
        plan,
        spheres: stored.spheres,
        recordings: stored.recordings,
        rejected: stored.rejected,
        contacts: stored.contacts,
        couplings: stored.couplings,
        faults: stored.faults,
        laser: stored.laser,
        ended_early: accuracy.ended,
        link,
        simulated_s: stored.sessions.iter().map(|s| s.simulated_us as f64 * 1e-6).sum(),
        wall_s: stored.sessions.iter().map(|s| s.wall_s).sum(),
    })
}

fn json(value: &impl serde::Serialize) -> Result<String, JobError> {
    serde_json::to_string(value).map_err(|e| JobError::Encode {
        what: "a record for the database",
        message: e.to_string(),
    })
}
