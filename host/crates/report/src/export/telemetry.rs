//! The telemetry of a run, from its MCAP files, as one wide table.

use std::path::{Path, PathBuf};

use spherecal_campaign::telemetry::messages::{JointStates, PhaseState, Xyz};
use spherecal_campaign::telemetry::{Period, TelemetryReader, Torn};

use super::tables::name_of;
use super::{ExportError, ExportTable, Format, TableFile, TornFile};

/// Rows held in memory: one row group of the file.
const ROWS: usize = 1 << 16;

/// Writes the samples of all files, one file after the other, as one table, if there are any. Also
/// returns the files that end in the middle of a record.
pub(super) fn export(
    paths: &[PathBuf],
    format: Format,
    folder: &Path,
) -> Result<(Option<PathBuf>, Vec<TornFile>), ExportError> {
    let mut out = Out {
        joints: 0,
        file: None,
        format,
        folder,
    };
    let mut torn = Vec::new();
    for path in paths {
        torn.extend(out.append(path)?.map(|read| TornFile {
            file: path.clone(),
            read,
        }));
    }
    Ok((out.file.map(TableFile::finish).transpose()?, torn))
}

/// The table that is written. It has no file before the first sample.
struct Out<'a> {
    joints: usize,
    file: Option<TableFile>,
    format: Format,
    folder: &'a Path,
}

impl Out<'_> {
    /// Appends the samples of a file. Returns what was read if it ends in the middle of a record.
    fn append(&mut self, path: &Path) -> Result<Option<Torn>, ExportError> {
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
            if self.file.is_none() {
                self.joints = first.joint_states.as_ref().map_or(0, |j| j.position.len());
            }
            let table = table(&rows, self.joints);
            let mut out = match self.file.take() {
                Some(out) => out,
                None => TableFile::create(self.folder, self.format, &table)?,
            };
            out.append(&table)?;
            self.file = Some(out);
        }
        Ok(reader.torn())
    }
}

/// The columns of some control periods. A message that the file lacks leaves NaN,
/// no text and flags that are not set.
fn table(rows: &[Period], joints: usize) -> ExportTable {
    let mut t = ExportTable::new("telemetry");
    t.whole("time_ns", rows.iter().map(Period::device_ns));
    type OfJoints = for<'a> fn(&'a JointStates<'static>) -> &'a [f32];
    let parts: [(&str, &str, OfJoints); 4] = [
        ("q", "rad", |j| &j.position),
        ("dq", "rad_s", |j| &j.velocity),
        ("tau", "nm", |j| &j.effort),
        ("command", "nm", |j| &j.command),
    ];
    for (name, unit, of) in parts {
        for joint in 0..joints {
            let value = |r: &Period| r.joint_states.as_ref().and_then(|j| of(j).get(joint).copied());
            t.real(
                format!("{name}{}_{unit}", joint + 1),
                rows.iter().map(|r| real(value(r))),
            );
        }
    }
    type Vector = fn(&Period) -> Option<Xyz>;
    let vectors: [(&str, &str, Vector); 6] = [
        ("force", "n", |r| r.wrench.as_ref().map(|w| w.wrench.force)),
        ("torque", "nm", |r| r.wrench.as_ref().map(|w| w.wrench.torque)),
        ("force_uncertainty", "n", |r| {
            Some(r.wrench.as_ref()?.uncertainty?.force)
        }),
        ("torque_uncertainty", "nm", |r| {
            Some(r.wrench.as_ref()?.uncertainty?.torque)
        }),
        ("tcp", "m", |r| r.tcp.as_ref().map(|t| t.pose.position)),
        ("setpoint", "m", |r| r.tcp.as_ref().map(|t| t.setpoint)),
    ];
    type Axis = fn(Xyz) -> f32;
    let axes: [(&str, Axis); 3] = [("x", |v| v.x), ("y", |v| v.y), ("z", |v| v.z)];
    for (name, unit, of) in vectors {
        for (axis, part) in axes {
            t.real(
                format!("{name}_{axis}_{unit}"),
                rows.iter().map(|r| real(of(r).map(part))),
            );
        }
    }
    t.text(
        "phase",
        rows.iter()
            .map(|r| r.phase.map_or_else(String::new, |p| name_of(p.phase))),
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

/// A number of the file; NaN where there is none.
fn real(value: Option<f32>) -> f64 {
    value.map_or(f64::NAN, f64::from)
}
