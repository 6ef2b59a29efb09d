//! Joint velocities: the interface does not send them.

use std::f64::consts::TAU;

use crate::JOINTS;

/// Differentiates joint positions and low-passes the result.
///
/// With the time step `T` and the cut-off frequency `f`:
/// ```text
/// d[k] = (q[k] - q[k-1]) / T
/// v[k] = v[k-1] + a (d[k] - v[k-1]),   a = 1 - exp(-2 pi f T)
/// ```
/// - **Bandwidth**: about `f`. The difference alone weakens a frequency `g` by `sin(pi g T) / (pi g T)`: 2 % at 100 Hz.
/// - **Delay** at low frequencies: `T/2 + T (1 - a) / a`; at 1 ms and 100 Hz 1.64 ms. A velocity that rises steadily is
///   reported late by exactly this.
/// - A step of an encoder of 1e-6 rad shows as at most `a * 1e-6 / T`: 4.7e-4 rad/s at 1 ms and 100 Hz.
///
/// After a gap of several periods `T` is the time since the last position, so that a gap is no jump.
#[derive(Clone, Debug)]
pub struct VelocityFilter {
    cutoff_hz: f64,
    last: Option<[f64; JOINTS]>,
    velocity: [f64; JOINTS],
}

impl VelocityFilter {
    /// A filter with this cut-off frequency, Hz.
    pub fn new(cutoff_hz: f64) -> Self {
        Self {
            cutoff_hz,
            last: None,
            velocity: [0.0; JOINTS],
        }
    }

    fn weight(&self, step_s: f64) -> f64 {
        1.0 - (-TAU * self.cutoff_hz * step_s).exp()
    }

    /// The delay at low frequencies for this time step, s.
    pub fn delay_s(&self, step_s: f64) -> f64 {
        let a = self.weight(step_s);
        step_s * (0.5 + (1.0 - a) / a)
    }

    /// Takes the positions, rad, measured `step_s` after the last ones; returns the velocities, rad/s. The first
    /// positions, and positions without a positive time step, leave the velocities as they are.
    pub fn update(&mut self, q: &[f64; JOINTS], step_s: f64) -> [f64; JOINTS] {
        if let Some(last) = self.last
            && step_s > 0.0
        {
            let a = self.weight(step_s);
            for joint in 0..JOINTS {
                let difference = (q[joint] - last[joint]) / step_s;
                self.velocity[joint] += a * (difference - self.velocity[joint]);
            }
        }
        self.last = Some(*q);
        self.velocity
    }

    /// Forgets everything: after a restart of the cabinet.
    pub fn reset(&mut self) {
        self.last = None;
        self.velocity = [0.0; JOINTS];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const T: f64 = 1e-3;

    // Fails if the documented delay is not the measured one: a steadily rising velocity is late by exactly that.
    #[test]
    fn the_delay_is_the_documented_one() {
        for cutoff in [20.0, 100.0, 300.0] {
            let mut filter = VelocityFilter::new(cutoff);
            let acceleration = 2.0;
            let mut late = 0.0;
            for k in 0..2000 {
                let t = f64::from(k) * T;
                let v = filter.update(&[0.5 * acceleration * t * t; 7], T)[0];
                late = t - v / acceleration;
            }
            assert!((late - filter.delay_s(T)).abs() < 1e-9, "{cutoff}: {late}");
        }
        assert!((VelocityFilter::new(100.0).delay_s(T) - 1.64e-3).abs() < 1e-5);
    }

    // Fails if the bandwidth is not the documented one: -3 dB at the cut-off, within 5 %.
    #[test]
    fn the_bandwidth_is_the_documented_one() {
        for cutoff in [20.0, 50.0, 100.0] {
            let mut filter = VelocityFilter::new(cutoff);
            let omega = TAU * cutoff;
            let mut most: f64 = 0.0;
            for k in 0..4000 {
                let v = filter.update(&[(omega * f64::from(k) * T).sin() / omega; 7], T)[3];
                if k > 2000 {
                    most = most.max(v.abs());
                }
            }
            assert!((most / 0.5_f64.sqrt() - 1.0).abs() < 0.05, "{cutoff}: {most}");
        }
    }

    // Fails if a constant velocity is not found exactly, or a gap shows as a jump.
    #[test]
    fn a_gap_is_no_jump() {
        let mut filter = VelocityFilter::new(100.0);
        let mut t = 0.0;
        for k in 0..400 {
            let step = if k % 7 == 0 { 5.0 * T } else { T };
            t += step;
            let v = filter.update(&[0.3 * t; 7], step)[0];
            assert!(k < 100 || (v - 0.3).abs() < 1e-9);
        }
        let before = filter.velocity;
        assert_eq!(filter.update(&[9.0; 7], 0.0), before);
        filter.reset();
        assert_eq!(filter.update(&[1.0; 7], T), [0.0; 7]);
    }
}
