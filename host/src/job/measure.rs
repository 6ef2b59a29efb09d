//! Measuring: the campaign over a link, into the store; and reading it back.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};
use spherecal_shared::protocol::frame::LinkCounters;

use super::journal::{REPEATED_SESSION, StoreJournal};
use super::laser::{Tracker, measure_laser, simulated_tracker};
use super::link::{Link, upset_device};
use super::{Config, JobError, Measurements, Prepared, tour};
use crate::campaign::{self, Assignment, CampaignError, Observer, Outcome};
use crate::inject;
use crate::link::{Injected, LinkError};
use crate::plan::Plan;
use crate::rpc::{Peer, RemoteTracker};
use crate::store::{NewRun, PlannedPose, RunInfo, SessionEnd, Store};

/// Where and with whom a campaign is run.
pub struct Site<'a> {
    /// The link.
    pub link: &'a Link,
    /// A laser tracker behind gRPC; the plant's own, where the plant is here, if none.
    pub tracker: Option<&'a Peer>,
    /// Folder for logs of the controller; it exists.
    pub folder: &'a Path,
    /// Where it is stored.
    pub store: &'a mut Store,
    /// Who watches.
    pub observer: &'a mut dyn Observer,
    /// Set to stop.
    pub interrupt: &'a AtomicBool,
    /// What is to go wrong; nothing but the real where there is none.
    pub inject: Option<&'a inject::Plan>,
}
/// What was measured.
#[derive(Clone, Debug)]
pub struct Measured {
    /// Number of the run in the store.
    pub run: i64,
    /// What this session came to.
    pub outcome: Outcome,
}

/// Runs the campaign, and the laser reference after it; goes on with `resume`
/// where it is given: where the arm is, if it lives on, or by repeating the run
/// from its start, if the arm was simulated in the process that ended.
///
/// # Errors
/// Whatever stops it. What was recorded until then is in the store.
pub fn measure(prepared: &Prepared, site: Site<'_>, resume: Option<&RunInfo>) -> Result<Measured, JobError> {
    let begun = Instant::now();
    let tour = tour(&prepared.plan);
    if let Some(plan) = site.inject.filter(|_| !site.store.is_file()) {
        plan.check_without_file()?;
    }
    let repeats = site.link.simulated();
    // A run that is repeated goes past the moment at which its host was killed.
    let inject = site.inject.map(|plan| match resume {
        Some(_) if repeats => plan.without_kills(),
        _ => plan.clone(),
    });
    let (mut device, ailing) = upset_device(prepared, site.link, site.folder, inject.as_ref())?;
    let (run, done, seated) = match resume {
        Some(info) if repeats => (info.run, BTreeSet::new(), Vec::new()),
        Some(info) => {
            let had = site.store.resumable(info.run)?;
            let done = had.recorded.union(&had.rejected).copied().collect();
            (info.run, done, site.store.couplings(info.run)?)
        }
        None => (
            create_run(prepared, site.link, site.store)?,
            BTreeSet::new(),
            Vec::new(),
        ),
    };
    let repeated = repeats && site.store.sessions(run)?.len() as i64 >= REPEATED_SESSION;
    let session = if repeated {
        REPEATED_SESSION
    } else {
        site.store.begin_session(run, &now_utc())?
    };
    let mut journal = if repeated {
        let stored = site.store.resumable(run)?.recorded.len();
        site.observer.note(&format!(
            "the simulated arm begins anew: the run is repeated, and its first {stored} recordings must come out the same"
        ));
        StoreJournal::repeated(site.store, run)?
    } else {
        StoreJournal::live(site.store, run, session)?
    }
    .suffering(ailing);
    let assignment = Assignment {
        robot: &prepared.robot,
        tool: &prepared.tool,
        procedure: &prepared.procedure()?,
        tour: &tour,
        done: &done,
        seated: &seated,
        options: prepared.config.campaign.options(),
    };
    let (outcome, result) = campaign::run(
        &assignment,
        device.as_mut(),
        &mut journal,
        site.observer,
        site.interrupt,
    );
    if matches!(result, Err(CampaignError::Link(LinkError::Killed))) {
        die();
    }
    let passed_over = journal.passed_over();
    if passed_over > 0 {
        site.observer.note(&format!(
            "the controller still held {passed_over} events of another run: they were passed over"
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
            injected: outcome.injected,
            late: outcome.statistics.late,
        })?,
        telemetry_json: json(&outcome.telemetry)?,
    };
    site.store.end_session(run, session, &end)?;
    result?;
    if prepared.config.laser.enabled {
        let tracker: Option<Box<dyn Tracker>> = match site.tracker {
            Some(peer) => Some(Box::new(RemoteTracker::connect(peer)?)),
            None if site.link.simulated() => Some(simulated_tracker(prepared)?),
            None => None,
        };
        if let Some(mut tracker) = tracker {
            let shots = measure_laser(prepared, tracker.as_mut())?;
            site.store.put_laser(run, &shots)?;
        }
    }
    site.store.set_state(run, "measured")?;
    Ok(Measured { run, outcome })
}

/// Ends this process as `kill -9` does: nothing is closed, flushed or told.
fn die() {
    #[cfg(unix)]
    // It cannot be refused to a process that kills itself.
    let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::KILL);
    #[cfg(not(unix))]
    std::process::abort();
}
/// What the two ends of the host link counted in a session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkRecord {
    /// What the host received, and what the controller did.
    pub ends: [LinkCounters; 2],
    /// What was done to frames on purpose.
    #[serde(default)]
    pub injected: Injected,
    /// Commands that came after their start.
    #[serde(default)]
    pub late: u32,
}

impl LinkRecord {
    /// As it stands in the database; a session that was killed has told nothing.
    fn stored(text: &str) -> Self {
        serde_json::from_str(text)
            .or_else(|_| {
                // The counters alone, as the first versions wrote them.
                serde_json::from_str(text).map(|ends| Self {
                    ends,
                    ..Self::default()
                })
            })
            .unwrap_or_default()
    }

    fn add(&mut self, other: &Self) {
        for (sum, part) in self.ends.iter_mut().zip(&other.ends) {
            add(sum, part);
        }
        self.injected = self.injected.plus(other.injected);
        self.late = self.late.saturating_add(other.late);
    }
}
pub(crate) fn create_run(prepared: &Prepared, link: &Link, store: &mut Store) -> Result<i64, JobError> {
    let poses = prepared
        .plan
        .spheres
        .iter()
        .flat_map(|visit| visit.poses.iter().filter(|p| !p.via).map(|p| (visit.sphere_id, p)))
        .map(|(sphere, pose)| PlannedPose {
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

/// Reads back everything that was measured in a run.
///
/// # Errors
/// When the database fails or a value does not decode.
pub fn read(store: &mut Store, info: &RunInfo) -> Result<Measurements, JobError> {
    let undecodable = |what: &'static str| {
        move |e: serde_json::Error| JobError::Encode {
            what,
            message: format!("{e}; it was written by another version"),
        }
    };
    let config: Config = toml::from_str(&info.config_toml).map_err(|e| JobError::Encode {
        what: "the stored configuration",
        message: format!("{e}; it was written by another version"),
    })?;
    let plan: Plan = serde_json::from_str(&info.plan_json).map_err(undecodable("the stored plan"))?;
    let sessions = store.sessions(info.run)?;
    let mut link = LinkRecord::default();
    for session in &sessions {
        link.add(&LinkRecord::stored(&session.link_json));
    }
    Ok(Measurements {
        seed: info.seed,
        link_name: info.link.clone(),
        robot: info.robot.clone(),
        tool: info.tool,
        config,
        plan,
        spheres: store.spheres(info.run)?,
        recordings: store.recordings(info.run)?,
        rejected: store.resumable(info.run)?.rejected,
        contacts: store.contacts(info.run)?,
        couplings: store.couplings(info.run)?,
        faults: store.faults(info.run)?,
        laser: store.laser(info.run)?,
        link,
        simulated_s: sessions.iter().map(|s| s.simulated_us as f64 * 1e-6).sum(),
        wall_s: sessions.iter().map(|s| s.wall_s).sum(),
    })
}

fn add(sum: &mut LinkCounters, part: &LinkCounters) {
    sum.frames = sum.frames.saturating_add(part.frames);
    sum.crc_errors = sum.crc_errors.saturating_add(part.crc_errors);
    sum.lost = sum.lost.saturating_add(part.lost);
    sum.duplicates = sum.duplicates.saturating_add(part.duplicates);
    sum.resent = sum.resent.saturating_add(part.resent);
    sum.overflow = sum.overflow.saturating_add(part.overflow);
}

fn json(value: &impl serde::Serialize) -> Result<String, JobError> {
    serde_json::to_string(value).map_err(|e| JobError::Encode {
        what: "a record for the database",
        message: e.to_string(),
    })
}

/// Now, as RFC 3339 in UTC with seconds.
pub fn now_utc() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    utc(seconds)
}

/// Seconds since 1970 as RFC 3339, by the civil calendar (Hinnant's algorithm).
pub(crate) fn utc(seconds: u64) -> String {
    let (days, rest) = (seconds / 86_400, seconds % 86_400);
    let shifted = days + 719_468;
    let era = shifted / 146_097;
    let day_of_era = shifted % 146_097;
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_index = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_index + 2) / 5 + 1;
    let month = if month_index < 10 {
        month_index + 3
    } else {
        month_index - 9
    };
    let year = year_of_era + era * 400 + u64::from(month <= 2);
    format!(
        "{year:04}-{month:02}-{day:02}T{:02}:{:02}:{:02}Z",
        rest / 3600,
        rest / 60 % 60,
        rest % 60
    )
}
