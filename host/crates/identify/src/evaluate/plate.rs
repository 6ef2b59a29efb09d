//! What the data themselves say about the plate: sphere by sphere, the TCP
//! must come back to one point, whatever the plate's pose.
//!
//! `p_i + A_i t = c_g` for every sample i at sphere and place g: linear in the
//! tool `t` and the points `c_g`, solved with Cauchy weights.

use std::collections::{BTreeMap, HashMap};

use nalgebra::{Matrix3, Vector3};

use spherecal_model::statistics::median;

use crate::flange::Flange;
use crate::{Experiment, Target};

/// Most pairs of spheres that a message lists.
const LISTED: usize = 3;

/// Mean TCP by place and sphere, in F0, with the nominal geometry.
struct Means {
    keys: Vec<(u32, u32)>,
    at: Vec<Vector3<f64>>,
}

fn means(experiment: &Experiment) -> Means {
    let flange = Flange::new(&experiment.robot);
    let mut keys: Vec<(u32, u32)> = Vec::new();
    let mut numbers: HashMap<(u32, u32), usize> = HashMap::new();
    let mut items: Vec<(usize, Matrix3<f64>, Vector3<f64>)> = Vec::new();
    for o in &experiment.observations {
        if let Target::Sphere { sphere, place } = o.target {
            let key = (place, sphere);
            let group = *numbers.entry(key).or_insert_with(|| {
                keys.push(key);
                keys.len() - 1
            });
            let frame = flange.at(&o.q);
            items.push((group, frame.rotation, frame.position));
        }
    }
    let nominal = experiment.tool.tcp();
    let mut tool = nominal;
    let mut weights = vec![1.0; items.len()];
    let mut at = vec![Vector3::zeros(); keys.len()];
    for _ in 0..20 {
        // Weighted means of rotation and flange by group, then 3 equations for the tool.
        let mut sums = vec![(0.0, Matrix3::zeros(), Vector3::zeros()); keys.len()];
        for ((g, a, p), w) in items.iter().zip(&weights) {
            sums[*g].0 += w;
            sums[*g].1 += a * *w;
            sums[*g].2 += p * *w;
        }
        let mut h = Matrix3::identity() * 1e-6;
        let mut v = nominal * 1e-6;
        for ((g, a, p), w) in items.iter().zip(&weights) {
            let (n, sa, sp) = &sums[*g];
            let (da, dp) = (a - sa / *n, p - sp / *n);
            h += da.transpose() * da * *w;
            v -= da.transpose() * dp * *w;
        }
        tool = h.try_inverse().map_or(tool, |inverse| inverse * v);
        for (slot, (n, sa, sp)) in at.iter_mut().zip(&sums) {
            *slot = (sp + sa * tool) / *n;
        }
        let distance: Vec<f64> = items.iter().map(|(g, a, p)| (p + a * tool - at[*g]).norm()).collect();
        let s = (1.5 * median(distance.clone())).max(1e-6);
        for (w, d) in weights.iter_mut().zip(&distance) {
            *w = 1.0 / (1.0 + (d / s).powi(2));
        }
    }
    Means { keys, at }
}

/// Distances between spheres of one place: sphere, sphere, mean over the places (m).
fn distances(means: &Means) -> Vec<(u32, u32, f64)> {
    let mut by_place: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (group, key) in means.keys.iter().enumerate() {
        by_place.entry(key.0).or_default().push(group);
    }
    let mut sums: BTreeMap<(u32, u32), (f64, f64)> = BTreeMap::new();
    for groups in by_place.values() {
        for &a in groups {
            for &b in groups {
                let (one, two) = (means.keys[a].1, means.keys[b].1);
                if one < two {
                    let sum = sums.entry((one, two)).or_default();
                    sum.0 += (means.at[a] - means.at[b]).norm();
                    sum.1 += 1.0;
                }
            }
        }
    }
    sums.into_iter().map(|((a, b), (d, n))| (a, b, d / n)).collect()
}

/// How the plate contradicts the data by more than `limit` (m), in words with the remedy.
pub(super) fn contradiction(experiment: &Experiment, limit: f64) -> Option<String> {
    let position = |id: u32| {
        let sphere = experiment.spheres.iter().find(|s| s.id == id);
        sphere.map(|s| Vector3::from(s.position_m))
    };
    let off: Vec<String> = distances(&means(experiment))
        .into_iter()
        .filter_map(|(a, b, d)| {
            let certified = match (position(a), position(b)) {
                (Some(p), Some(q)) => (p - q).norm(),
                _ => return Some(format!("sphere {a} or {b} is not on the plate")),
            };
            ((certified - d).abs() > limit).then(|| {
                format!(
                    "spheres {a} and {b} are {:.1} mm apart by the data, {:.1} mm by the plate",
                    d * 1e3,
                    certified * 1e3
                )
            })
        })
        .collect();
    if off.is_empty() {
        return None;
    }
    let more = match off.len().saturating_sub(LISTED) {
        0 => String::new(),
        more => format!(" and {more} more pairs"),
    };
    Some(format!(
        "{}{more}; give the right plate with --plate FILE.toml",
        off.get(..LISTED).unwrap_or(&off).join("; ")
    ))
}
