//! The torque loop: makes the torque at the link equal to the torque that the law
//! asks for.
//!
//! Gear friction and rotor inertia lie between motor and link; the sensor measures
//! at the link. Feedback of `gain` times the difference reduces both by `1 + gain`
//! (Ott et al., 2008). A soft Cartesian spring needs this: 1 N m of friction at a
//! wrist joint holds the nest against 10 N. The low-pass keeps the loop stable with
//! one period of delay. On a drive without friction and rotor inertia the loop
//! only adds a little noise.
//!
//! A motor whose inertia the drive declares belongs to the law's mass matrix. The loop
//! must not take its torque for friction: it would hide the motor at slow motions and not
//! at fast ones, and the null space would push on the sphere with what is hidden
//! (18 N were measured, where the magnet holds 26.5 N). So the torque that accelerates
//! the motors counts as delivered ([`TorqueLoop::exerted`]).

use spherecal_shared::scalar::bounded;

/// Proportional torque feedback of `N` joints with a low-pass.
#[derive(Clone, Debug)]
pub struct TorqueLoop<const N: usize> {
    correction: [f64; N],
    reference: Option<[f64; N]>,
    speeds: Option<[f64; N]>,
}

impl<const N: usize> Default for TorqueLoop<N> {
    fn default() -> Self {
        Self {
            correction: [0.0; N],
            reference: None,
            speeds: None,
        }
    }
}

impl<const N: usize> TorqueLoop<N> {
    /// Sets the state to zero.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Torque that the motors exerted after their friction, in N m: what was `measured` at the links
    /// (N m), and what accelerated the `motors` (kg m²) since the last call. `speeds` are those of
    /// the joints, in rad/s.
    #[inline]
    pub fn exerted(&mut self, measured: &[f64; N], speeds: &[f64; N], motors: &[f64; N], period_s: f64) -> [f64; N] {
        let last = self.speeds.replace(*speeds).unwrap_or(*speeds);
        core::array::from_fn(|i| measured[i] + motors[i] * (speeds[i] - last[i]) / period_s)
    }

    /// Correction of the next torque, in N m. `measured` (N m) is the torque that
    /// came of the last one; `poles`, one of each
    /// joint, are in 1/s, `bound` is in N m.
    #[inline]
    pub fn correction(
        &mut self,
        measured: &[f64; N],
        gain: f64,
        poles: &[f64; N],
        bound: f64,
        period_s: f64,
    ) -> &[f64; N] {
        if let Some(reference) = &self.reference {
            for i in 0..N {
                let share = (poles[i] * period_s).min(1.0);
                let wanted = gain * (reference[i] - measured[i]);
                let moved = self.correction[i] + share * (wanted - self.correction[i]);
                self.correction[i] = bounded(moved, bound).unwrap_or(0.0);
            }
        }
        &self.correction
    }

    /// Stores the torque (N m) that was sent, with its correction.
    #[inline]
    pub fn sent(&mut self, torque: &[f64; N]) {
        let mut reference = *torque;
        for i in 0..N {
            reference[i] -= self.correction[i];
        }
        self.reference = Some(reference);
    }
}

/// Negative damping that the loop may cause at a joint, in N m s/rad: half of that of
/// a joint's own spring and gear (20 N m s/rad, `docs/design/plant.md`).
const LOOP_DAMPING: f64 = 20.0;

/// Poles of the low-pass of each joint, in 1/s, at most `corner`.
///
/// A motor of inertia `R` behind an elastic joint oscillates against it far above the
/// pole `p`. There the lag of the filter is a quarter turn, and the loop of gain `g`
/// drives the motor with `g p R` of negative damping. So `g p R` is kept below a bound.
#[inline]
pub fn poles<const N: usize>(motors: &[f64; N], gain: f64, corner: f64) -> [f64; N] {
    core::array::from_fn(|i| corner / (1.0 + corner * gain * motors[i] / LOOP_DAMPING))
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
            let correction = *feedback.correction(&arrived, 4.0, &[60.0; 3], 3.0, 1e-3);
            let sent = core::array::from_fn(|i| wanted[i] + correction[i]);
            feedback.sent(&sent);
            arrived = core::array::from_fn(|i| sent[i] - friction[i]);
        }
        assert!((arrived[0] - (1.0 - 1.0 / 5.0)).abs() < 1e-9);
        // 9 N m of friction would take 7.2 N m of correction; the bound is 3.
        assert!((arrived[1] - (-4.0 - 3.0 + 9.0)).abs() < 1e-9);
        assert!((arrived[2] - 2.0).abs() < 1e-9);
    }

    /// Fails if the inertia of a declared motor counts as friction: a motor of 0.5 kg m²
    /// that accelerates at 4 rad/s² takes 2 N m, and 1 N m of friction stays what is corrected.
    #[test]
    fn a_declared_motor_is_no_friction() {
        let mut feedback = TorqueLoop::<1>::default();
        let mut arrived = [0.0];
        let mut speed = 0.0;
        for _ in 0..2000 {
            let exerted = feedback.exerted(&arrived, &[speed], &[0.5], 1e-3);
            let sent = [8.0 + feedback.correction(&exerted, 4.0, &[60.0], 20.0, 1e-3)[0]];
            feedback.sent(&sent);
            speed += 4e-3;
            arrived = [sent[0] - 1.0 - 0.5 * 4.0];
        }
        assert!((arrived[0] - (8.0 - 2.0 - 1.0 / 5.0)).abs() < 1e-6, "{arrived:?}");
    }

    /// Energy (J) after half a second of a motor of `inertia` (kg m²) on a spring of
    /// 16,000 N m/rad with 20 N m s/rad, whose other end is blocked. It starts with 8 mJ.
    fn energy_of_a_motor(inertia: f64, poles: &[f64; 1]) -> f64 {
        let (stiffness, damping, h) = (16_000.0, 20.0, 1e-5);
        let mut feedback = TorqueLoop::<1>::default();
        let (mut angle, mut speed) = (1e-3, 0.0);
        for _ in 0..500 {
            let measured = [stiffness * angle + damping * speed];
            let sent = *feedback.correction(&measured, 6.0, poles, 1e3, 1e-3);
            feedback.sent(&sent);
            for _ in 0..100 {
                speed += h * (sent[0] - stiffness * angle - damping * speed) / inertia;
                angle += h * speed;
            }
        }
        0.5 * (inertia * speed * speed + stiffness * angle * angle)
    }

    /// Fails if the loop drives the motor of an elastic joint, or if a drive that hides
    /// its motors gets another pole than the one that is asked for.
    #[test]
    fn an_elastic_joint_comes_to_rest() {
        assert_eq!(poles(&[0.0, 0.0], 6.0, 10.0), [10.0, 10.0]);
        for motor in [0.05, 0.35, 0.46, 1.11, 4.4] {
            let left = energy_of_a_motor(motor, &poles(&[motor], 6.0, 10.0));
            assert!(left < 7e-3, "{motor} kg m²: {left} J");
        }
        assert!(energy_of_a_motor(1.11, &[10.0]) > 8e-3, "the bound is needed");
    }
}
