//! Recordings from a stored campaign.

use std::collections::BTreeMap;

use super::Recordings;
use spherecal_identify::arcs::{Measured, MeasuredArc};
use spherecal_identify::{Experiment, Observation, Set, Target};
use spherecal_job::Measurements;

impl From<&Measurements> for Recordings {
    fn from(m: &Measurements) -> Self {
        let measured = |purpose: &str| -> Vec<Measured> {
            let shots = m.laser.iter().filter(|s| s.purpose == purpose);
            let points = shots.map(|s| Measured {
                q: s.q.clone(),
                point_m: s.point_m,
            });
            points.collect()
        };
        let arcs = |prefix: &str| -> Vec<MeasuredArc> {
            let mut arcs: BTreeMap<usize, Vec<Measured>> = BTreeMap::new();
            for shot in &m.laser {
                if let Some(joint) = shot.purpose.strip_prefix(prefix).and_then(|j| j.parse().ok()) {
                    arcs.entry(joint).or_default().push(Measured {
                        q: shot.q.clone(),
                        point_m: shot.point_m,
                    });
                }
            }
            let arcs = arcs
                .into_iter()
                .map(|(joint, measured)| MeasuredArc { joint, measured });
            arcs.collect()
        };
        let laser_points = measured("calibrate").into_iter().map(|p| Observation {
            q: p.q,
            tau: None,
            target: Target::Point(p.point_m),
            set: Set::Calibrate,
        });
        Self {
            spheres: m.experiment(),
            laser: Experiment {
                robot: m.robot.clone(),
                tool: m.tool,
                spheres: Vec::new(),
                observations: laser_points.collect(),
            },
            base_arcs: arcs("base_"),
            tool_arcs: arcs("tool_"),
            frames: None,
            validation: measured("validate"),
            contact_force: Vec::new(),
            seed: m.seed,
        }
    }
}
