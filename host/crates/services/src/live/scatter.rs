//! How well the nominal model explains the recordings so far, before anything is identified: the
//! scatter of its TCP on each visit, although the real TCP stood still.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use spherecal_shared::protocol::host::Recording;
use spherecal_shared::robot::{MdhRow, Robot, Tool};

use spherecal_model::robots::table_frames;

/// The scatter of the nominal TCP about each visit's own mean.
#[derive(Clone, Debug)]
pub struct Scatter {
    rows: Vec<MdhRow<f64>>,
    tcp_m: Vector3<f64>,
    contacts: usize,
    /// TCP of every recording in F0, by visit: number of contacts so far, and the sphere.
    seen: BTreeMap<(usize, u32), Vec<Vector3<f64>>>,
}

impl Scatter {
    /// Nothing recorded yet.
    pub fn new(robot: &Robot, tool: &Tool) -> Self {
        Self {
            rows: robot.joints.iter().map(|j| j.mdh).collect(),
            tcp_m: tool.tcp(),
            contacts: 0,
            seen: BTreeMap::new(),
        }
    }

    /// A visit begins.
    pub fn contact(&mut self) {
        self.contacts += 1;
    }

    /// Contacts so far.
    pub fn contacts(&self) -> usize {
        self.contacts
    }

    /// Adds a recording.
    pub fn record(&mut self, recording: &Recording) {
        let q: Vec<f64> = recording.q.iter().map(|s| s.mean).collect();
        if let Some(flange) = table_frames(&self.rows, &q).last() {
            let tcp = flange.position + flange.rotation * self.tcp_m;
            self.seen
                .entry((self.contacts, recording.sphere))
                .or_default()
                .push(tcp);
        }
    }

    /// Root mean square of the scatter, in mm: the error that identification can remove. `None`
    /// until a visit has two recordings.
    pub fn residual_mm(&self) -> Option<f64> {
        let (mut sum, mut count) = (0.0, 0usize);
        for points in self.seen.values().filter(|points| points.len() > 1) {
            let mean = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
            sum += points.iter().map(|p| (p - mean).norm_squared()).sum::<f64>();
            count += points.len() - 1;
        }
        (count > 0).then(|| (sum / count as f64).sqrt() * 1e3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use spherecal_shared::protocol::host::SignalStatistics;
    use spherecal_shared::robot::{iiwa7, iiwa7_tool};

    // Fails if the residual is not the scatter of the nominal TCP about each visit's own mean: two
    // recordings 2 mm apart have 1.41 mm.
    #[test]
    fn the_residual_is_the_scatter_of_each_visit() {
        let mut scatter = Scatter::new(&iiwa7(), &iiwa7_tool());
        let at = |q1: f64| {
            let mut q: heapless::Vec<SignalStatistics, 8> = heapless::Vec::new();
            for k in 0..7 {
                let mean = [q1, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0][k];
                let signal = SignalStatistics {
                    mean,
                    ..SignalStatistics::default()
                };
                q.push(signal).expect("room");
            }
            Recording {
                sphere: 1,
                pose: 1,
                start_us: 0,
                end_us: 0,
                count: 1,
                gaps: 0,
                q,
                tau: heapless::Vec::new(),
                tcp_spread_m: 0.0,
                force_n: [0.0; 3],
            }
        };
        scatter.record(&at(0.0));
        assert_eq!(scatter.residual_mm(), None);
        let radius = {
            let points = scatter.seen.values().next().expect("a visit");
            points[0].xy().norm()
        };
        scatter.record(&at(2e-3 / radius));
        let residual = scatter.residual_mm().expect("two recordings");
        assert!((residual - 2f64.sqrt()).abs() < 1e-4, "{residual}");
        // Another visit has a mean of its own.
        scatter.contact();
        scatter.record(&at(1.0));
        scatter.record(&at(1.0));
        let residual = scatter.residual_mm().expect("more");
        assert!((residual - 1.0).abs() < 1e-4, "{residual}");
    }
}
