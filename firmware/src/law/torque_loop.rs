//! The torque loop: makes the torque at the link what the law asked for.
//!
//! Between motor and link lie gear friction and rotor inertia; the sensor at
//! the link sees what arrives. Feeding `gain` times the difference back makes
//! both smaller by `1 + gain` (Ott et al., 2008), which a soft Cartesian spring
//! needs: 1 N m of friction at a wrist joint holds the nest against 10 N. The
//! low-pass keeps the loop stable with one period of delay on a drive that
//! delivers what it is told; there it changes nothing but a little noise.

/// Low-passed proportional torque feedback of `N` joints.
#[derive(Clone, Debug)]
pub struct TorqueLoop<const N: usize> {
    correction: [f64; N],
    reference: Option<[f64; N]>,
}

impl<const N: usize> Default for TorqueLoop<N> {
    fn default() -> Self {
        Self {
            correction: [0.0; N],
            reference: None,
        }
    }
}

impl<const N: usize> TorqueLoop<N> {
    /// Forgets everything.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Correction to add to the next torque, in N m. `measured` (N m) is what
    /// came of the last reference; `pole` in 1/s, `bound` in N m.
    #[inline]
    pub fn correction(&mut self, measured: &[f64; N], gain: f64, pole: f64, bound: f64, period_s: f64) -> &[f64; N] {
        let share = (pole * period_s).min(1.0);
        if let Some(reference) = &self.reference {
            for i in 0..N {
                let wanted = gain * (reference[i] - measured[i]);
                let moved = self.correction[i] + share * (wanted - self.correction[i]);
                self.correction[i] = moved.max(-bound).min(bound);
            }
        }
        &self.correction
    }

    /// Notes the torque (N m) that was sent, correction included.
    #[inline]
    pub fn sent(&mut self, torque: &[f64; N]) {
        let mut reference = *torque;
        for i in 0..N {
            reference[i] -= self.correction[i];
        }
        self.reference = Some(reference);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if friction is not made smaller by `1 + gain`, a drive without
    /// friction is disturbed, or the bound is not kept.
    #[test]
    fn friction_is_divided() {
        let mut feedback = TorqueLoop::<3>::default();
        let wanted = [1.0, -4.0, 2.0];
        let friction = [1.0, -9.0, 0.0];
        let mut arrived = [0.0; 3];
        for _ in 0..2000 {
            let correction = *feedback.correction(&arrived, 4.0, 60.0, 3.0, 1e-3);
            let sent = core::array::from_fn(|i| wanted[i] + correction[i]);
            feedback.sent(&sent);
            arrived = core::array::from_fn(|i| sent[i] - friction[i]);
        }
        assert!((arrived[0] - (1.0 - 1.0 / 5.0)).abs() < 1e-9);
        // 9 N m of friction would take 7.2; the bound is 3.
        assert!((arrived[1] - (-4.0 - 3.0 + 9.0)).abs() < 1e-9);
        assert!((arrived[2] - 2.0).abs() < 1e-9);
    }
}
