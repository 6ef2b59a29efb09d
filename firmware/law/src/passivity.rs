//! The passivity guard: an energy tank (Ferraguti, Secchi and Fantuzzi, ICRA 2013).

use super::error::LawError;

/// Bound of the energy that commands may give to arm and spring.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnergyLimit {
    /// What the tank holds at most, and at the beginning, in J.
    pub capacity_j: f64,
    /// What it gets without end, in W: friction takes energy that never comes back, and with 0 an arm with friction stands still in
    /// the end.
    pub refill_w: f64,
}

/// What the guard held back in a cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Withheld {
    /// Nothing.
    #[default]
    Nothing,
    /// A part of a change of setpoint or stiffness.
    Change,
    /// The setpoint's velocity and the added force: the damper then only takes energy.
    Drive,
}

/// The tank, and the law of its energy.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tank {
    limit: EnergyLimit,
    energy_j: f64,
}

impl Tank {
    /// A full tank.
    ///
    /// # Errors
    /// [`LawError::Energy`] for a number that is negative or not finite.
    pub(crate) fn new(limit: EnergyLimit) -> Result<Self, LawError> {
        for (field, value) in [("capacity_j", limit.capacity_j), ("refill_w", limit.refill_w)] {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(LawError::Energy { field });
            }
        }
        Ok(Self {
            limit,
            energy_j: limit.capacity_j,
        })
    }

    /// What it holds, in J.
    pub(crate) fn energy_j(&self) -> f64 {
        self.energy_j
    }

    /// The largest share of a change, from 0 to 1, that it can pay for. `cost` gives the energy (J) of a share; that of 0 is 0.
    #[inline]
    pub(crate) fn admit(&self, cost: impl Fn(f64) -> f64) -> f64 {
        if cost(1.0) <= self.energy_j {
            return 1.0;
        }
        // 0 can always be paid for. 20 halvings: a millionth of the change.
        let (mut share, mut step) = (0.0, 0.5);
        for _ in 0..20 {
            if cost(share + step) <= self.energy_j {
                share += step;
            }
            step *= 0.5;
        }
        share
    }

    /// Takes energy (J); a negative one fills it.
    #[inline]
    pub(crate) fn take(&mut self, energy_j: f64) {
        self.energy_j = (self.energy_j - energy_j).max(0.0).min(self.limit.capacity_j);
    }

    /// The refill of one period (s).
    #[inline]
    pub(crate) fn refill(&mut self, period_s: f64) {
        self.take(-self.limit.refill_w * period_s);
    }
}
