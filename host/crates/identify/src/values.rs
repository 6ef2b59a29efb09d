//! The parameters of a state: their values, and steps of them.

use nalgebra::Vector3;

use super::chain::State;
use super::parameters::Kind;

impl State {
    /// The value of a parameter (base rotations: components of the rotation vector).
    pub(crate) fn get(&self, kind: Kind) -> f64 {
        let value = match kind {
            Kind::Alpha(i) => self.rows.get(i).map(|r| r.alpha),
            Kind::A(i) => self.rows.get(i).map(|r| r.a),
            Kind::D(i) => self.rows.get(i).map(|r| r.d),
            Kind::Beta(i) => self.rows.get(i).map(|r| r.beta),
            Kind::Theta(i) => self.rows.get(i).map(|r| r.theta),
            Kind::Tool(k) => self.tcp.get(k).copied(),
            Kind::Target(t, k) => self.targets.get(t).map(|p| p[k]),
            Kind::Body(k) => Some(nalgebra::Rotation3::from_matrix_unchecked(self.body).scaled_axis()[k]),
            Kind::Bending(i, k) => self.bending.get(i).and_then(|b| b.get(k)).copied(),
            Kind::Tilt(k) => self.tilt.get(k).copied(),
            Kind::Scale => Some(self.scale),
            Kind::Compliance(i) => self.compliance.get(i).copied(),
            Kind::Cosine(i, k) => self
                .harmonics
                .get(i)
                .and_then(|h| h.get(k.wrapping_sub(1)))
                .map(|h| h[0]),
            Kind::Sine(i, k) => self
                .harmonics
                .get(i)
                .and_then(|h| h.get(k.wrapping_sub(1)))
                .map(|h| h[1]),
            Kind::Base(f, k) if k < 3 => self.bases.get(f).map(|b| b.position[k]),
            Kind::Base(f, k) => self.bases.get(f).map(|b| b.rotation_vector()[k - 3]),
            Kind::Sphere(s, k) => self.spheres.get(s).map(|p| p[k]),
            Kind::Seat(s, k) => self.seats.get(s).map(|p| p[k]),
        };
        value.unwrap_or_default()
    }

    /// Adds `step` to a parameter. A base rotation turns about the reference frame's axes through
    /// the pivot, a rotation of the measured body about the flange's axes.
    pub(crate) fn add(&mut self, kind: Kind, step: f64) {
        let slot = match kind {
            Kind::Alpha(i) => self.rows.get_mut(i).map(|r| &mut r.alpha),
            Kind::A(i) => self.rows.get_mut(i).map(|r| &mut r.a),
            Kind::D(i) => self.rows.get_mut(i).map(|r| &mut r.d),
            Kind::Beta(i) => self.rows.get_mut(i).map(|r| &mut r.beta),
            Kind::Theta(i) => self.rows.get_mut(i).map(|r| &mut r.theta),
            Kind::Tool(k) => self.tcp.get_mut(k),
            Kind::Target(t, k) => self.targets.get_mut(t).map(|p| &mut p[k]),
            Kind::Body(k) => {
                self.body = nalgebra::Rotation3::new(Vector3::ith(k, step)) * self.body;
                None
            }
            Kind::Bending(i, k) => self.bending.get_mut(i).and_then(|b| b.get_mut(k)),
            Kind::Tilt(k) => self.tilt.get_mut(k),
            Kind::Scale => Some(&mut self.scale),
            Kind::Compliance(i) => self.compliance.get_mut(i),
            Kind::Cosine(i, k) => order(&mut self.harmonics, i, k).map(|h| &mut h[0]),
            Kind::Sine(i, k) => order(&mut self.harmonics, i, k).map(|h| &mut h[1]),
            Kind::Base(f, k) if k < 3 => self.bases.get_mut(f).map(|b| &mut b.position[k]),
            Kind::Base(f, k) => {
                if let Some(base) = self.bases.get_mut(f) {
                    let mut axis = Vector3::zeros();
                    axis[(k - 3).min(2)] = step;
                    let turn = nalgebra::Rotation3::new(axis);
                    let pivot = self.pivots.get(f).copied().unwrap_or_default();
                    base.rotation = turn * base.rotation;
                    base.position = pivot + turn * (base.position - pivot);
                }
                None
            }
            Kind::Sphere(s, k) => self.spheres.get_mut(s).map(|p| &mut p[k]),
            Kind::Seat(s, k) => self.seats.get_mut(s).map(|p| &mut p[k]),
        };
        if let Some(slot) = slot {
            *slot += step;
        }
    }
}

fn order(harmonics: &mut [Vec<[f64; 2]>], joint: usize, k: usize) -> Option<&mut [f64; 2]> {
    harmonics.get_mut(joint).and_then(|h| h.get_mut(k.wrapping_sub(1)))
}
