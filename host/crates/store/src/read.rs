//! Reads the data of a run, in the order in which they arrived.

use std::collections::{BTreeMap, BTreeSet};

use spherecal_shared::MAX_JOINTS;
use spherecal_shared::protocol::host::{
    Contact, Coupled, Fault, FaultReport, Phase, PhaseChange, Recording, SignalStatistics,
};

use super::digest::{self, recording_subject};
use super::{SqlStore, StoreError};
use spherecal_model::{LaserShot, Sphere};

impl SqlStore {
    /// The plate's certificate.
    pub(super) fn spheres(&mut self, run: i64) -> Result<Vec<Sphere>, StoreError> {
        let rows = self.rows("SELECT * FROM spheres WHERE run = $1 ORDER BY sphere", run)?;
        rows.iter()
            .map(|row| {
                Ok(Sphere {
                    id: self.count(row, "sphere")?,
                    position_m: self.triple(row, ["x_m", "y_m", "z_m"])?,
                    sigma_m: self.get(row, "sigma_m")?,
                })
            })
            .collect()
    }

    /// Poses that were given up: sphere, pose.
    pub(super) fn rejected(&mut self, run: i64) -> Result<BTreeSet<(u32, u32)>, StoreError> {
        let rows = self.rows(
            "SELECT sphere, pose FROM poses WHERE run = $1 AND rejected IS NOT NULL",
            run,
        )?;
        rows.iter()
            .map(|row| Ok((self.count(row, "sphere")?, self.count(row, "pose")?)))
            .collect()
    }

    /// Recordings, in the order in which they came.
    pub(super) fn recordings(&mut self, run: i64) -> Result<Vec<Recording>, StoreError> {
        let recordings = self.unchecked_recordings(run)?;
        let digests = self.digests(run)?;
        for recording in &recordings {
            let subject = recording_subject(recording.sphere, recording.pose);
            let digest = digest::of_recording(recording);
            if digests.get(&subject).is_some_and(|stored| *stored != digest) {
                return Err(StoreError::Damaged {
                    path: self.path.clone(),
                    what: format!(
                        "the recording of pose {} (sphere {}) in run {run} differs from what was written",
                        recording.pose, recording.sphere
                    ),
                });
            }
        }
        Ok(recordings)
    }

    pub(super) fn digests(&mut self, run: i64) -> Result<BTreeMap<String, i64>, StoreError> {
        let rows = self.rows("SELECT subject, digest FROM digests WHERE run = $1", run)?;
        rows.iter()
            .map(|row| Ok((self.get(row, "subject")?, self.get(row, "digest")?)))
            .collect()
    }

    /// Recordings as they are in the file, without the check of their digests.
    pub(super) fn unchecked_recordings(&mut self, run: i64) -> Result<Vec<Recording>, StoreError> {
        let mut joints: BTreeMap<(u32, u32), Vec<[SignalStatistics; 2]>> = BTreeMap::new();
        for row in &self.rows("SELECT * FROM recording_joints WHERE run = $1 ORDER BY joint", run)? {
            let statistics = |mean, std, min, max| {
                Ok::<_, StoreError>(SignalStatistics {
                    mean: self.get(row, mean)?,
                    std: self.get(row, std)?,
                    min: self.get(row, min)?,
                    max: self.get(row, max)?,
                })
            };
            let q = statistics("q_mean_rad", "q_std_rad", "q_min_rad", "q_max_rad")?;
            let tau = statistics("tau_mean_nm", "tau_std_nm", "tau_min_nm", "tau_max_nm")?;
            let pose = (self.count(row, "sphere")?, self.count(row, "pose")?);
            joints.entry(pose).or_default().push([q, tau]);
        }
        let rows = self.rows("SELECT * FROM recordings WHERE run = $1 ORDER BY position", run)?;
        rows.iter()
            .map(|row| {
                let (sphere, pose) = (self.count(row, "sphere")?, self.count(row, "pose")?);
                // The protocol allows no more joints than fit, so a further one cannot have been written.
                let own = joints.remove(&(sphere, pose)).unwrap_or_default();
                let own = || own.iter().take(MAX_JOINTS);
                Ok(Recording {
                    sphere,
                    pose,
                    start_us: self.get::<i64>(row, "start_us")? as u64,
                    end_us: self.get::<i64>(row, "end_us")? as u64,
                    count: self.count(row, "samples")?,
                    gaps: self.count(row, "gaps")?,
                    q: own().map(|[q, _]| *q).collect(),
                    tau: own().map(|[_, tau]| *tau).collect(),
                    tcp_spread_m: self.get(row, "tcp_spread_m")?,
                    force_n: self.triple(row, ["force_x_n", "force_y_n", "force_z_n"])?,
                })
            })
            .collect()
    }

    /// Contacts, in the order in which they came.
    pub(super) fn contacts(&mut self, run: i64) -> Result<Vec<Contact>, StoreError> {
        let rows = self.rows("SELECT * FROM contacts WHERE run = $1 ORDER BY session, event", run)?;
        rows.iter()
            .map(|row| {
                Ok(Contact {
                    sphere: self.count(row, "sphere")?,
                    time_us: self.get::<i64>(row, "time_us")? as u64,
                    force_n: self.get(row, "force_n")?,
                    peak_n: self.get(row, "peak_n")?,
                    tare_n: self.triple(row, ["tare_x_n", "tare_y_n", "tare_z_n"])?,
                    tcp_m: self.triple(row, ["tcp_x_m", "tcp_y_m", "tcp_z_m"])?,
                    travel_m: self.get(row, "travel_m")?,
                    latency_ticks: self.count(row, "latency_ticks")?,
                    early_crossings: self.count(row, "early_crossings")?,
                })
            })
            .collect()
    }

    /// Couplings, in the order in which they came.
    pub(super) fn couplings(&mut self, run: i64) -> Result<Vec<Coupled>, StoreError> {
        let rows = self.rows("SELECT * FROM couplings WHERE run = $1 ORDER BY session, event", run)?;
        rows.iter()
            .map(|row| {
                Ok(Coupled {
                    sphere: self.count(row, "sphere")?,
                    time_us: self.get::<i64>(row, "time_us")? as u64,
                    centre_m: self.triple(row, ["centre_x_m", "centre_y_m", "centre_z_m"])?,
                    shift_m: self.get(row, "shift_m")?,
                    test_m: self.get(row, "test_m")?,
                })
            })
            .collect()
    }

    /// Phase changes, in the order in which they came.
    pub(super) fn phases(&mut self, run: i64) -> Result<Vec<PhaseChange>, StoreError> {
        let rows = self.rows("SELECT * FROM phases WHERE run = $1 ORDER BY session, event", run)?;
        rows.iter()
            .map(|row| {
                Ok(PhaseChange {
                    phase: self.named::<Phase>(row, "phase")?,
                    from: self.named::<Phase>(row, "previous")?,
                    time_us: self.get::<i64>(row, "time_us")? as u64,
                    tick: self.get::<i64>(row, "tick")? as u64,
                })
            })
            .collect()
    }

    /// Faults, in the order in which they came.
    pub(super) fn faults(&mut self, run: i64) -> Result<Vec<FaultReport>, StoreError> {
        let rows = self.rows("SELECT * FROM faults WHERE run = $1 ORDER BY session, event", run)?;
        rows.iter()
            .map(|row| {
                let number = |field: &'static str| {
                    let text: String = self.get(row, field)?;
                    Ok::<f64, StoreError>(text.parse().unwrap_or(f64::NAN))
                };
                Ok(FaultReport {
                    fault: self.named::<Fault>(row, "fault")?,
                    phase: self.named::<Phase>(row, "phase")?,
                    time_us: self.get::<i64>(row, "time_us")? as u64,
                    tick: self.get::<i64>(row, "tick")? as u64,
                    joint: u8::try_from(self.count(row, "joint")?).unwrap_or(u8::MAX),
                    value: number("value")?,
                    limit: number("bound")?,
                })
            })
            .collect()
    }

    /// Laser shots, in the order in which they were written.
    pub(super) fn laser(&mut self, run: i64) -> Result<Vec<LaserShot>, StoreError> {
        let shots = self.unchecked_laser(run)?;
        self.compare(run, "laser", digest::of_laser(&shots), "the laser measurements")?;
        Ok(shots)
    }

    /// Laser shots as they are in the file, without the check of their digest.
    pub(super) fn unchecked_laser(&mut self, run: i64) -> Result<Vec<LaserShot>, StoreError> {
        let rows = self.rows("SELECT * FROM laser_shots WHERE run = $1 ORDER BY position", run)?;
        rows.iter()
            .map(|row| {
                Ok(LaserShot {
                    purpose: self.get(row, "purpose")?,
                    q: self.json(row, "q_json")?,
                    point_m: self.triple(row, ["x_m", "y_m", "z_m"])?,
                })
            })
            .collect()
    }
}
