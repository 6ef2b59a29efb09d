//! Soak test: one cell, one controller and one database run for as long as requested. Growth, drift
//! and wear show from hour to hour.
//!
//! The tour is repeated lap after lap on the same controller and the same arm. Each lap is a run of
//! its own in the store, with its own handshake. Telemetry is counted, not stored.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use serde::Serialize;
use spherecal_shared::protocol::host::Recording;

use spherecal_campaign::{self as campaign, Assignment, CampaignObserver, CampaignStage, Outcome, Progress};
use spherecal_job::connect::device;
use spherecal_job::{JobError, PreparedRun, Site, StoreJournal, create_run};
use spherecal_link::Arrival;
use spherecal_store::SessionEnd;
use spherecal_store::time::now_utc;

/// What one hour of robot time was like.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Hour {
    /// Laps that ended in it.
    pub laps: u32,
    /// Control ticks.
    pub ticks: u64,
    /// Ticks without a fresh drive state.
    pub missed: u64,
    /// Commands that came after their start.
    pub late: u64,
    /// Frames that were lost, damaged or sent again, both ways.
    pub repaired: u64,
    /// Recordings.
    pub recordings: u64,
    /// Faults.
    pub faults: u64,
    /// Ticks with a saturated torque, per million.
    pub saturated_ppm: f64,
    /// Ticks with a rate-limited torque, per million.
    pub rate_limited_ppm: f64,
    /// Largest commanded torque, in N m.
    pub max_torque_nm: f64,
    /// Mean standard deviation of the joint angles within a recording, in rad.
    pub q_std_rad: f64,
    /// Mean over the recordings of the largest distance of the TCP from its mean, in m.
    pub tcp_spread_m: f64,
    /// Mean force at which contact was declared, in N.
    pub contact_n: f64,
    /// Wall-clock time per tick, host included, in ns.
    pub wall_ns_per_tick: f64,
    /// Memory of this process at its end, in KiB; 0 if the system does not tell.
    pub resident_kib: u64,
}

/// What a soak came to.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Soak {
    /// Robot time, in s.
    pub simulated_s: f64,
    /// Time on the wall, in s.
    pub wall_s: f64,
    /// Hour by hour; the last may be a part of one.
    pub hours: Vec<Hour>,
    /// What is wrong: empty if nothing is.
    pub complaints: Vec<String>,
}

/// Accepted growth of the memory after the first hour, in KiB: room for caches.
const GROWTH_KIB: u64 = 8 * 1024;
/// Share by which a quantity may differ between the first hour and the last.
const DRIFT: f64 = 0.10;
/// Faults beyond those of the first half that are no chance, in standard deviations.
const CHANCE: f64 = 3.0;

/// Repeats the tour of `prepared` lap after lap until `hours` of robot time have passed.
///
/// # Errors
/// Any error that stops a lap.
pub fn soak(prepared: &PreparedRun, site: Site<'_>, hours: f64) -> Result<Soak, JobError> {
    let begun = Instant::now();
    let plan = &prepared.plan;
    let mut cell = device(prepared, site.link, site.folder)?;
    let assignment = Assignment {
        robot: &prepared.robot,
        tool: &prepared.tool,
        procedure: &prepared.procedure()?,
        plan,
        done: &BTreeSet::new(),
        seated: &[],
        options: prepared.config.campaign.options(),
    };
    let end_us = (hours * 3.6e9) as u64;
    let mut soak = Soak::default();
    let mut lap = Lap::default();
    while cell.now_us() < end_us {
        let lap_begun = Instant::now();
        let run = create_run(prepared, site.link, site.store)?;
        let session = site.store.begin_session(run, &now_utc())?;
        let mut journal = StoreJournal::live(site.store, run, session, BTreeMap::new());
        let mut observer = Laps {
            inner: site.observer,
            hours,
        };
        let (outcome, result) = campaign::run(&assignment, cell.as_mut(), &mut journal, &mut observer, site.interrupt);
        drop(journal);
        let end = SessionEnd {
            firmware: outcome.firmware.clone(),
            simulated_us: outcome.simulated_us.saturating_sub(lap.now_us),
            ticks: outcome.ticks.saturating_sub(lap.ticks),
            wall_s: lap_begun.elapsed().as_secs_f64(),
            ..SessionEnd::default()
        };
        site.store.end_session(run, session, &end)?;
        result?;
        site.store.set_state(run, "measured")?;
        let recordings = site.store.read_run(run)?.recordings;
        let number = (outcome.simulated_us.saturating_sub(1) / 3_600_000_000) as usize;
        soak.hours.resize(soak.hours.len().max(number + 1), Hour::default());
        if let Some(hour) = soak.hours.get_mut(number) {
            lap.add(hour, &outcome, &recordings, end.wall_s);
        }
    }
    soak.hours.retain(|hour| hour.laps > 0);
    soak.simulated_s = cell.now_us() as f64 * 1e-6;
    soak.wall_s = begun.elapsed().as_secs_f64();
    soak.complaints = complaints(&soak.hours);
    Ok(soak)
}

/// Counters at the end of the last lap. The outcome counts since the start, so a lap is the
/// difference.
#[derive(Clone, Copy, Debug, Default)]
struct Lap {
    now_us: u64,
    ticks: u64,
    missed: u32,
    late: u32,
    controller_repaired: u64,
}

impl Lap {
    fn add(&mut self, hour: &mut Hour, outcome: &Outcome, recordings: &[Recording], wall_s: f64) {
        let ticks = outcome.ticks.saturating_sub(self.ticks);
        let counted = |c: &spherecal_shared::protocol::frame::LinkCounters| {
            u64::from(c.crc_errors) + u64::from(c.lost) + u64::from(c.resent)
        };
        let controller = counted(&outcome.statistics.link);
        let per_million = |count: u64| 1e6 * count as f64 / outcome.telemetry.samples.max(1) as f64;
        let mean = |values: &mut dyn Iterator<Item = f64>| {
            let (mut sum, mut count) = (0.0, 0u32);
            for value in values {
                sum += value;
                count += 1;
            }
            sum / f64::from(count.max(1))
        };
        // Means over the hour: each lap counts alike.
        let before = f64::from(hour.laps);
        let join = |old: &mut f64, new: f64| *old = (*old * before + new) / (before + 1.0);
        join(&mut hour.saturated_ppm, per_million(outcome.telemetry.saturated));
        join(&mut hour.rate_limited_ppm, per_million(outcome.telemetry.rate_limited));
        join(
            &mut hour.q_std_rad,
            mean(&mut recordings.iter().flat_map(|r| r.q.iter().map(|s| s.std))),
        );
        join(
            &mut hour.tcp_spread_m,
            mean(&mut recordings.iter().map(|r| r.tcp_spread_m)),
        );
        join(
            &mut hour.contact_n,
            mean(&mut outcome.contacts.iter().map(|c| c.force_n)),
        );
        join(&mut hour.wall_ns_per_tick, 1e9 * wall_s / ticks.max(1) as f64);
        hour.laps += 1;
        hour.ticks += ticks;
        hour.missed += u64::from(outcome.statistics.missed.saturating_sub(self.missed));
        hour.late += u64::from(outcome.statistics.late.saturating_sub(self.late));
        hour.repaired += counted(&outcome.link) + controller.saturating_sub(self.controller_repaired);
        hour.recordings += recordings.len() as u64;
        hour.faults += outcome.faults.len() as u64;
        hour.max_torque_nm = hour.max_torque_nm.max(outcome.telemetry.max_torque_nm);
        hour.resident_kib = resident_kib();
        *self = Self {
            now_us: outcome.simulated_us,
            ticks: outcome.ticks,
            missed: outcome.statistics.missed,
            late: outcome.statistics.late,
            controller_repaired: controller,
        };
    }
}

/// Shows a lap's progress as the soak's.
struct Laps<'a> {
    inner: &'a mut dyn CampaignObserver,
    hours: f64,
}

impl CampaignObserver for Laps<'_> {
    fn event(&mut self, now_us: u64, arrival: &Arrival) {
        self.inner.event(now_us, arrival);
    }

    fn progress(&mut self, progress: &Progress) {
        // Minutes of robot time are counted in place of poses: laps have no end.
        self.inner.progress(&Progress {
            stage: if progress.stage == CampaignStage::Done {
                CampaignStage::Home
            } else {
                progress.stage
            },
            done: (progress.device_s / 60.0) as usize,
            done_before: 0,
            poses: (self.hours * 60.0).ceil() as usize,
            ..*progress
        });
    }

    fn note(&mut self, text: &str) {
        self.inner.note(text);
    }
}

/// Memory of this process, in KiB; 0 if the system does not tell.
fn resident_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))
        .and_then(|rest| rest.split_whitespace().next()?.parse().ok())
        .unwrap_or(0)
}

/// What is not as it was in the first hour.
fn complaints(hours: &[Hour]) -> Vec<String> {
    let mut out = Vec::new();
    for (hour, number) in hours.iter().zip(1..) {
        for (count, what) in [
            (hour.missed, "ticks were missed"),
            (hour.late, "commands came late"),
            (hour.repaired, "frames had to be repaired"),
        ] {
            if count > 0 {
                out.push(format!("hour {number}: {count} {what}"));
            }
        }
    }
    // On an arm whose nest seats badly, some are usual, and the arm goes on after them.
    let (early, late) = hours.split_at(hours.len() / 2);
    let sum = |hours: &[Hour], of: fn(&Hour) -> u64| hours.iter().map(of).sum::<u64>() as f64;
    let laps = [early, late].map(|hours| sum(hours, |hour| hour.laps.into()));
    let faults = [early, late].map(|hours| sum(hours, |hour| hour.faults));
    let expected = faults[0] * laps[1] / laps[0].max(1.0);
    if faults[1] > expected + CHANCE * (expected + 1.0).sqrt() {
        out.push(format!(
            "faults in the first {} laps: {}, in the other {}: {}",
            laps[0], faults[0], laps[1], faults[1]
        ));
    }
    let (Some(first), Some(last)) = (hours.first(), hours.last()) else {
        return out;
    };
    if last.resident_kib > first.resident_kib + GROWTH_KIB {
        out.push(format!(
            "memory grew from {} to {} KiB after the first hour",
            first.resident_kib, last.resident_kib
        ));
    }
    for (what, first, last) in [
        ("the noise of the joint angles", first.q_std_rad, last.q_std_rad),
        ("the spread of the TCP", first.tcp_spread_m, last.tcp_spread_m),
        ("the force at contact", first.contact_n, last.contact_n),
        ("the largest torque", first.max_torque_nm, last.max_torque_nm),
    ] {
        if (last - first).abs() > DRIFT * first.abs() {
            out.push(format!("{what} went from {first:.3e} to {last:.3e}"));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if growth or drift is not reported, or if an unchanged quantity or a rare fault is.
    #[test]
    fn what_changes_is_complained_of() {
        let hour = Hour {
            laps: 6,
            q_std_rad: 1e-5,
            tcp_spread_m: 1e-4,
            contact_n: 7.6,
            max_torque_nm: 70.0,
            resident_kib: 40_000,
            ..Hour::default()
        };
        assert!(complaints(&[hour; 3]).is_empty());
        let rare = Hour { faults: 1, ..hour };
        assert!(complaints(&[rare; 3]).is_empty());
        assert!(complaints(&[hour, rare]).is_empty());
        let worse: [(Hour, &str); 5] = [
            (Hour { faults: 4, ..hour }, "faults"),
            (Hour { missed: 2, ..hour }, "missed"),
            (
                Hour {
                    resident_kib: 60_000,
                    ..hour
                },
                "memory",
            ),
            (
                Hour {
                    q_std_rad: 1.2e-5,
                    ..hour
                },
                "noise",
            ),
            (Hour { contact_n: 9.0, ..hour }, "force"),
        ];
        for (last, word) in worse {
            let said = complaints(&[hour, last]);
            assert_eq!(said.len(), 1, "{said:?}");
            assert!(said[0].contains(word), "{said:?}");
        }
        assert!(resident_kib() > 0 || !cfg!(target_os = "linux"));
    }
}
