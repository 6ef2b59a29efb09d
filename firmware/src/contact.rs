//! Contact: the tare before it, the force condition with its dwell time, and the
//! watch over a seated nest.
//!
//! Terms: the *tare* is the wrench that the observer shows at rest in free space;
//! it is model error. The *trigger* is the force against the approach at which
//! contact is declared after it has lasted for the *dwell time*. The nest is
//! *seated* when its three planes rest on the sphere.

use nalgebra::Vector3;
use spherecal_shared::procedure::{Approach, Seating};

use crate::law::Wrench;

/// The mean wrench at rest.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Tare {
    sum: Wrench,
    count: u32,
}

impl Tare {
    /// Adds one tick's wrench.
    pub(crate) fn push(&mut self, wrench: &Wrench) {
        self.sum.force += wrench.force;
        self.sum.torque += wrench.torque;
        self.count = self.count.saturating_add(1);
    }

    /// The mean; zero before the first tick.
    pub(crate) fn mean(&self) -> Wrench {
        let share = if self.count == 0 {
            0.0
        } else {
            1.0 / f64::from(self.count)
        };
        Wrench {
            force: self.sum.force * share,
            torque: self.sum.torque * share,
        }
    }
}

/// The force condition of Algorithm 2, `setForceTrigger(7.5)`. It ignores impacts:
/// the force must last, and the arm must stand still.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ContactTrigger {
    held: u32,
    early: u32,
    peak: f64,
}

impl ContactTrigger {
    /// Takes one tick: tared force against the approach (N) and TCP speed (m/s).
    /// Returns `true` when contact is declared.
    #[inline]
    pub(crate) fn push(&mut self, force: f64, speed: f64, settings: &Approach, period_s: f64) -> bool {
        self.peak = self.peak.max(force);
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

    /// Largest force against the approach so far, in N.
    pub(crate) fn peak_n(&self) -> f64 {
        self.peak
    }
}

/// Detects from the joint angles alone that the nest has left the sphere: the TCP
/// of a seated nest stays near one point and moves slowly.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SeatingWatch {
    centre: Vector3<f64>,
    violated: u32,
}

impl SeatingWatch {
    /// A watch around `centre`, the computed TCP of the seated nest (F0, in m).
    pub(crate) fn new(centre: Vector3<f64>) -> Self {
        Self { centre, violated: 0 }
    }

    /// Computed TCP when the nest seated, in m.
    pub(crate) fn centre(&self) -> &Vector3<f64> {
        &self.centre
    }

    /// Takes one tick: computed TCP (m) and its speed (m/s). Returns the distance
    /// from the centre (m) once the nest has left.
    #[inline]
    pub(crate) fn push(&mut self, tcp: &Vector3<f64>, speed: f64, settings: &Seating, period_s: f64) -> Option<f64> {
        let distance = (tcp - self.centre).norm();
        if distance > settings.window_m || speed > settings.speed_m_s {
            self.violated = self.violated.saturating_add(1);
        } else {
            self.violated = 0;
        }
        (f64::from(self.violated) * period_s >= settings.dwell_s).then_some(distance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: f64 = 1e-3;

    #[test]
    fn the_trigger_wants_its_dwell() {
        let settings = Approach::default();
        let mut trigger = ContactTrigger::default();
        // An impact of 80 N for 15 ms does not trigger; 7.5 N for 20 ms does.
        assert!((0..15).all(|_| !trigger.push(80.0, 0.0, &settings, PERIOD)));
        assert!(!trigger.push(0.0, 0.0, &settings, PERIOD));
        let fired = (0..30).position(|_| trigger.push(7.5, 0.001, &settings, PERIOD));
        assert_eq!(fired, Some(19));
        assert_eq!((trigger.early_crossings(), trigger.peak_n()), (1, 80.0));
        assert_eq!(trigger.latency_ticks(), 20);
    }

    #[test]
    fn a_moving_arm_is_not_in_contact() {
        let mut trigger = ContactTrigger::default();
        assert!((0..100).all(|_| !trigger.push(10.0, 0.025, &Approach::default(), PERIOD)));
    }

    #[test]
    fn a_nest_that_jumps_or_drifts_is_noticed() {
        let settings = Seating::default();
        let mut watch = SeatingWatch::new(Vector3::zeros());
        let here = Vector3::new(0.0019, 0.0, 0.0);
        assert!((0..1000).all(|_| watch.push(&here, 0.002, &settings, PERIOD).is_none()));
        assert_eq!(
            (0..50).position(|_| watch.push(&here, 0.05, &settings, PERIOD).is_some()),
            Some(9)
        );
        let mut watch = SeatingWatch::new(Vector3::zeros());
        let away = Vector3::new(0.0, 0.006, 0.0);
        assert_eq!(
            (0..50).position(|_| watch.push(&away, 0.0, &settings, PERIOD).is_some()),
            Some(9)
        );
    }

    #[test]
    fn the_tare_is_a_mean() {
        let mut tare = Tare::default();
        assert_eq!(tare.mean(), Wrench::default());
        let at = |x, z| Wrench {
            force: Vector3::new(x, 0.0, z),
            torque: Vector3::new(z, 0.0, x),
        };
        tare.push(&at(1.0, 2.0));
        tare.push(&at(3.0, 0.0));
        assert_eq!(tare.mean(), at(2.0, 1.0));
    }
}
