//! The instability guard: notices that the control loop drives the arm instead of
//! holding it.
//!
//! A drive that answers much later than it declares makes every stiff hold unstable,
//! that of the fault phase too. The guard therefore judges every tick, in every phase,
//! and closes the brakes. It knows three signs:
//!
//! - a joint swings to and fro, and its swings grow;
//! - a joint is faster than it can be;
//! - the arm has much more kinetic energy than its setpoint.
//!
//! A push, an impact or the snap of the magnet starts one swing; the law damps the next. Two of them
//! in a row look like swings that grow, but the second has its largest speed at once: only a swing that
//! still gets faster after its first ticks counts. And after some blows, as the planes of a nest touch one after the other, the
//! mean speed lags behind a joint that slows down: the joint itself must be fast, not only faster than its mean.

use nalgebra::SVector;
use spherecal_shared::protocol::host::Fault;
use spherecal_shared::robot::JointLimits;
use spherecal_shared::scalar::sqrt;

use super::violation::Violation;
use crate::law::Snapshot;

/// Speed of a swing at which growing swings are a fault: this share of the joint's speed
/// limit, and at most this many rad/s.
const SWING_SHARE: f64 = 0.15;
const SWING_RAD_S: f64 = 0.4;
/// Share of that speed below which a swing does not count: noise is slower.
const FLOOR_SHARE: f64 = 0.1;
/// Swings in a row that must each be as fast as the one before; the present one is the
/// next.
const GROWING: u8 = 2;
/// Or: one swing is this much faster than the one before, and the present one is as fast.
const LEAPS: f64 = 1.5;
/// Longest swing (half an oscillation) that counts, in s. Slower motions are those of
/// the task.
const LONGEST_S: f64 = 0.060;

/// A swing must still get faster after this time, in s, and after this share of the swing before. The
/// swings of a loop have equal lengths, of 5 ms and more, and are fastest in their middle or later. A
/// blow makes a joint fast within 3 ms. (The time is two ticks of 1 ms, less what their sum is rounded by.)
const RISE_S: f64 = 0.0019;
const RISE_SHARE: f64 = 0.3;

/// Ticks in a row in which a joint is faster than its limit. The fault of a fast joint
/// comes at a smaller speed, and its hold is what makes a late joint faster still.
const RUNAWAY_TICKS: u32 = 2;

/// Largest kinetic energy of the speeds beyond those of the setpoint, in J.
const ENERGY_J: f64 = 5.0;
/// Time for which the energy may exceed its limit, in s.
const ENERGY_DWELL_S: f64 = 0.0025;

/// Kinetic energy of an arm with the joint speeds `dq` (rad/s), in J.
#[inline]
fn kinetic_energy<const N: usize>(snapshot: &Snapshot<N>, dq: &SVector<f64, N>) -> f64 {
    0.5 * snapshot.mass.multiply(dq).dot(dq)
}

/// Share of the joint speeds at which a motion has too much kinetic energy.
#[inline]
pub(crate) fn energy_share<const N: usize>(snapshot: &Snapshot<N>) -> f64 {
    sqrt(kinetic_energy(snapshot, &SVector::from(snapshot.dq)) / ENERGY_J)
}

/// The swings of one joint.
#[derive(Clone, Copy, Debug, Default)]
struct Swings {
    /// Largest speed of the present swing, with its sign, in rad/s.
    peak: f64,
    /// Largest speed of the swing before, without sign, in rad/s.
    last: f64,
    /// Swings in a row that were as fast as the one before.
    growing: u8,
    /// Whether the swing before was much faster than the one before it.
    leapt: bool,
    /// Length of the present swing, and of the swing before, in s.
    length_s: f64,
    last_s: f64,
}

impl Swings {
    /// Takes the speed of one tick about the mean (rad/s). Returns the speed of the
    /// present swing if it continues a growth.
    #[inline]
    fn push(&mut self, speed: f64, floor: f64, period_s: f64) -> Option<f64> {
        self.length_s += period_s;
        if self.length_s > LONGEST_S {
            *self = Self::default();
        }
        if speed.abs() < floor {
            return None;
        }
        if speed * self.peak < 0.0 {
            let size = self.peak.abs();
            let known = self.last > 0.0;
            self.growing = if known && size >= self.last {
                self.growing.saturating_add(1)
            } else {
                0
            };
            self.leapt = known && size >= LEAPS * self.last;
            self.last = size;
            self.last_s = self.length_s;
            self.peak = 0.0;
            self.length_s = 0.0;
        }
        if speed.abs() < self.peak.abs() {
            return None;
        }
        self.peak = speed;
        let grows = self.growing >= GROWING || self.leapt;
        let rises = self.length_s >= RISE_S.max(RISE_SHARE * self.last_s);
        (grows && rises && speed.abs() >= self.last).then_some(speed)
    }
}

/// The instability guard of an arm with `N` joints.
#[derive(Clone, Debug)]
pub(crate) struct Instability<const N: usize> {
    swings: [Swings; N],
    runaway_ticks: u32,
    energy_ticks: u32,
}

impl<const N: usize> Default for Instability<N> {
    fn default() -> Self {
        Self {
            swings: [Swings::default(); N],
            runaway_ticks: 0,
            energy_ticks: 0,
        }
    }
}

impl<const N: usize> Instability<N> {
    /// Forgets the states before: the brakes were closed, or the drive is another one.
    pub(crate) fn reset(&mut self) {
        *self = Self::default();
    }

    /// Judges one tick. `mean` are the low-passed joint speeds; `wanted` are those of the
    /// setpoint if the joint law is in charge (rad/s).
    #[inline]
    pub(crate) fn check(
        &mut self,
        snapshot: &Snapshot<N>,
        mean: &[f64; N],
        wanted: Option<&[f64; N]>,
        limits: &[JointLimits; N],
        period_s: f64,
    ) -> Option<Violation> {
        let mut found = None;
        let mut runaway = None;
        let mut excess = SVector::<f64, N>::zeros();
        for (i, limit) in limits.iter().enumerate() {
            let dq = snapshot.dq[i];
            if dq.abs() > limit.velocity_rad_s {
                runaway = runaway.or(Some((i, dq, limit.velocity_rad_s)));
            }
            excess[i] = dq - wanted.map_or(0.0, |wanted| wanted[i]);
            let swing = (SWING_SHARE * limit.velocity_rad_s).min(SWING_RAD_S);
            let speed = self.swings[i].push(dq - mean[i], FLOOR_SHARE * swing, period_s);
            if let Some(speed) = speed.filter(|speed| speed.abs().min(dq.abs()) > swing) {
                found = found.or(Some((i, speed, swing)));
            }
        }
        self.runaway_ticks = if runaway.is_some() {
            self.runaway_ticks.saturating_add(1)
        } else {
            0
        };
        let runaway = runaway.filter(|_| self.runaway_ticks >= RUNAWAY_TICKS);
        if let Some((i, value, limit)) = found.or(runaway) {
            return Some(Violation {
                fault: Fault::Unstable,
                joint: i as u8 + 1,
                value,
                limit,
            });
        }
        let energy = kinetic_energy(snapshot, &excess);
        self.energy_ticks = if energy > ENERGY_J {
            self.energy_ticks.saturating_add(1)
        } else {
            0
        };
        (f64::from(self.energy_ticks) * period_s > ENERGY_DWELL_S)
            .then(|| Violation::new(Fault::KineticEnergy, energy, ENERGY_J))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::HOME;
    use spherecal_shared::robot::{Arm, iiwa7, iiwa7_tool};
    use std::vec::Vec;

    const PERIOD_S: f64 = 1e-3;

    fn joints() -> [JointLimits; 7] {
        core::array::from_fn(|i| iiwa7().joints[i].limits)
    }

    /// Time (s) at which the guard notices joint 5 with the speed `at(t)` (rad/s), within
    /// 2 s, and what it then says.
    fn noticed(at: &dyn Fn(f64) -> f64) -> Option<(f64, Violation)> {
        let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
        let mut snapshot = Snapshot::new(&arm, &HOME, &[0.0; 7]).expect("a mass matrix");
        let mut guard = Instability::default();
        let mut mean = [0.0; 7];
        (0..2000).find_map(|tick| {
            let time_s = f64::from(tick) * PERIOD_S;
            snapshot.dq[4] = at(time_s);
            mean[4] += 0.06 * (snapshot.dq[4] - mean[4]);
            let found = guard.check(&snapshot, &mean, None, &joints(), PERIOD_S)?;
            Some((time_s, found))
        })
    }

    /// A sine of `rad_s` that grows by `e` in `growth_s` (s) from 1 mrad/s.
    fn growing(rad_s: f64, growth_s: f64) -> impl Fn(f64) -> f64 {
        move |t| 1e-3 * libm::exp(t / growth_s) * libm::sin(rad_s * t)
    }

    // Fails if an oscillation that grows is noticed too late: the joint must not reach
    // 1.5 rad/s.
    #[test]
    fn a_growing_oscillation_is_noticed_before_it_is_fast() {
        for rad_s in [60.0, 100.0, 200.0, 300.0, 600.0] {
            for growth_s in [0.011, 0.025, 0.1, 0.2] {
                if rad_s * growth_s < 2.1 {
                    // No oscillation: each swing would be 4.5 times as fast.
                    continue;
                }
                let speed = growing(rad_s, growth_s);
                let (time_s, found) = noticed(&speed).expect("noticed");
                let most = (0..2000)
                    .map(|tick| PERIOD_S * f64::from(tick))
                    .filter(|t| *t <= time_s)
                    .fold(0.0f64, |most, t| most.max(speed(t).abs()));
                assert!(most < 1.5, "{most} rad/s at {rad_s} rad/s, growth in {growth_s} s");
                assert_eq!((found.fault, found.joint), (Fault::Unstable, 5));
                assert!(found.value.abs() > found.limit, "{found:?}");
            }
        }
    }

    // Fails if a motion, an impact that the law damps, or noise counts as unstable.
    #[test]
    fn what_is_damped_is_sound() {
        // A free motion at 1.4 rad/s.
        let motion = |t: f64| 1.4 * libm::sin(3.0 * t);
        assert_eq!(noticed(&motion), None);
        for (rad_s, ratio) in [(20.0, 0.7), (100.0, 0.3), (200.0, 0.1)] {
            let impact = move |t: f64| 1.4 * libm::exp(-ratio * rad_s * t) * libm::cos(rad_s * t);
            assert_eq!(noticed(&impact), None, "{rad_s} rad/s, {ratio}");
        }
        let noise = |t: f64| 0.04 * libm::sin(1e7 * t * t);
        assert_eq!(noticed(&noise), None);
        // The rim of the nest touches a sphere; 60 ms later the magnet draws it in.
        let seats = |t: f64| match t - 0.1 {
            t if t < 0.0 => 0.0,
            t if t < 0.045 => -0.09 * libm::exp(-t / 0.01),
            t if t < 0.0595 => 0.3 * (t - 0.045) / 0.015,
            t if t < 0.061 => -0.04,
            t if t < 0.062 => -0.37,
            t => -0.49 * libm::exp(-(t - 0.062) / 0.04),
        };
        assert_eq!(noticed(&seats), None);
        // A magnet draws a nest of three planes onto its sphere: five blows, and the joint slows down after each (rad/s, one
        // a ms; an FR3 whose last link shows no motor, on another physics engine).
        let blows = [
            0.08, 0.07, 0.08, 0.09, 0.08, 0.10, -0.25, -0.46, -0.51, -0.49, -0.45, -0.43, -0.41, -0.37, -0.36, -0.35,
            -0.34, -0.32, -0.41, -0.40, -0.39, -0.51, -0.46, -0.53, -0.48, -0.44, -0.40, -0.45, -0.54, -0.47, -0.54,
            -0.54, -0.20, -0.36, -0.49, -0.64, -0.70, -0.64, -0.59, -0.53, -0.46, -0.43, -0.38, -0.34, -0.26, -0.18,
            -0.08, 0.09,
        ];
        let seats = |t: f64| blows.get((t * 1e3 + 0.5) as usize).copied().unwrap_or(0.1);
        assert_eq!(noticed(&seats), None);
    }

    // Fails if a joint that is faster than it can be is not noticed in the second tick, or
    // one of its wrong speeds counts.
    #[test]
    fn a_joint_that_runs_away_is_noticed() {
        let limit = joints()[4].velocity_rad_s;
        let (time_s, found) = noticed(&|t| if t < 0.1 { 0.0 } else { 1.01 * limit }).expect("noticed");
        assert!((time_s - 0.101).abs() < 1e-9, "{time_s} s");
        assert_eq!((found.fault, found.joint, found.limit), (Fault::Unstable, 5, limit));
        assert_eq!(
            noticed(&|t| if (t - 0.1).abs() < 5e-4 { 1.01 * limit } else { 0.0 }),
            None
        );
        assert_eq!(noticed(&|_| limit), None, "a joint may be as fast as it can be");
    }

    // Fails if an arm with too much energy is not noticed in the third tick.
    #[test]
    fn energy_that_no_motion_explains_is_noticed() {
        let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
        let snapshot = Snapshot::new(&arm, &HOME, &[1.6, 1.6, 0.0, -1.6, 0.0, 0.0, 0.0]).expect("a mass matrix");
        let mut guard = Instability::default();
        let found: Vec<_> = (0..5)
            .filter_map(|_| guard.check(&snapshot, &snapshot.dq, None, &joints(), PERIOD_S))
            .collect();
        assert_eq!(found.len(), 3, "from the third tick on: {found:?}");
        assert!(
            found
                .iter()
                .all(|v| v.fault == Fault::KineticEnergy && v.value > ENERGY_J)
        );
    }
}
