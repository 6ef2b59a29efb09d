//! `spherecal-lab soak`: the same cell for hours of robot time.

use std::path::PathBuf;

use clap::Args;

use crate::soak::{Soak, soak};
use spherecal::cli::{CliError, Exit, ProgressView, interrupt};
use spherecal::simulated::prepare;
use spherecal::{out, outln};
use spherecal_job::{self as job, Link, Site};
use spherecal_store::SqlStore;

/// Arguments of `soak`.
#[derive(Args, Clone, Debug)]
pub struct SoakArgs {
    /// Hours of robot time.
    #[arg(long, value_name = "H", default_value_t = 24.0)]
    pub hours: f64,
    /// Poses of a lap.
    #[arg(long, value_name = "N")]
    pub poses: Option<usize>,
    /// Seed of all random draws.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Configuration file. It needs only the fields that differ from the defaults.
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Folder of the database (soak.db).
    #[arg(long, value_name = "DIR", default_value = "spherecal-soak")]
    pub out: PathBuf,
    /// Print one JSON document on stdout and nothing else.
    #[arg(long)]
    pub json: bool,
}

/// `spherecal-lab soak`
pub(super) fn run(args: &SoakArgs) -> Result<Exit, CliError> {
    if !(args.hours > 0.0 && args.hours <= 10_000.0) {
        return Err(CliError::input(format!(
            "--hours is {}: give the hours of robot time, above 0 and at most 10000",
            args.hours
        )));
    }
    let interrupt = interrupt()?;
    let mut config = match &args.config {
        Some(path) => job::Config::read(path)?,
        None => job::Config::default(),
    };
    config.seed = args.seed.unwrap_or(config.seed);
    config.plan.poses = args.poses.unwrap_or(config.plan.poses);
    let prepared = prepare(&config)?;
    let path = args.out.join("soak.db");
    let mut store = SqlStore::create_or_open(&path)?;
    let _claim = SqlStore::claim(&path)?;
    let mut view = ProgressView::of("minute");
    let site = Site {
        link: &Link::Sim,
        tracker: None,
        folder: &args.out,
        store: &mut store,
        observer: &mut view,
        interrupt: &interrupt,
        device: None,
    };
    let soak = soak(&prepared, site, args.hours);
    view.finish();
    let soak = soak?;
    if args.json {
        outln!("{}", serde_json::to_string_pretty(&soak).map_err(CliError::job)?);
    } else {
        out!("{}", table(&soak));
    }
    Ok(if soak.complaints.is_empty() {
        Exit::Done
    } else {
        Exit::Failed
    })
}

fn table(soak: &Soak) -> String {
    let mut out = format!(
        "{:.2} h of robot time in {:.0} s ({:.0}x)\n\n  hour   laps      ticks  missed  late  recordings  faults  \
         q std urad  spread um  contact N  torque N m  us/tick  memory MiB\n",
        soak.simulated_s / 3600.0,
        soak.wall_s,
        soak.simulated_s / soak.wall_s.max(1e-9),
    );
    for (h, number) in soak.hours.iter().zip(1..) {
        out += &format!(
            "  {number:4} {:6} {:10} {:7} {:5} {:11} {:7} {:11.3} {:10.2} {:10.3} {:11.2} {:8.2} {:11.1}\n",
            h.laps,
            h.ticks,
            h.missed,
            h.late,
            h.recordings,
            h.faults,
            h.q_std_rad * 1e6,
            h.tcp_spread_m * 1e6,
            h.contact_n,
            h.max_torque_nm,
            h.wall_ns_per_tick * 1e-3,
            h.resident_kib as f64 / 1024.0,
        );
    }
    out.push('\n');
    let faults: u64 = soak.hours.iter().map(|hour| hour.faults).sum();
    if faults > 0 {
        out += &format!("Faults after which the arm went on: {faults}.\n");
    }
    if soak.complaints.is_empty() {
        out.push_str("No growth or drift from the first hour to the last.\n");
    }
    for complaint in &soak.complaints {
        out += &format!("  - {complaint}\n");
    }
    out
}
