//! The tables of a run, from the store.

use spherecal_shared::protocol::host::{Contact, Coupled, FaultReport, PhaseChange, Recording, SignalStatistics};

use super::ExportTable;
use spherecal_model::{LaserShot, name_of};
use spherecal_store::{CalibrationStore, StoreError};

/// All tables of a run; those without rows too.
pub(super) fn of_run(store: &mut dyn CalibrationStore, run: i64) -> Result<Vec<ExportTable>, StoreError> {
    let stored = store.read_run(run)?;
    let mut tables = vec![
        recordings_table(&stored.recordings),
        poses(&stored.recordings),
        contacts(&stored.contacts),
        couplings(&stored.couplings),
        phases(&stored.phases),
        faults(&stored.faults),
        laser(&stored.laser),
    ];
    if let Some(json) = store.result(run, "summary")? {
        tables.push(parameters(&json));
    }
    Ok(tables)
}

fn joints(recordings: &[Recording]) -> usize {
    recordings.iter().map(|r| r.q.len()).max().unwrap_or(0)
}

fn recordings_table(recordings: &[Recording]) -> ExportTable {
    let mut t = ExportTable::new("recordings");
    t.whole("sphere", recordings.iter().map(|r| r.sphere));
    t.whole("pose", recordings.iter().map(|r| r.pose));
    t.whole("start_us", recordings.iter().map(|r| r.start_us));
    t.whole("end_us", recordings.iter().map(|r| r.end_us));
    t.whole("samples", recordings.iter().map(|r| r.count));
    t.whole("gaps", recordings.iter().map(|r| r.gaps));
    t.real("tcp_spread_m", recordings.iter().map(|r| r.tcp_spread_m));
    t.vector("force", "n", recordings.iter().map(|r| &r.force_n));
    type Part = fn(&SignalStatistics) -> f64;
    let parts: [(&str, Part); 4] = [
        ("mean", |s| s.mean),
        ("std", |s| s.std),
        ("min", |s| s.min),
        ("max", |s| s.max),
    ];
    for joint in 0..joints(recordings) {
        for (part, take) in parts {
            let of = |signals: &[SignalStatistics]| signals.get(joint).map_or(f64::NAN, take);
            t.real(
                format!("q{}_{part}_rad", joint + 1),
                recordings.iter().map(|r| of(&r.q)),
            );
            t.real(
                format!("tau{}_{part}_nm", joint + 1),
                recordings.iter().map(|r| of(&r.tau)),
            );
        }
    }
    t
}

/// As `spherecal identify --data` reads it.
fn poses(recordings: &[Recording]) -> ExportTable {
    let mut t = ExportTable::new("poses");
    let mean = |signals: &[SignalStatistics], joint: usize| signals.get(joint).map_or(f64::NAN, |s| s.mean);
    for joint in 0..joints(recordings) {
        t.real(format!("q{}", joint + 1), recordings.iter().map(|r| mean(&r.q, joint)));
    }
    for joint in 0..joints(recordings) {
        t.real(
            format!("tau{}", joint + 1),
            recordings.iter().map(|r| mean(&r.tau, joint)),
        );
    }
    t.whole("sphere", recordings.iter().map(|r| r.sphere));
    t
}

fn contacts(rows: &[Contact]) -> ExportTable {
    let mut t = ExportTable::new("contacts");
    t.whole("sphere", rows.iter().map(|r| r.sphere));
    t.whole("time_us", rows.iter().map(|r| r.time_us));
    t.real("force_n", rows.iter().map(|r| r.force_n));
    t.real("peak_n", rows.iter().map(|r| r.peak_n));
    t.vector("tare", "n", rows.iter().map(|r| &r.tare_n));
    t.vector("tcp", "m", rows.iter().map(|r| &r.tcp_m));
    t.real("travel_m", rows.iter().map(|r| r.travel_m));
    t.whole("latency_ticks", rows.iter().map(|r| r.latency_ticks));
    t.whole("early_crossings", rows.iter().map(|r| r.early_crossings));
    t
}

fn couplings(rows: &[Coupled]) -> ExportTable {
    let mut t = ExportTable::new("couplings");
    t.whole("sphere", rows.iter().map(|r| r.sphere));
    t.whole("time_us", rows.iter().map(|r| r.time_us));
    t.vector("centre", "m", rows.iter().map(|r| &r.centre_m));
    t.real("shift_m", rows.iter().map(|r| r.shift_m));
    t.real("test_m", rows.iter().map(|r| r.test_m));
    t
}

fn phases(rows: &[PhaseChange]) -> ExportTable {
    let mut t = ExportTable::new("phases");
    t.whole("time_us", rows.iter().map(|r| r.time_us));
    t.whole("tick", rows.iter().map(|r| r.tick));
    t.text("phase", rows.iter().map(|r| name_of(r.phase)));
    t.text("previous", rows.iter().map(|r| name_of(r.from)));
    t
}

fn faults(rows: &[FaultReport]) -> ExportTable {
    let mut t = ExportTable::new("faults");
    t.whole("time_us", rows.iter().map(|r| r.time_us));
    t.whole("tick", rows.iter().map(|r| r.tick));
    t.text("fault", rows.iter().map(|r| name_of(r.fault)));
    t.text("phase", rows.iter().map(|r| name_of(r.phase)));
    t.whole("joint", rows.iter().map(|r| r.joint));
    t.real("value", rows.iter().map(|r| r.value));
    t.real("limit", rows.iter().map(|r| r.limit));
    t
}

fn laser(rows: &[LaserShot]) -> ExportTable {
    let mut t = ExportTable::new("laser");
    t.text("purpose", rows.iter().map(|r| r.purpose.clone()));
    let joints = rows.iter().map(|r| r.q.len()).max().unwrap_or(0);
    for joint in 0..joints {
        let of = |q: &[f64]| q.get(joint).copied().unwrap_or(f64::NAN);
        t.real(format!("q{}_rad", joint + 1), rows.iter().map(|r| of(&r.q)));
    }
    t.vector("point", "m", rows.iter().map(|r| &r.point_m));
    t
}

/// The parameters of the stored summary; from a summary of another version, those that it contains.
fn parameters(summary: &str) -> ExportTable {
    let summary: serde_json::Value = serde_json::from_str(summary).unwrap_or_default();
    let empty = Vec::new();
    let rows = summary["parameters"].as_array().unwrap_or(&empty);
    let text = |field: &'static str| {
        rows.iter()
            .map(move |r| r[field].as_str().unwrap_or_default().to_owned())
    };
    let real = |field: &'static str| rows.iter().map(move |r| r[field].as_f64().unwrap_or(f64::NAN));
    let mut t = ExportTable::new("parameters");
    t.text("name", text("name"));
    t.text("unit", text("unit"));
    t.real("nominal", real("nominal"));
    t.real("estimate", real("estimate"));
    t.real("sigma", real("sigma"));
    t.whole(
        "identified",
        rows.iter()
            .map(|r| i64::from(r["identified"].as_bool().unwrap_or(false))),
    );
    t
}
