//! `spherecal run`: the whole job.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::args::RunArgs;
use super::exit::{CliError, Exit, interrupt};
use super::live_output::LiveOutput;
use super::out::{err, errln, out, outln};
use super::progress::ProgressView;
use super::study::StudyProgress;
use super::{features, text};
use crate::simulated::{SimulatedCell, SimulationError};
use spherecal_campaign::telemetry::{ContactTrace, DrawnArm, TelemetryRecorder};
use spherecal_campaign::{CampaignObserver, Moved, Progress};
use spherecal_identify::study::StudyStep;
use spherecal_job::{
    self as job, JobError, Link, Measurements, PreparedRun, Site, Summary, TaughtWaypoints, open_store,
};
use spherecal_link::qemu::LOG_FILE;
use spherecal_link::{Arrival, Serial};
use spherecal_model::robots;
use spherecal_services::Server;
use spherecal_services::live::End;
use spherecal_sim::inject::FaultPlan;
use spherecal_store::history::{self, FINGERPRINT, Fingerprint};
use spherecal_store::{CalibrationStore, RunInfo, SqlStore, StoreLocation};

/// What a run of the whole job left.
pub(super) struct FinishedRun {
    pub(super) summary: Summary,
    pub(super) files: Vec<PathBuf>,
}

/// All views of a run: the terminal, and viewers outside.
struct View {
    terminal: ProgressView,
    live: LiveOutput,
}

impl CampaignObserver for View {
    fn event(&mut self, now_us: u64, arrival: &Arrival) {
        self.terminal.event(now_us, arrival);
        self.live.event(now_us, arrival);
    }

    fn progress(&mut self, progress: &Progress) {
        self.terminal.progress(progress);
        self.live.progress(progress);
    }

    fn note(&mut self, text: &str) {
        self.terminal.note(text);
        self.live.note(text);
    }

    fn plate(&mut self, place: u32) -> Moved {
        self.terminal.plate(place)
    }
}

/// Runs the whole job.
pub(super) fn run(args: &RunArgs) -> Result<Exit, CliError> {
    let interrupt = interrupt()?;
    let (mut store, info, mut live) = measure(args, &interrupt)?;
    live.remark("measurement complete; identifying the robot");
    let finished = evaluate(&args.out, store.as_mut(), &info, args.json).and_then(|finished| {
        store.set_state(info.run, "complete")?;
        Ok(finished)
    });
    let end = |trusted, text| End {
        run: Some(info.run),
        trusted,
        text,
    };
    live.end(&match &finished {
        Ok(finished) => end(
            Some(finished.summary.verdict.may_be_used),
            text::verdict(&finished.summary),
        ),
        Err(error) => end(None, error.to_string()),
    });
    drop(store);
    let exit = print(&finished?, args.json)?;
    live.stay(&interrupt);
    Ok(exit)
}

/// Prints a result, as JSON or for people.
pub(super) fn print(finished: &FinishedRun, json: bool) -> Result<Exit, CliError> {
    if json {
        outln!(
            "{}",
            serde_json::to_string_pretty(&finished.summary).map_err(CliError::job)?
        );
    } else {
        out!("{}", text::result(&finished.summary, &finished.files));
    }
    Ok(if finished.summary.verdict.may_be_used {
        Exit::Done
    } else {
        Exit::NotTrusted
    })
}

/// Says so if the robot behind its own interface was never commissioned. This is a warning alone: a commissioning may be
/// in another database, and one that cannot be read prevents no run.
fn warn_of_first_run(link: &Link, arm: &str, store: &mut dyn CalibrationStore) {
    if !matches!(link, Link::Franka { .. } | Link::Fri(_) | Link::Ur { .. }) {
        return;
    }
    let known = job::commissionings(store, arm).unwrap_or_default();
    if !known.iter().any(|one| one.passed() && !one.simulated) {
        errln!(
            "warning: this database holds no commissioning that this arm passed: `spherecal commission --link {link}` is the \
             careful first run on a robot"
        );
    }
}

/// Checks what can be checked before anything is written, planned or moved.
fn check_first(args: &RunArgs) -> Result<(), CliError> {
    if !args.resume {
        robots::load_driven(&args.configuration()?.robot)?;
    }
    if let Some(path) = &args.waypoints {
        TaughtWaypoints::read(path)?;
    }
    if let Some(address) = &args.serve {
        Server::check(address, &args.protection.files())?;
    }
    if let Link::Serial(device) = &args.link {
        Serial::check(device)?;
    }
    Ok(())
}

/// Plans and measures, or continues the last run. The outside views stay open.
pub(super) fn measure(
    args: &RunArgs,
    interrupt: &AtomicBool,
) -> Result<(Box<dyn CalibrationStore>, RunInfo, LiveOutput), CliError> {
    features::check_run(args)?;
    let inject = args.inject.as_deref().map(FaultPlan::load).transpose();
    let inject = inject.map_err(SimulationError::from).map_err(JobError::from)?;
    check_first(args)?;
    let mut live = LiveOutput::open(args)?;
    // Faults are injected into a drive that only they connect.
    let connects_early = inject.is_none();
    let simulator = Arc::new(SimulatedCell { inject });
    let mut device = None;
    let (mut store, prepared, resume) = if args.resume {
        resumed(args, simulator)?
    } else {
        // What is there already is checked before the poses are planned; what is not yet there appears
        // with the plan.
        let there = match args.database() {
            StoreLocation::File(path) => path.exists(),
            StoreLocation::Postgres(_) | StoreLocation::Service(_) => true,
        };
        let open = || {
            let mut store = open_store(&args.database(), true)?;
            // A new run in a damaged file could not be read back.
            store.verify()?;
            Ok::<_, CliError>(store)
        };
        let found = there.then(open).transpose()?;
        if let Some(peer) = &args.tracker {
            job::check_tracker(peer)?;
        }
        let config = args.configuration()?;
        if connects_early {
            device = job::connect_early(&config, &args.link)?;
        }
        let prepared = args.prepare_from(&config, simulator)?;
        let mut store = found.map_or_else(open, Ok)?;
        warn_of_first_run(&args.link, &prepared.config.arm, store.as_mut());
        (store, prepared, None)
    };
    // A server takes care of several writers itself.
    let _claim = match args.database() {
        StoreLocation::File(path) => Some(SqlStore::claim(&path)?),
        StoreLocation::Postgres(_) | StoreLocation::Service(_) => None,
    };
    if resume.as_ref().is_none_or(|info| info.state == "running") {
        if !args.json {
            err!("{}", text::plan(&prepared.plan));
        }
        let about = BTreeMap::from([
            ("robot".to_owned(), prepared.robot.name.to_string()),
            ("link".to_owned(), args.link.to_string()),
        ]);
        live.begin(args, &prepared)?;
        let view = View {
            terminal: ProgressView::new(),
            live,
        };
        let arm = DrawnArm::new(&prepared.model, &prepared.tool);
        let every_ticks = prepared.config.procedure.telemetry.other_ticks;
        let mut view = TelemetryRecorder::new(view, &args.out, arm, &about, every_ticks);
        let site = Site {
            link: &args.link,
            tracker: args.tracker.as_ref(),
            folder: &args.out,
            store: store.as_mut(),
            observer: &mut view,
            interrupt,
            device,
        };
        let measured = job::measure(&prepared, site, resume.as_ref());
        let (view, _, traces) = view.finish();
        let View {
            terminal,
            live: mut seen,
        } = view;
        terminal.finish();
        if let Err(error) = measured {
            seen.end(&End {
                run: None,
                trusted: None,
                text: error.to_string(),
            });
            // What ended the run is told. Where the traces cannot be stored either, that follows from it.
            let _ = keep_traces(store.as_mut(), traces);
            return Err(CliError::from(error).with_next(&resume_command(args)));
        }
        live = seen;
        keep_traces(store.as_mut(), traces)?;
    }
    let info = store.require_last_run()?;
    Ok((store, info, live))
}

fn resume_command(args: &RunArgs) -> String {
    let mut words = vec![
        "spherecal run --resume --out".to_owned(),
        shell_word(&args.out.display().to_string()),
    ];
    let mut option = |name: &str, value: Option<String>| {
        words.extend(value.map(|value| format!("{name} {}", shell_word(&value))));
    };
    option("--link", (args.link != Link::Sim).then(|| args.link.to_string()));
    option("--store", args.store.as_ref().map(ToString::to_string));
    option("--tracker", args.tracker.as_ref().map(ToString::to_string));
    option("--arm", args.arm.clone());
    words.join(" ")
}

/// A word as a shell reads it back.
pub(super) fn shell_word(text: &str) -> String {
    // Only a zero byte cannot be quoted, and no argument has one.
    shlex::try_quote(text).map_or_else(|_| text.to_owned(), std::borrow::Cow::into_owned)
}

/// Stores the force traces of a session's contacts, also after an interruption, because --resume
/// may continue the run.
fn keep_traces(store: &mut dyn CalibrationStore, mut traces: Vec<ContactTrace>) -> Result<(), JobError> {
    if let Some(info) = store.last_run()? {
        let mut all = job::contact_traces(store, info.run)?;
        // A run that was repeated from its start delivers all traces again.
        let again = |old: &ContactTrace| {
            traces
                .iter()
                .any(|new| (new.sphere, new.trigger_s) == (old.sphere, old.trigger_s))
        };
        all.retain(|trace| !again(trace));
        all.append(&mut traces);
        job::put_contact_traces(store, info.run, &all)?;
    }
    Ok(())
}

fn resumed(
    args: &RunArgs,
    simulator: Arc<SimulatedCell>,
) -> Result<(Box<dyn CalibrationStore>, PreparedRun, Option<RunInfo>), CliError> {
    let mut store = open_store(&args.database(), false)?;
    store.verify()?;
    let mut info = store.require_run_of(args.arm.as_deref().unwrap_or_default())?;
    if info.about.link != args.link.to_string() {
        return Err(JobError::Resume {
            what: format!("the last run used --link {}, not --link {}", info.about.link, args.link),
            remedy: "give the same --link, or begin a new run without --resume",
        }
        .into());
    }
    let mut measured = job::read(store.as_mut(), &info)?;
    if let Some(accuracy_mm) = args.accuracy_mm {
        measured.config.plan.accuracy_mm = Some(accuracy_mm);
        measured.config.check().map_err(JobError::from)?;
        job::ask_accuracy(store.as_mut(), &mut info, accuracy_mm)?;
    }
    let prepared = job::recalled(&measured, simulator)?;
    Ok((store, prepared, Some(info)))
}

/// Identifies and validates a stored run, and writes all files. It shows its steps unless it is to be `quiet`.
pub(super) fn evaluate(
    out: &std::path::Path,
    store: &mut dyn CalibrationStore,
    info: &RunInfo,
    quiet: bool,
) -> Result<FinishedRun, CliError> {
    let measurements: Measurements = job::read(store, info)?;
    // It is dropped, and so taken away, once all files are written, also after an error.
    let mut view = (!quiet).then(StudyProgress::new);
    let evaluation = job::evaluate(&measurements, &mut |step| {
        if let Some(view) = &mut view {
            view.show(StudyStep::Evaluating(step));
        }
    })?;
    let summary = job::summarise(&measurements, &evaluation, &info.about.created_utc)?;
    let traces = job::contact_traces(store, info.run)?;
    let written = job::write(
        out,
        &measurements,
        &evaluation,
        &summary,
        &traces,
        &info.about.created_utc,
    )?;
    if let Some(moved) = &written.moved {
        errln!("spherecal: {moved}");
    }
    let json = serde_json::to_string(&summary).map_err(CliError::job)?;
    history::put_summary(store, info.run, &json)?;
    let model = &evaluation.calibration;
    let fingerprint = Fingerprint::of(
        &model.robot,
        |q| model.tcp_m(q, None),
        |q| model.tcp_covariance_in_base(q).trace(),
    );
    let json = serde_json::to_string(&fingerprint).map_err(CliError::job)?;
    store.put_result(info.run, FINGERPRINT, &json)?;
    let mut files = vec![store.path().to_owned()];
    files.extend(written.paths);
    files.extend(job::run_telemetry(out, info));
    if info.about.link == Link::Qemu.to_string() {
        files.push(out.join(LOG_FILE));
    }
    files.retain(|file| file.exists());
    Ok(FinishedRun { summary, files })
}
