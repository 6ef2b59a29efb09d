//! Tables of the report about the run itself: contacts, seating, link, faults, provenance.

use spherecal_link::native::{DriveRecord, Histogram};
use spherecal_link::qemu::LOG_FILE;
use spherecal_report::SimpleTable;

use crate::{Config, Link, Measurements, Summary};

pub(super) fn strings(words: &[&str]) -> Vec<String> {
    words.iter().map(|w| (*w).to_owned()).collect()
}

pub(super) fn contacts(m: &Measurements) -> SimpleTable {
    SimpleTable {
        title: "Contacts and triggers".to_owned(),
        caption: "Latency counts from the lasting crossing of the threshold to the declaration. The peak is the largest \
                  mean over 10 ms of the whole descent: what sphere and plate did to the tool. The pads pressed by the magnet's pull more. \
                  Trigger and figures show the steady estimate, a low-pass, which is lower in an impact."
            .to_owned(),
        columns: strings(&[
            "sphere",
            "trigger (N)",
            "peak, mean of 10 ms (N)",
            "travel (mm)",
            "latency (control periods)",
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
                columns: strings(&["time (s)", "fault"]),
                rows: s
                    .faults
                    .iter()
                    .map(|f| {
                        vec![
                            format!("{:.3}", f.time_us as f64 * 1e-6),
                            spherecal_campaign::describe(f),
                        ]
                    })
                    .collect(),
            },
        );
    }
    tables
}

/// The histograms of the real-time loop, with bins of an octave.
fn real_time(drive: &DriveRecord) -> SimpleTable {
    let octave = |us: u32| 32 - us.leading_zeros();
    let count = |spread: &Histogram, k: u32| -> u64 {
        let bins = spread.bins().filter(|(from_us, ..)| octave(*from_us) == k);
        bins.map(|(.., count)| u64::from(count)).sum()
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
                "{} planned, {} reachable, {} recorded, {} given up; {:.0} min of robot time",
                s.poses.planned,
                s.poses.reachable,
                s.poses.recorded,
                s.poses.rejected,
                s.simulated_s / 60.0
            ),
        ),
        (
            "estimator".to_owned(),
            format!("{}, {} model", m.config.identify.method, m.config.identify.model),
        ),
        ("recordings' SHA-256".to_owned(), s.recordings_sha256.clone()),
    ];
    if let Some(ended) = &s.ended_early {
        out.push(("ended early".to_owned(), ended.words()));
    }
    if s.link_name == Link::Qemu.to_string() {
        let log = format!("{LOG_FILE}, beside this report");
        out.push(("controller's log".to_owned(), log));
    }
    if let Some(hash) = &s.certificate.configuration_sha256 {
        out.push(("configuration's SHA-256".to_owned(), hash.clone()));
    }
    let differing = differing(&m.config);
    out.push((
        "configuration".to_owned(),
        if differing.is_empty() {
            "the defaults".to_owned()
        } else {
            format!("the defaults, but {}", differing.join("; "))
        },
    ));
    out
}

/// The whole configuration, line by line.
pub(super) fn configuration(config: &Config) -> Vec<String> {
    let text = config.to_toml().unwrap_or_default();
    text.lines()
        .filter(|l| !l.trim().is_empty())
        .map(str::to_owned)
        .collect()
}

/// The fields that differ from the defaults, without the certificate's own: they are on the certificate.
fn differing(config: &Config) -> Vec<String> {
    let table = |config: &Config| toml::Table::try_from(config).unwrap_or_default();
    let mut own = table(config);
    own.remove("certificate");
    let mut out = Vec::new();
    compare("", &own, &table(&Config::default()), &mut out);
    out
}

fn compare(path: &str, own: &toml::Table, default: &toml::Table, out: &mut Vec<String>) {
    for (name, value) in own {
        let path = if path.is_empty() {
            name.clone()
        } else {
            format!("{path}.{name}")
        };
        match (value, default.get(name)) {
            (value, Some(same)) if value == same => {}
            (toml::Value::Table(own), Some(toml::Value::Table(default))) => compare(&path, own, default, out),
            (toml::Value::Table(own), None) => compare(&path, own, &toml::Table::new(), out),
            (value, _) => out.push(format!("{path} = {value}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a field that was changed is not named with its value, if one that was not is, or if
    // the names of the certificate appear a second time.
    #[test]
    fn the_differences_are_named() {
        let text = "seed = 7\n[plan]\nposes = 30\nchoice = \"optimal\"\n[plant]\npreset = \"ideal\"\n\
                    [cell.tool]\nmass_kg = 0.5\n[certificate]\noperator = \"A\"\n";
        let config = Config::parse("cell.toml", text).expect("parses");
        assert_eq!(
            differing(&config),
            [
                "cell.tool.mass_kg = 0.5",
                "plan.poses = 30",
                "plant.preset = \"ideal\"",
                "seed = 7"
            ]
        );
        assert!(differing(&Config::default()).is_empty());
    }
}
