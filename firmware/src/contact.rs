//! Contact: the force condition with its dwell time, and the watch over a seated nest.
//!
//! Terms: the *tare* is the force that the observer shows at rest in free space;
//! it is model error. The *trigger* is the force against the approach at which
//! contact is declared after it has lasted for the *dwell time*. The nest is
//! *seated* when its three planes rest on the sphere.

use nalgebra::{SMatrix, Vector3};
use spherecal_shared::procedure::{Approach, Seating};
use spherecal_shared::scalar::sqrt;

/// Time over which the largest force is a mean, in s. A mean of 10 ms passes half the power of a force of 44 Hz and none of
/// one of 100 Hz.
const PEAK_S: f64 = 0.010;
/// Ticks of that time with the shortest control period, 1 ms.
const PEAK_TICKS: usize = 10;

/// The largest mean force over [`PEAK_S`].
///
/// The observer is a low-pass of 60 rad/s: it shows a third of an impact of 10 ms. Its input follows from two of its values,
/// `u_k = f_k-1 + (f_k - f_k-1) / (pole period)`, because its pole is known. The mean of `u` has no more noise than
/// 1.7 times the change of `f` over 10 ms.
#[derive(Clone, Copy, Debug, Default)]
struct PeakForce {
    /// The observer's inputs of the last ticks, in N; a ring.
    inputs: [f64; PEAK_TICKS],
    next: usize,
    /// The observer's output of the last tick, in N; none before the first.
    last: Option<f64>,
    most: f64,
}

impl PeakForce {
    /// Takes the observer's force of one tick (N), its pole (rad/s) and the control period (s).
    #[inline]
    fn push(&mut self, force: f64, pole: f64, period_s: f64) {
        let last = self.last.replace(force).unwrap_or(force);
        let ticks = ((PEAK_S / period_s + 0.5) as usize).clamp(1, PEAK_TICKS);
        if let Some(input) = self.inputs.get_mut(self.next) {
            *input = last + (force - last) / (pole * period_s);
        }
        self.next = (self.next + 1) % ticks;
        let mut sum = 0.0;
        for input in &self.inputs {
            sum += input;
        }
        self.most = self.most.max(sum / ticks as f64);
    }
}

/// The force condition of Algorithm 2, `setForceTrigger(7.5)`. It ignores impacts:
/// the force must last, and the arm must stand still.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ContactTrigger {
    held: u32,
    early: u32,
    peak: PeakForce,
}

impl ContactTrigger {
    /// Takes one tick: tared force against the approach (N), TCP speed (m/s) and the observer's pole (rad/s).
    /// Returns `true` when contact is declared.
    #[inline]
    pub(crate) fn push(&mut self, force: f64, speed: f64, settings: &Approach, pole: f64, period_s: f64) -> bool {
        self.peak.push(force, pole, period_s);
        if force >= settings.trigger_n && speed <= settings.contact_speed_m_s {
            self.held = self.held.saturating_add(1);
            return f64::from(self.held) * period_s >= settings.dwell_s;
        }
        if self.held > 0 {
            self.early = self.early.saturating_add(1);
        }
        self.held = 0;
        false
    }

    /// Ticks for which the condition has held.
    pub(crate) fn latency_ticks(&self) -> u32 {
        self.held
    }

    /// Number of times that the force crossed the threshold but did not last.
    pub(crate) fn early_crossings(&self) -> u32 {
        self.early
    }

    /// Largest mean force over 10 ms against the approach so far, in N.
    pub(crate) fn peak_n(&self) -> f64 {
        self.peak.most
    }
}

/// Joint offset that the watch bears, in rad. On six real Franka arms offsets of up to 21 mrad
/// were measured; those of several joints seldom add up.
const OFFSET_RAD: f64 = 0.025;

/// Detects from the joint angles alone that the nest has left the sphere: the TCP
/// of a seated nest stays near one point and moves slowly.
///
/// The computed TCP does not stay at the point where the nest seated: an offset of a joint moves it
/// by as much as the joint's column of the Jacobian has changed. So the window and the speed grow
/// with that change.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SeatingWatch<const N: usize> {
    centre: Vector3<f64>,
    /// Jacobians when the nest seated, and one tick ago.
    seated: SMatrix<f64, 6, N>,
    last: SMatrix<f64, 6, N>,
    violated: u32,
}

impl<const N: usize> Default for SeatingWatch<N> {
    fn default() -> Self {
        Self::new(Vector3::zeros(), &SMatrix::zeros())
    }
}

impl<const N: usize> SeatingWatch<N> {
    /// A watch around `centre`, the computed TCP of the seated nest (F0, in m), with the `jacobian`
    /// there.
    pub(crate) fn new(centre: Vector3<f64>, jacobian: &SMatrix<f64, 6, N>) -> Self {
        Self {
            centre,
            seated: *jacobian,
            last: *jacobian,
            violated: 0,
        }
    }

    /// Computed TCP when the nest seated, in m.
    pub(crate) fn centre(&self) -> &Vector3<f64> {
        &self.centre
    }

    /// Takes one tick: computed TCP (m), its speed (m/s) and its Jacobian. Returns the distance
    /// from the centre (m) once the nest has left.
    #[inline]
    pub(crate) fn push(
        &mut self,
        tcp: &Vector3<f64>,
        speed: f64,
        jacobian: &SMatrix<f64, 6, N>,
        settings: &Seating,
        period_s: f64,
    ) -> Option<f64> {
        let distance = (tcp - self.centre).norm();
        let window = settings.window_m + OFFSET_RAD * change(jacobian, &self.seated);
        let most = settings.speed_m_s + OFFSET_RAD * change(jacobian, &self.last) / period_s;
        self.last = *jacobian;
        if distance > window || speed > most {
            self.violated = self.violated.saturating_add(1);
        } else {
            self.violated = 0;
        }
        (f64::from(self.violated) * period_s >= settings.dwell_s).then_some(distance)
    }
}

/// Root of the summed squares of what the linear parts of two Jacobians differ by, in m.
#[inline]
fn change<const N: usize>(a: &SMatrix<f64, 6, N>, b: &SMatrix<f64, 6, N>) -> f64 {
    let mut sum = 0.0;
    for i in 0..N {
        for k in 0..3 {
            let d = a[(k, i)] - b[(k, i)];
            sum += d * d;
        }
    }
    sqrt(sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: f64 = 1e-3;
    /// Pole of the observer, in rad/s.
    const POLE: f64 = 60.0;

    #[test]
    fn the_trigger_wants_its_dwell() {
        let settings = Approach::default();
        let mut trigger = ContactTrigger::default();
        // An impact of 80 N for 15 ms does not trigger; 7.5 N for 20 ms does.
        assert!((0..15).all(|_| !trigger.push(80.0, 0.0, &settings, POLE, PERIOD)));
        assert!(!trigger.push(0.0, 0.0, &settings, POLE, PERIOD));
        let fired = (0..30).position(|_| trigger.push(7.5, 0.001, &settings, POLE, PERIOD));
        assert_eq!(fired, Some(19));
        assert_eq!((trigger.early_crossings(), trigger.peak_n()), (1, 80.0));
        assert_eq!(trigger.latency_ticks(), 20);
    }

    #[test]
    fn a_moving_arm_is_not_in_contact() {
        let mut trigger = ContactTrigger::default();
        assert!((0..100).all(|_| !trigger.push(10.0, 0.025, &Approach::default(), POLE, PERIOD)));
    }

    // Fails if the peak is another than the largest mean over 10 ms of what went into the observer's low-pass, at any period
    // of a drive.
    #[test]
    fn the_peak_is_the_mean_force_of_ten_milliseconds() {
        for (period, ticks) in [(1e-3, 10), (2e-3, 5), (4e-3, 3)] {
            let mut trigger = ContactTrigger::default();
            let (mut low, mut most, mut inputs) = (0.0, 0.0f64, std::vec![0.0; ticks]);
            for k in 0..200 {
                let input = 30.0 * libm::sin(f64::from(k * k)) + if k == 40 { 400.0 } else { 0.0 };
                // The first value only fills the low-pass.
                let input = if k == 0 { 0.0 } else { input };
                low += POLE * period * (input - low);
                trigger.push(low, 1.0, &Approach::default(), POLE, period);
                inputs.remove(0);
                inputs.push(input);
                most = most.max(inputs.iter().sum::<f64>() / ticks as f64);
            }
            assert!(
                (trigger.peak_n() - most).abs() < 1e-9 * most,
                "{} N, not {most} N",
                trigger.peak_n()
            );
        }
    }

    #[test]
    fn a_nest_that_jumps_or_drifts_is_noticed() {
        let settings = Seating::default();
        let still = SMatrix::<f64, 6, 7>::zeros();
        let mut watch = SeatingWatch::new(Vector3::zeros(), &still);
        let here = Vector3::new(0.0019, 0.0, 0.0);
        assert!((0..1000).all(|_| watch.push(&here, 0.002, &still, &settings, PERIOD).is_none()));
        assert_eq!(
            (0..50).position(|_| watch.push(&here, 0.05, &still, &settings, PERIOD).is_some()),
            Some(9)
        );
        let mut watch = SeatingWatch::new(Vector3::zeros(), &still);
        let away = Vector3::new(0.0, 0.006, 0.0);
        assert_eq!(
            (0..50).position(|_| watch.push(&away, 0.0, &still, &settings, PERIOD).is_some()),
            Some(9)
        );
    }

    // Fails if a nest at the limit of its window or of its speed counts as lost, or one beyond it does not.
    #[test]
    fn a_nest_may_be_at_the_limit_of_its_window() {
        let settings = Seating::default();
        let still = SMatrix::<f64, 6, 7>::zeros();
        let lost = |metres: f64, speed: f64| {
            let mut watch = SeatingWatch::new(Vector3::zeros(), &still);
            let tcp = Vector3::new(0.0, metres, 0.0);
            (0..100).any(|_| watch.push(&tcp, speed, &still, &settings, PERIOD).is_some())
        };
        let next = |x: f64| x * (1.0 + f64::EPSILON);
        let (window, speed) = (settings.window_m, settings.speed_m_s);
        assert!(!lost(window, speed) && lost(next(window), speed) && lost(window, next(speed)));
    }

    // Fails if the computed TCP of an arm with a joint offset of 20 mrad counts as a nest that left
    // the sphere, or if the same distance passes in a turn that does not explain it.
    #[test]
    fn a_joint_offset_is_no_lost_sphere() {
        let settings = Seating::default();
        let column = |angle: f64| {
            let mut jacobian = SMatrix::<f64, 6, 7>::zeros();
            jacobian[(0, 2)] = -0.5 * libm::sin(angle);
            jacobian[(1, 2)] = 0.5 * libm::cos(angle);
            jacobian
        };
        for (speed_rad_s, lost) in [(0.7, false), (0.1, true)] {
            let mut watch = SeatingWatch::new(Vector3::zeros(), &column(0.0));
            let mut found = false;
            for tick in 0..1500 {
                let angle = 0.7 * f64::from(tick) * PERIOD;
                let off = (column(angle) - column(0.0)).fixed_view::<3, 1>(0, 2) * 0.02;
                let jacobian = column(angle * speed_rad_s / 0.7);
                found |= watch
                    .push(&off.into_owned(), 0.02 * 0.5 * 0.7, &jacobian, &settings, PERIOD)
                    .is_some();
            }
            assert_eq!(found, lost, "{speed_rad_s}");
        }
    }
}
