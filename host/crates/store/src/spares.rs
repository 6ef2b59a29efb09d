//! The second copy of each run's settings, certificate and poses, from which `recover` restores a damaged
//! row.

use spherecal_model::Sphere;
use sqlx::any::AnyRow;
use sqlx::{AnyConnection, AssertSqlSafe, Row as _};

use super::columns::put_digest;
use super::digest::{self, recording_subject};
use super::seal::{POSES, RUNS, SEALED, SPARES, SPHERES, SealedValue, seal, seal_unsealed};
use super::{SqlStore, StoreError};

/// Seals the settings of a new run, and stores their second copy. `certificate` is sorted by id.
pub(super) async fn seal_settings(t: &mut AnyConnection, run: i64, certificate: &[Sphere]) -> Result<(), sqlx::Error> {
    put_spares(t, run, certificate).await?;
    for table in [RUNS, SPARES, SPHERES, POSES] {
        seal(t, &table, run, &[]).await?;
    }
    Ok(())
}

/// Stores the second copy of a run's settings, certificate and poses, where there is none: a row that was damaged since must
/// not replace its copy.
pub(super) async fn put_spares(t: &mut AnyConnection, run: i64, certificate: &[Sphere]) -> Result<(), sqlx::Error> {
    for name in SPARED {
        sqlx::query(AssertSqlSafe(format!(
            "INSERT INTO spares (run, name, value) SELECT run, '{name}', CAST({name} AS TEXT) FROM runs WHERE run = $1 ON CONFLICT DO NOTHING"
        )))
        .bind(run)
        .execute(&mut *t)
        .await?;
    }
    sqlx::query("INSERT INTO spares (run, name, value) VALUES ($1, 'spheres', $2) ON CONFLICT DO NOTHING")
        .bind(run)
        .bind(spare_of(certificate))
        .execute(&mut *t)
        .await?;
    let statement = format!("SELECT {} FROM poses WHERE run = $1 ORDER BY position", POSE.join(", "));
    let poses = sqlx::query(AssertSqlSafe(statement))
        .bind(run)
        .fetch_all(&mut *t)
        .await?;
    let lines = poses.iter().map(spare_of_pose).collect::<Result<String, _>>()?;
    sqlx::query("INSERT INTO spares (run, name, value) VALUES ($1, 'poses', $2) ON CONFLICT DO NOTHING")
        .bind(run)
        .bind(lines)
        .execute(t)
        .await
        .map(|_| ())
}

/// Columns of a pose that have a second copy: all but its run and whether it was given up.
const POSE: [&str; 8] = ["sphere", "pose", "position", "qw", "qx", "qy", "qz", "elbow_rad"];

/// How many of them, from the first on, are whole numbers.
const WHOLE: usize = 3;

/// A pose as a line of text that reads back bit by bit. An elbow angle that is not given is a dash.
fn spare_of_pose(row: &AnyRow) -> Result<String, sqlx::Error> {
    let mut line = String::new();
    for (column, at) in POSE.iter().zip(0..) {
        if at < WHOLE {
            line.push_str(&format!("{} ", row.try_get::<i64, _>(*column)?));
        } else {
            match row.try_get::<Option<f64>, _>(*column)? {
                Some(value) => line.push_str(&format!("{:016x} ", value.to_bits())),
                None => line.push_str("- "),
            }
        }
    }
    Ok(line + "\n")
}

/// The values of the poses of such a text, in the order of the columns.
pub(super) fn poses_of(spare: &str) -> Option<Vec<Vec<SealedValue>>> {
    let value = |(word, at): (&str, usize)| match word {
        "-" => Some(SealedValue::Nothing),
        word if at < WHOLE => word.parse().ok().map(SealedValue::Whole),
        word => u64::from_str_radix(word, 16)
            .ok()
            .map(|bits| SealedValue::Real(f64::from_bits(bits))),
    };
    let pose = |line: &str| line.split_whitespace().zip(0..).map(value).collect::<Option<Vec<_>>>();
    let poses: Vec<_> = spare.lines().map(pose).collect::<Option<_>>()?;
    poses.iter().all(|pose| pose.len() == POSE.len()).then_some(poses)
}

/// Columns of a run that have a second copy: all but its number and its state.
pub(super) const SPARED: [&str; 10] = [
    "created_utc",
    "seed",
    "link",
    "robot",
    "robot_json",
    "tool_json",
    "config_toml",
    "plan_json",
    "program",
    "arm",
];

/// The certificate as text that reads back bit by bit: a line for each sphere, with its id and the
/// bits of x, y, z and sigma.
pub(super) fn spare_of(spheres: &[Sphere]) -> String {
    let line = |s: &Sphere| {
        let [x, y, z] = s.position_m;
        let bits = [x, y, z, s.sigma_m].map(|value| format!("{:016x}", (value + 0.0).to_bits()));
        format!("{} {}\n", s.id, bits.join(" "))
    };
    spheres.iter().map(line).collect()
}

/// The certificate of such a text: for each sphere its id, and x, y, z and sigma.
pub(super) fn spheres_of(spare: &str) -> Option<Vec<(i64, [f64; 4])>> {
    spare
        .lines()
        .map(|line| {
            let mut words = line.split(' ');
            let id = words.next()?.parse().ok()?;
            let mut values = [0.0; 4];
            for value in &mut values {
                *value = f64::from_bits(u64::from_str_radix(words.next()?, 16).ok()?);
            }
            Some((id, values))
        })
        .collect()
}

impl SqlStore {
    /// Seals every row of every run that has no digest: for a file of an older schema, whose rows have none.
    /// A digest that is there stays: a row that differs from it is damaged.
    pub(super) fn seal_everything(&mut self) -> Result<(), StoreError> {
        for run in self.run_numbers()? {
            let digests = self.digests(run)?;
            let recordings = self.unchecked_recordings(run)?;
            let spheres = self.spheres(run)?;
            self.write(async |t| {
                for r in &recordings {
                    let subject = recording_subject(r.sphere, r.pose);
                    if !digests.contains_key(&subject) {
                        put_digest(t, run, &subject, digest::of_recording(r)).await?;
                    }
                }
                put_spares(t, run, &spheres).await?;
                for table in SEALED {
                    seal_unsealed(t, &table, run).await?;
                }
                Ok(())
            })?;
        }
        Ok(())
    }
}
