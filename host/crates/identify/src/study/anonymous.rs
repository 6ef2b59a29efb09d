//! A table of poses that tells nothing of where it comes from, for sharing.
//!
//! ```text
//!   Recordings ─▶ joints, torques, targets, place numbers, set ─▶ CSV
//!        names of files, operators, labels, further columns: left out
//! ```
//!
//! Measured points are moved into a frame of their own: its origin is their mean, its axes are the directions of their
//! spread. So the table does not tell where the instrument stood. An identification estimates that frame anyway, and gives the
//! same robot.

use core::fmt::Write as _;

use nalgebra::{Matrix3, Rotation3, SymmetricEigen, UnitQuaternion, Vector3};
use spherecal_model::{Set, Target};

use crate::recordings::Recordings;

/// The frame of all measured points: directions of their spread, and their mean (m).
fn own_frame(recordings: &Recordings) -> (Rotation3<f64>, Vector3<f64>) {
    let points: Vec<Vector3<f64>> = recordings
        .experiment
        .observations
        .iter()
        .flat_map(|o| match &o.target {
            Target::Point(p) => vec![Vector3::from(*p)],
            Target::Points(all) => all.iter().flatten().map(|p| Vector3::from(*p)).collect(),
            Target::Frame(pose) => vec![pose.position],
            Target::Sphere { .. } => Vec::new(),
        })
        .collect();
    let count = points.len().max(1) as f64;
    let mean = points.iter().sum::<Vector3<f64>>() / count;
    let spread: Matrix3<f64> = points.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
    let mut axes = SymmetricEigen::new(spread).eigenvectors;
    if axes.determinant() < 0.0 {
        axes.column_mut(0).neg_mut();
    }
    (Rotation3::from_matrix_unchecked(axes), mean)
}

/// The rows of a study as CSV, in the columns that `identify` takes: q1.. in rad, tau1.. in N m, targets in m.
/// Placements are numbered in the order in which they come. Rows of the validation table are left out.
pub fn anonymous_csv(recordings: &Recordings) -> String {
    let observations = &recordings.experiment.observations;
    let joints = recordings.experiment.robot.joints.len();
    let has_tau = observations.iter().any(|o| o.tau.is_some());
    let has = |wanted: fn(&Target) -> bool| observations.iter().any(|o| wanted(&o.target));
    let numbered = observations
        .iter()
        .map(|o| match &o.target {
            Target::Points(all) => all.len(),
            _ => 0,
        })
        .max()
        .unwrap_or(0);
    let (point, frame) = (
        has(|t| matches!(t, Target::Point(_) | Target::Frame(_))),
        has(|t| matches!(t, Target::Frame(_))),
    );
    let sphere = has(|t| matches!(t, Target::Sphere { .. }));
    let mut columns: Vec<String> = (1..=joints).map(|j| format!("q{j}")).collect();
    if has_tau {
        columns.extend((1..=joints).map(|j| format!("tau{j}")));
    }
    if point {
        columns.extend(["x_m", "y_m", "z_m"].map(str::to_owned));
    }
    if frame {
        columns.extend(["qw", "qx", "qy", "qz"].map(str::to_owned));
    }
    for k in 1..=numbered {
        columns.extend(["x", "y", "z"].map(|axis| format!("{axis}{k}_m")));
    }
    if sphere {
        columns.push("sphere".to_owned());
    }
    columns.extend(["place".to_owned(), "set".to_owned()]);
    let (axes, mean) = own_frame(recordings);
    let moved = |p: &Vector3<f64>| axes.inverse() * (p - mean);
    let mut text = columns.join(",") + "\n";
    for (observation, sample) in observations.iter().zip(&recordings.samples) {
        let mut cells: Vec<String> = observation.q.iter().map(f64::to_string).collect();
        if has_tau {
            match &observation.tau {
                Some(tau) => cells.extend(tau.iter().map(f64::to_string)),
                None => cells.extend(std::iter::repeat_n(String::new(), joints)),
            }
        }
        let of = |p: Option<Vector3<f64>>| match p {
            Some(p) => moved(&p).iter().map(f64::to_string).collect::<Vec<_>>(),
            None => vec![String::new(); 3],
        };
        let target = &observation.target;
        if point {
            cells.extend(of(match target {
                Target::Point(p) => Some(Vector3::from(*p)),
                Target::Frame(pose) => Some(pose.position),
                _ => None,
            }));
        }
        if frame {
            match target {
                Target::Frame(pose) => {
                    let turned = axes.inverse() * Rotation3::from_matrix_unchecked(pose.rotation);
                    let q = UnitQuaternion::from_rotation_matrix(&turned);
                    cells.extend([q.w, q.i, q.j, q.k].map(|x| x.to_string()));
                }
                _ => cells.extend(std::iter::repeat_n(String::new(), 4)),
            }
        }
        for k in 0..numbered {
            cells.extend(of(match target {
                Target::Points(all) => all.get(k).copied().flatten().map(Vector3::from),
                _ => None,
            }));
        }
        if sphere {
            cells.push(match target {
                Target::Sphere { sphere, .. } => sphere.to_string(),
                _ => String::new(),
            });
        }
        cells.push((sample.place + 1).to_string());
        cells.push(match observation.set {
            Set::Calibrate => "calibrate".to_owned(),
            Set::Validate => "validate".to_owned(),
        });
        // Writing to a text cannot fail.
        let _ = writeln!(text, "{}", cells.join(","));
    }
    text
}
