//! Second reading of a bag: the joint states of its rests, and the poses as a table.

use core::fmt::Write as _;
use std::path::{Path, PathBuf};

use spherecal_model::input::ReadingProgress;
use spherecal_model::printable;

use super::error::BagError;
use super::files::files;
use super::joints::JointReader;
use super::records::each_message;
use super::rests::{RestPose, Rests};
use super::targets::{Where, targets};
use super::topics::{Wanted, bad_message};
use super::words::{judge, mixed_targets, notes};

/// The poses of a bag.
#[derive(Clone, Debug, PartialEq)]
pub struct Poses {
    rows: Vec<RestPose>,
    places: Vec<String>,
    /// How the poses were formed, and what was left out.
    pub notes: Vec<String>,
}

impl Poses {
    /// Number of poses; at least one.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there are none; never so for a bag that was read.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The table that `identify --data` takes: q1.. in rad, tau1.. in N m where all poses have them, and points in m or
    /// spheres with placements.
    pub fn to_csv(&self) -> String {
        let joints = self.rows.first().map_or(0, |pose| pose.q.len());
        let torques = self.rows.iter().all(|pose| pose.effort.is_some());
        let has = |wanted: fn(&Where) -> bool| self.rows.iter().any(|pose| wanted(&pose.measured.at));
        let points = has(|at| matches!(at, Where::Point(_)));
        let spheres = has(|at| matches!(at, Where::Sphere { .. }));
        let named = spheres && self.places.iter().any(|place| !place.is_empty());
        let mut columns: Vec<String> = (1..=joints).map(|j| format!("q{j}")).collect();
        if torques {
            columns.extend((1..=joints).map(|j| format!("tau{j}")));
        }
        let more = [
            (points, "x_m"),
            (points, "y_m"),
            (points, "z_m"),
            (spheres, "sphere"),
            (named, "place"),
        ];
        columns.extend(
            more.iter()
                .filter(|(there, _)| *there)
                .map(|(_, name)| (*name).to_owned()),
        );
        let mut out = columns.join(",");
        out.push('\n');
        for pose in &self.rows {
            let mut cells: Vec<String> = pose.q.iter().map(f64::to_string).collect();
            if torques {
                cells.extend(pose.effort.iter().flatten().map(f64::to_string));
            }
            match pose.measured.at {
                Where::Point(at) => {
                    cells.extend(at.iter().map(f64::to_string));
                    cells.extend([spheres, named].iter().filter(|there| **there).map(|_| String::new()));
                }
                Where::Sphere { sphere, place } => {
                    cells.extend(std::iter::repeat_n(String::new(), if points { 3 } else { 0 }));
                    cells.push(sphere.to_string());
                    if named {
                        let name = self.places.get(place).map_or("", String::as_str);
                        let name = if name.is_empty() { "unnamed" } else { name };
                        cells.push(format!("\"{}\"", printable(name).replace('"', "\"\"")));
                    }
                }
            }
            let _ = writeln!(out, "{}", cells.join(","));
        }
        out
    }
}

/// Reads the poses of a bag: a file in MCAP or SQLite, or the folder of a bag. `progress` counts the poses and bytes of both
/// readings.
///
/// # Errors
/// Files that are no bag or are damaged; topics that are missing or not clear; joints that are not the robot's; messages
/// that cannot be used; a bag without a pose.
pub fn read_bag(path: &Path, wanted: &Wanted, progress: &mut dyn FnMut(ReadingProgress)) -> Result<Poses, BagError> {
    let bag = path.display().to_string();
    let files = files(path)?;
    let size = |file: &PathBuf| std::fs::metadata(file).map_or(0, |m| m.len());
    let total_bytes = 2 * files.iter().map(size).sum::<u64>();
    let mut before = 0;
    let found = {
        let mut file = 0;
        targets(&bag, &files, wanted, &mut |bytes| {
            // A file begins anew.
            if bytes < file {
                before += file;
            }
            file = bytes;
            progress(ReadingProgress {
                rows: 0,
                bytes: before + bytes,
                total_bytes,
            });
        })?
    };
    let mut rests = Rests::new(&found.all, wanted.rest_rad);
    let mut reader = JointReader::new(wanted);
    let mut number = 0;
    let mut done = total_bytes / 2;
    for path in &files {
        let poses = std::cell::Cell::new(0);
        each_message(
            path,
            &mut |bytes| {
                progress(ReadingProgress {
                    rows: poses.get(),
                    bytes: done + bytes,
                    total_bytes,
                });
            },
            &mut |message| {
                if message.topic.name != found.chosen.joints.name {
                    return Ok(());
                }
                number += 1;
                let refused = |refusal| bad_message(path, message.topic, number, refusal);
                let taken = reader.take(message, found.by_header).map_err(refused)?;
                if let Some(time_ns) = taken {
                    let effort = reader.effort.as_deref().filter(|_| wanted.effort_nm);
                    rests
                        .push(time_ns, &reader.q, effort)
                        .map_err(|mixed| mixed_targets(&bag, &found, mixed))?;
                    poses.set(rests.poses.len());
                }
                Ok(())
            },
        )?;
        done += size(path);
    }
    rests.finish().map_err(|mixed| mixed_targets(&bag, &found, mixed))?;
    reader.check_joints(&bag, &found)?;
    judge(&bag, wanted, &found, &rests)?;
    let notes = notes(wanted, &found, &rests, &reader);
    Ok(Poses {
        rows: rests.poses,
        places: found.places,
        notes,
    })
}
