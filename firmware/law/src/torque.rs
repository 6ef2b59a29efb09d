//! The last stage before the drive: limits the torque and its rate.

use nalgebra::SVector;
use spherecal_shared::scalar::bounded;

/// What was limited.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Shaped {
    /// First saturated joint, from 1; 0 for none.
    pub saturated: u8,
    /// Whether a rate was limited.
    pub rate_limited: bool,
}

/// Keeps torques within their limits and their rates within a limit.
#[derive(Clone, Debug)]
pub struct TorqueShaper<const N: usize> {
    last: Option<[f64; N]>,
}

impl<const N: usize> Default for TorqueShaper<N> {
    fn default() -> Self {
        Self { last: None }
    }
}

impl<const N: usize> TorqueShaper<N> {
    /// Forgets the last torque: the next one starts from the measured torque.
    pub fn reset(&mut self) {
        self.last = None;
    }

    /// Limits `wanted` (N m) to `limits` (N m) and to a change of `step` (N m) per
    /// tick. The first torque starts from `measured` (N m), the torque that the
    /// drive exerts already, so that taking over causes no jump. `share` is the part of
    /// the way to the wanted torque that a tick takes: 1, or less to smooth it.
    #[inline]
    pub fn shape(
        &mut self,
        wanted: &SVector<f64, N>,
        measured: &[f64; N],
        limits: &[f64; N],
        step: f64,
        share: f64,
    ) -> ([f64; N], Shaped) {
        // A sensor may show any value; it is used only within the limits.
        let within = |i: usize| bounded(measured[i], limits[i]).unwrap_or(0.0);
        let last = self.last.unwrap_or_else(|| core::array::from_fn(within));
        let mut shaped = Shaped::default();
        let mut out = [0.0; N];
        for i in 0..N {
            // What is not a number asks for nothing: the torque stays as it is.
            let limited = bounded(wanted[i], limits[i]).unwrap_or(last[i]);
            if limited != wanted[i] && shaped.saturated == 0 {
                shaped.saturated = i as u8 + 1;
            }
            let limited = if share < 1.0 {
                last[i] + share * (limited - last[i])
            } else {
                limited
            };
            let change = limited - last[i];
            let stepped = if change > step {
                shaped.rate_limited = true;
                last[i] + step
            } else if change < -step {
                shaped.rate_limited = true;
                last[i] - step
            } else {
                limited
            };
            out[i] = stepped;
        }
        self.last = Some(out);
        (out, shaped)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if the value of a broken sensor at the time of taking over is sent
    // beyond the torque limits. Found by fuzzing the drive states.
    #[test]
    fn a_wild_measurement_is_not_taken_over() {
        let mut shaper = TorqueShaper::<2>::default();
        let (tau, _) = shaper.shape(&SVector::zeros(), &[-6.9e274, 3.0], &[300.0, 300.0], 4.0, 1.0);
        assert_eq!(tau, [-296.0, 0.0]);
    }

    // Fails if a smoothed torque is no first-order low-pass, or one that is not smoothed differs from the wanted one.
    #[test]
    fn a_share_of_the_way_is_a_low_pass() {
        let mut shaper = TorqueShaper::<1>::default();
        let wanted = SVector::from([0.3]);
        for tick in 1..100 {
            let (tau, _) = shaper.shape(&wanted, &[0.0], &[300.0], 4.0, 0.1);
            let expected = 0.3 * (1.0 - libm::pow(0.9, f64::from(tick)));
            assert!((tau[0] - expected).abs() < 1e-12, "{tick}: {tau:?}");
        }
        let (tau, _) = shaper.shape(&SVector::from([0.1]), &[0.0], &[300.0], 4.0, 1.0);
        assert_eq!(tau, [0.1]);
    }

    // Fails if a wanted or a measured torque that is not a number becomes a limit.
    #[test]
    fn what_is_not_a_number_does_not_become_a_limit() {
        let limits = [300.0, 300.0];
        let mut shaper = TorqueShaper::<2>::default();
        let (tau, _) = shaper.shape(&SVector::zeros(), &[f64::NAN, 3.0], &limits, 4.0, 1.0);
        assert_eq!(tau, [0.0, 0.0]);
        let (before, _) = shaper.shape(&SVector::from([2.0, 3.0]), &[0.0; 2], &limits, 4.0, 1.0);
        let (tau, shaped) = shaper.shape(&SVector::from([f64::NAN, 4.0]), &[0.0; 2], &limits, 4.0, 1.0);
        assert_eq!((before, tau), ([2.0, 3.0], [2.0, 4.0]));
        assert_eq!(shaped.saturated, 1, "it is reported");
    }
}
