//! The torque loop: makes the torque at the link equal to the torque that the law
//! asks for.
//!
//! Gear friction and rotor inertia lie between motor and link; the sensor measures
//! at the link. Feedback of `gain` times the difference reduces both by `1 + gain`
//! (Ott et al., 2008). A soft Cartesian spring needs this: 1 N m of friction at a
//! wrist joint holds the nest against 10 N. The low-pass keeps the loop stable with
//! one period of delay. On a drive without friction and rotor inertia the loop
//! only adds a little noise.

use spherecal_shared::scalar::bounded;

/// Proportional torque feedback of `N` joints with a low-pass.
#[derive(Clone, Debug)]
pub(crate) struct TorqueLoop<const N: usize> {
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
    /// Sets the state to zero.
    pub(crate) fn reset(&mut self) {
        *self = Self::default();
    }

    /// Correction of the next torque, in N m. `measured` (N m) is the torque that
    /// came of the last one; `pole` is in 1/s, `bound` in N m.
    #[inline]
    pub(crate) fn correction(
        &mut self,
        measured: &[f64; N],
        gain: f64,
        pole: f64,
        bound: f64,
        period_s: f64,
    ) -> &[f64; N] {
        let share = (pole * period_s).min(1.0);
        if let Some(reference) = &self.reference {
            for i in 0..N {
                let wanted = gain * (reference[i] - measured[i]);
                let moved = self.correction[i] + share * (wanted - self.correction[i]);
                self.correction[i] = bounded(moved, bound).unwrap_or(0.0);
            }
        }
        &self.correction
    }

    /// Stores the torque (N m) that was sent, with its correction.
    #[inline]
    pub(crate) fn sent(&mut self, torque: &[f64; N]) {
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

    /// Fails if friction is not reduced by `1 + gain`, if a drive without friction
    /// is disturbed, or if the bound is exceeded.
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
        // 9 N m of friction would take 7.2 N m of correction; the bound is 3.
        assert!((arrived[1] - (-4.0 - 3.0 + 9.0)).abs() < 1e-9);
        assert!((arrived[2] - 2.0).abs() < 1e-9);
    }
}
