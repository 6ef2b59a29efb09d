//! The telemetry of a run, from its MCAP files, as one wide table.

use std::path::PathBuf;

use spherecal_campaign::telemetry::messages::{JointState, PhaseState, Point32, Xyz};
use spherecal_campaign::telemetry::{Period, TelemetryReader};

use super::{ExportError, ExportTable, TornFile};

/// Rows held in memory: one row group of the file.
const ROWS: usize = 1 << 16;

/// Gives the samples of all files, one file after the other, to `append`, as pieces of one table. Returns the files that
/// end in the middle of a record.
pub(super) fn read(
    paths: &[PathBuf],
    mut append: impl FnMut(ExportTable) -> Result<(), ExportError>,
) -> Result<Vec<TornFile>, ExportError> {
    let (mut joints, mut torn) = (None, Vec::new());
    for path in paths {
        let unreadable = |what: String| ExportError::Telemetry {
            path: path.display().to_string(),
            what,
        };
        let bytes = std::fs::read(path).map_err(|e| unreadable(e.to_string()))?;
        let mut reader = TelemetryReader::new(&bytes).map_err(|e| unreadable(e.to_string()))?;
        let mut rows: Vec<Period> = Vec::new();
        loop {
            rows.clear();
            for period in reader.by_ref().take(ROWS) {
                rows.push(period.map_err(|e| unreadable(e.to_string()))?);
            }
            let Some(first) = rows.first() else { break };
            append(table(&rows, *joints.get_or_insert(first.joints.position.len())))?;
        }
        torn.extend(reader.torn().map(|read| TornFile {
            file: path.clone(),
            read,
        }));
    }
    Ok(torn)
}

/// The columns of some control periods. A message that the file lacks leaves NaN,
/// no text and flags that are not set.
fn table(rows: &[Period], joints: usize) -> ExportTable {
    let mut t = ExportTable::new("telemetry");
    t.whole("time_ns", rows.iter().map(|r| r.device_ns));
    type OfJoints = for<'a> fn(&'a JointState<'static>) -> &'a Vec<f64>;
    let parts: [(&str, &str, OfJoints); 3] = [
        ("q", "rad", |j| &j.position),
        ("dq", "rad_s", |j| &j.velocity),
        ("tau", "nm", |j| &j.effort),
    ];
    for (name, unit, of) in parts {
        for joint in 0..joints {
            let value = |r: &Period| of(&r.joints).get(joint).copied();
            t.real(
                format!("{name}{}_{unit}", joint + 1),
                rows.iter().map(|r| value(r).unwrap_or(f64::NAN)),
            );
        }
    }
    for joint in 0..joints {
        let value = |r: &Period| Some(f64::from(*r.control.as_ref()?.command.get(joint)?));
        t.real(
            format!("command{}_nm", joint + 1),
            rows.iter().map(|r| value(r).unwrap_or(f64::NAN)),
        );
    }
    let xyz = |p: Point32| [p.x, p.y, p.z].map(f64::from);
    let xyz_of = |v: Xyz| [v.x, v.y, v.z];
    let vectors: [(&str, &str, &dyn Fn(&Period) -> Option<[f64; 3]>); 6] = [
        ("force", "n", &|r| Some(xyz_of(r.wrench?.force))),
        ("torque", "nm", &|r| Some(xyz_of(r.wrench?.torque))),
        ("force_uncertainty", "n", &|r| Some(xyz_of(r.uncertainty?.force))),
        ("torque_uncertainty", "nm", &|r| Some(xyz_of(r.uncertainty?.torque))),
        ("tcp", "m", &|r| Some(xyz(r.control.as_ref()?.tcp))),
        ("setpoint", "m", &|r| Some(xyz(r.control.as_ref()?.setpoint))),
    ];
    for (name, unit, of) in vectors {
        for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
            t.real(
                format!("{name}_{axis}_{unit}"),
                rows.iter().map(|r| of(r).map_or(f64::NAN, |v| v[k])),
            );
        }
    }
    t.text(
        "phase",
        rows.iter()
            .map(|r| r.phase.as_ref().map_or_else(String::new, |p| p.phase.clone())),
    );
    type Flag = fn(&PhaseState) -> bool;
    let flags: [(&str, Flag); 3] = [
        ("saturated", |p| p.saturated),
        ("rate_limited", |p| p.rate_limited),
        ("near_singular", |p| p.near_singular),
    ];
    for (name, of) in flags {
        t.whole(name, rows.iter().map(|r| i64::from(r.phase.as_ref().is_some_and(of))));
    }
    t.whole("utc_ns", rows.iter().map(|r| r.utc_ns));
    t
}
