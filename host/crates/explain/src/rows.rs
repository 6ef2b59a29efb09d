//! The rows of a table as the fits need them.

use std::collections::HashMap;

use nalgebra::{DVector, Matrix3, Vector3};
use spherecal_model::input::{Adjustments, between};
use spherecal_model::{Observation, Sphere, Target};

/// A row: joint columns and where the TCP was.
#[derive(Clone, Debug)]
pub(crate) struct Row {
    pub(crate) q: Vec<f64>,
    /// Target in the frame of its group, in m.
    pub(crate) at: Vector3<f64>,
    /// Rotation of the body, where it was measured.
    pub(crate) turn: Option<Matrix3<f64>>,
    /// Rows with the same number have one frame: the instrument's, or that of one placement of the plate.
    pub(crate) group: usize,
    /// Number of the chain that it is of.
    pub(crate) limb: usize,
}

/// The rows of observations that say where the TCP was; of several targets the first.
pub(crate) fn rows(observations: &[Observation], spheres: &[Sphere]) -> Vec<Row> {
    let mut groups: HashMap<Option<u32>, usize> = HashMap::new();
    let mut out = Vec::with_capacity(observations.len());
    for observation in observations {
        let (at, turn, frame) = match &observation.target {
            Target::Point(p) => (Some(*p), None, None),
            Target::Points(all) => (all.first().copied().flatten(), None, None),
            Target::Frame(pose) => (Some(pose.position.into()), Some(pose.rotation), None),
            Target::Sphere { sphere, place } => {
                let known = spheres.iter().find(|s| s.id == *sphere);
                (known.map(|s| s.position_m), None, Some(*place))
            }
        };
        let Some(at) = at else { continue };
        let next = groups.len();
        out.push(Row {
            q: observation.q.clone(),
            at: at.into(),
            turn,
            group: *groups.entry(frame).or_insert(next),
            limb: 0,
        });
    }
    out
}

/// At most `most` rows, evenly from all.
pub(crate) fn some(rows: &[Row], most: usize) -> Vec<Row> {
    let n = rows.len();
    if n <= most {
        return rows.to_vec();
    }
    (0..most).filter_map(|k| rows.get(k * n / most)).cloned().collect()
}

/// Corrected rows, at most `most`.
pub(crate) fn adjusted(rows: &[Row], adjust: &Adjustments, most: usize) -> Vec<Row> {
    let (first, count) = adjust.shifted_rows(rows.len());
    let take = count.min(most).max(1);
    let n = rows.first().map_or(0, |r| r.q.len());
    let (map, zero) = adjust.joint_map(n);
    let columns = |k: usize| rows.get(k).map(|row| row.q.as_slice());
    let mut out = Vec::with_capacity(take);
    for k in 0..take {
        let i = first + k * count / take;
        let (Some(columns), Some(target)) = (between(&columns, i as f64 - adjust.shift), rows.get(i)) else {
            continue;
        };
        let q = &map * DVector::from_vec(columns) + &zero;
        let (turn, at) = match &target.turn {
            Some(turn) => {
                let (turn, at) = adjust.frame(turn, &target.at);
                (Some(turn), at)
            }
            None => (None, adjust.point(&target.at)),
        };
        out.push(Row {
            q: q.as_slice().to_vec(),
            at,
            turn,
            group: target.group,
            limb: target.limb,
        });
    }
    out
}
