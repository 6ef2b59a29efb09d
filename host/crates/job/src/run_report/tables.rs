//! Tables of the report about the run itself: contacts, seating, link, faults, provenance.

use spherecal_link::qemu::LOG_FILE;
use spherecal_report::SimpleTable;

use crate::{DriveTiming, Link, Measurements, Spread, Summary};

pub(super) fn strings(words: &[&str]) -> Vec<String> {
    words.iter().map(|w| (*w).to_owned()).collect()
}

pub(super) fn contacts(m: &Measurements) -> SimpleTable {
    SimpleTable {
        title: "Contacts and triggers".to_owned(),
        caption: "Latency counts from the lasting crossing of the threshold to the declaration.".to_owned(),
        columns: strings(&[
            "sphere",
            "trigger (N)",
            "peak (N)",
            "travel (mm)",
            "latency (ms)",
            "early crossings",
        ]),
        rows: m
            .contacts
            .iter()
            .map(|c| {
                vec![
                    c.sphere.to_string(),
                    format!("{:.2}", c.force_n),
                    format!("{:.2}", c.peak_n),
                    format!("{:.2}", c.travel_m * 1e3),
                    c.latency_ticks.to_string(),
                    c.early_crossings.to_string(),
                ]
            })
            .collect(),
    }
}

pub(super) fn seating(m: &Measurements) -> SimpleTable {
    SimpleTable {
        title: "Seating".to_owned(),
        caption: "The test pull shows that the magnet holds; a seated nest does not move under it.".to_owned(),
        columns: strings(&["sphere", "contact to seat (mm)", "under the test pull (mm)"]),
        rows: m
            .couplings
            .iter()
            .map(|c| {
                vec![
                    c.sphere.to_string(),
                    format!("{:.3}", c.shift_m * 1e3),
                    format!("{:.3}", c.test_m * 1e3),
                ]
            })
            .collect(),
    }
}

pub(super) fn health(m: &Measurements, s: &Summary) -> Vec<SimpleTable> {
    let gaps: u32 = m.recordings.iter().map(|r| r.gaps).sum();
    let samples: u64 = m.recordings.iter().map(|r| u64::from(r.count)).sum();
    let mut tables = vec![SimpleTable {
        title: "Link and recorder".to_owned(),
        caption: "Both directions together; lost frames were sent again.".to_owned(),
        columns: strings(&[
            "frames",
            "bad checksums",
            "lost",
            "sent again",
            "duplicates dropped",
            "commands late",
            "samples recorded",
            "gaps",
        ]),
        rows: vec![vec![
            s.link.frames.to_string(),
            s.link.crc_errors.to_string(),
            s.link.lost.to_string(),
            s.link.resent.to_string(),
            s.link.duplicates.to_string(),
            s.link.late.to_string(),
            samples.to_string(),
            gaps.to_string(),
        ]],
    }];
    let injected = &s.link.injected;
    if injected.frames > 0 {
        tables.push(SimpleTable {
            title: "Injected faults of the host link".to_owned(),
            caption: "Frames of both directions, by [host_link] in the configuration.".to_owned(),
            columns: strings(&["frames", "lost", "sent twice", "held back", "with a flipped bit"]),
            rows: vec![
                [
                    injected.frames,
                    injected.lost,
                    injected.duplicated,
                    injected.reordered,
                    injected.flipped,
                ]
                .map(|count| count.to_string())
                .to_vec(),
            ],
        });
    }
    if let Some(drive) = &s.drive {
        tables.push(real_time(drive));
    }
    if s.faults.is_empty() {
        tables[0].caption.push_str(" No fault occurred.");
    } else {
        tables.insert(
            0,
            SimpleTable {
                title: "Faults".to_owned(),
                caption: "The run recovered from all of them; poses that were given up are not used.".to_owned(),
                columns: strings(&["fault", "phase", "time (s)", "joint", "value", "limit"]),
                rows: s
                    .faults
                    .iter()
                    .map(|f| {
                        vec![
                            format!("{:?}", f.fault),
                            format!("{:?}", f.phase),
                            format!("{:.3}", f.time_us as f64 * 1e-6),
                            if f.joint == 0 {
                                "–".to_owned()
                            } else {
                                f.joint.to_string()
                            },
                            format!("{:.4}", f.value),
                            format!("{:.4}", f.limit),
                        ]
                    })
                    .collect(),
            },
        );
    }
    tables
}

/// The histograms of the real-time loop, with bins of an octave.
fn real_time(drive: &DriveTiming) -> SimpleTable {
    let octave = |us: u32| 32 - us.leading_zeros();
    let count = |spread: &Spread, k: u32| -> u64 {
        let bins = spread.bins.iter().filter(|bin| octave(bin.from_us) == k);
        bins.map(|bin| bin.count).sum()
    };
    let rows = (0..=32)
        .map(|k| (k, count(&drive.turnaround, k), count(&drive.jitter, k)))
        .filter(|(_, turnaround, jitter)| turnaround + jitter > 0)
        .map(|(k, turnaround, jitter)| vec![(1_u64 << k).to_string(), turnaround.to_string(), jitter.to_string()])
        .collect();
    SimpleTable {
        title: "Real time".to_owned(),
        caption: format!(
            "{}. Turnaround: from the arrival of a state to its command. Jitter: how far the time between two states \
             differs from the control period.",
            drive.words()
        ),
        columns: strings(&["below (us)", "turnarounds", "jitter"]),
        rows,
    }
}

pub(super) fn provenance(m: &Measurements, s: &Summary, created: &str) -> Vec<(String, String)> {
    let mut out = vec![
        ("program".to_owned(), format!("spherecal {}", s.version)),
        ("measured".to_owned(), created.to_owned()),
        ("robot".to_owned(), format!("{} ({} joints)", s.robot, m.robot.dof())),
        ("seed".to_owned(), s.seed.to_string()),
        ("link".to_owned(), s.link_name.clone()),
        (
            "poses".to_owned(),
            format!(
                "{} planned, {} reachable, {} recorded, {} given up",
                s.poses.planned, s.poses.reachable, s.poses.recorded, s.poses.rejected
            ),
        ),
        (
            "estimator".to_owned(),
            format!("{}, {} model", m.config.identify.method, m.config.identify.model),
        ),
        ("recordings' SHA-256".to_owned(), s.recordings_sha256.clone()),
    ];
    if s.link_name == Link::Qemu.to_string() {
        let log = format!("{LOG_FILE}, beside this report");
        out.push(("controller's log".to_owned(), log));
    }
    if let Ok(text) = toml::to_string(&m.config) {
        let words: Vec<&str> = text.lines().filter(|l| !l.trim().is_empty()).collect();
        out.push(("configuration".to_owned(), words.join("; ")));
    }
    out
}
