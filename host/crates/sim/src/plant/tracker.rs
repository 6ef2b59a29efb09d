//! The laser tracker: static measurements of the reflector in the nest.
//!
//! For each commanded configuration the arm stands still in free space; its
//! encoders are read (mean of a second) and the tracker measures the reflector
//! through the true geometry with all static errors, in the tracker's own frame.
//!
//! Between the sessions of Section 4.3 of the paper, people touch the equipment: the reflector is
//! put back into its holder, and the tracker is set up again. This limits the accuracy of the
//! paper's laser-calibrated model (`docs/design/identification.md`, world W1), so it is a separate
//! error source.

use nalgebra::Vector3;
use spherecal_model::TrackerSession;
use spherecal_shared::robot::Pose;

use super::random::{Stream, normal, normal3, rpy, stream};
use super::simulation::Plant;
use super::study::Standing;

/// One measurement of the laser tracker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shot<const N: usize> {
    /// Encoder angles as read, in rad.
    pub q_encoder: [f64; N],
    /// Measured joint torques, in N m.
    pub tau: [f64; N],
    /// Measured reflector in the tracker's frame, in m.
    pub point_m: [f64; 3],
}

impl<const N: usize> Plant<N> {
    /// Chooses the session that the next shots belong to.
    pub fn tracker_session(&mut self, session: TrackerSession) {
        self.session = session;
    }

    /// The arm stands still with its encoders at `q` (rad) in free space, and the tracker measures.
    /// Neither moves the plant nor advances its time: the tracker's session has its own time
    /// ([`super::config::TrackerConfig`]).
    pub fn tracker_shot(&mut self, q: &[f64; N]) -> Shot<N> {
        let c = self.config.tracker;
        // The session begins with the first shot.
        let since_last = if self.standing.is_some() { c.shot_s } else { c.after_s };
        let seed = self.config.seed;
        let standing = self.standing.get_or_insert_with(|| Standing::new(&self.world, seed));
        standing.wait(&self.world, since_last);
        let by = standing.move_to(&self.world, q);
        let (link, flange) = standing.tcp(&self.world, q);
        let tau = standing.torques(&self.world, &link);
        let mut q_encoder = standing.read(&self.config.reading, q, &by);
        // Offsets of a session are the same at every shot of it.
        let mut sessions = stream(self.config.seed, Stream::Sessions);
        let aside = normal3(&mut sessions);
        let remount = Vector3::new(aside.x, aside.y, 0.0)
            .try_normalize(1e-9)
            .unwrap_or_default()
            * c.remount_m;
        let restation = normal3(&mut sessions).try_normalize(1e-9).unwrap_or_default() * c.restation_m;
        let mut point = flange.position;
        match self.session {
            TrackerSession::BaseArcs => point += restation,
            TrackerSession::ToolArcs => point += flange.rotation * remount,
            TrackerSession::Measurement => {}
        }
        let tracker = self.tracker_frame();
        let mut seen = tracker.rotation.tr_mul(&(point - tracker.position));
        if c.noise {
            let rng = &mut self.tracker_rng;
            seen += normal3(rng) * c.sigma_m;
            for angle in &mut q_encoder {
                *angle += c.encoder_rad * normal(rng);
            }
        }
        Shot {
            q_encoder,
            tau,
            point_m: seen.into(),
        }
    }

    /// True pose of the tracker's frame in F0. For tests and figures only.
    pub fn tracker_frame(&self) -> Pose<f64> {
        Pose {
            rotation: rpy(self.config.tracker.rpy_rad),
            position: Vector3::from(self.config.tracker.position_m),
        }
    }
}
