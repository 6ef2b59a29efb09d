//! The Cartesian spring of [`ImpedanceLoop`](super::ImpedanceLoop): its stiffness changes live, in the axes of the base or of the tool,
//! and a guard may bound the energy of such changes.

use nalgebra::{Matrix3, Vector6};

use super::damping::Damping;
use super::impedance::{CartesianSetpoint, rotation_about, rotation_error};
use super::passivity::{Tank, Withheld};
use super::snapshot::Snapshot;
use super::stiffness::FullStiffness;

/// The axes of a stiffness.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Axes {
    /// Those of F0.
    #[default]
    Base,
    /// Those of the tool: the stiffness turns with it.
    Tool,
}

impl Axes {
    fn of<const N: usize>(self, snapshot: &Snapshot<N>) -> Matrix3<f64> {
        match self {
            Self::Base => Matrix3::identity(),
            Self::Tool => snapshot.tcp.rotation,
        }
    }
}

/// The spring, its ramp and its guard.
#[derive(Clone, Debug)]
pub(crate) struct LiveSpring {
    /// Ends of the ramp, in `axes`.
    from: FullStiffness,
    to: FullStiffness,
    axes: Axes,
    share: f64,
    rate: f64,
    /// The ramp begins anew, at the stiffness of the last cycle.
    anew: bool,
    /// Stiffness of the last cycle, in F0.
    stiffness: FullStiffness,
    /// Setpoint of the last cycle.
    last: Option<CartesianSetpoint>,
    damping: Damping,
    /// The guard, if there is one.
    pub(crate) tank: Option<Tank>,
}

impl Default for LiveSpring {
    fn default() -> Self {
        let none = FullStiffness {
            translation: Matrix3::zeros(),
            rotation: Matrix3::zeros(),
        };
        Self {
            from: none,
            to: none,
            axes: Axes::Base,
            share: 1.0,
            rate: 1.0,
            anew: false,
            stiffness: none,
            last: None,
            damping: Damping::default(),
            tank: None,
        }
    }
}

impl LiveSpring {
    /// Starts a ramp to `stiffness` in `axes`, a share of `rate` a cycle.
    pub(crate) fn ramp_to(&mut self, stiffness: FullStiffness, axes: Axes, rate: f64) {
        (self.to, self.axes) = (stiffness, axes);
        (self.share, self.rate, self.anew) = (0.0, rate, true);
    }

    /// Forgets the last setpoint: the next one is no change.
    pub(crate) fn forget(&mut self) {
        self.last = None;
    }

    /// Force of spring and damper on the TCP, F0, in N and N m, and what the guard held back. Advances the ramp by one cycle.
    pub(crate) fn force<const N: usize>(
        &mut self,
        snapshot: &Snapshot<N>,
        goal: &CartesianSetpoint,
        ratio: f64,
        period_s: f64,
    ) -> (Vector6<f64>, Withheld) {
        let axes = self.axes.of(snapshot);
        if self.anew {
            (self.from, self.anew) = (self.stiffness.turned(&axes.transpose()), false);
        }
        let share = (self.share + self.rate).min(1.0);
        let asked = FullStiffness::between(&self.from, &self.to, share).turned(&axes);
        let (mut setpoint, mut stiffness, mut withheld) = (*goal, asked, Withheld::Nothing);
        let mut admitted = 1.0;
        if let Some(tank) = &mut self.tank {
            let tcp = &snapshot.tcp;
            let last = self.last.unwrap_or(CartesianSetpoint::at(tcp.position, tcp.rotation));
            let turn = rotation_error(&goal.rotation, &last.rotation);
            let angle = turn.norm();
            // Between the last command and this one.
            let part = |share: f64| {
                if share >= 1.0 {
                    return (*goal, asked);
                }
                let rotation = rotation_about(&(turn / angle.max(1e-12)), angle * share) * last.rotation;
                let between = CartesianSetpoint {
                    position: last.position + (goal.position - last.position) * share,
                    rotation,
                    velocity: goal.velocity * share,
                    ..*goal
                };
                (between, FullStiffness::between(&self.stiffness, &asked, share))
            };
            let energy = |(setpoint, stiffness): &(CartesianSetpoint, FullStiffness)| {
                let error = error(snapshot, setpoint);
                0.5 * error.dot(&stiffness.times(&error))
            };
            let before = energy(&part(0.0));
            admitted = tank.admit(|share| energy(&part(share)) - before);
            (setpoint, stiffness) = part(admitted);
            tank.take(energy(&(setpoint, stiffness)) - before);
            if admitted < 1.0 {
                withheld = Withheld::Change;
            }
        }
        if admitted < 1.0 {
            // The ramp goes on from what was admitted.
            (self.share, self.anew) = (0.0, true);
        } else {
            self.share = share;
        }
        self.stiffness = stiffness;
        let error = error(snapshot, &setpoint);
        let frequency = self.damping.update(snapshot, &stiffness);
        let damped = |velocity: &Vector6<f64>| {
            let off = velocity - snapshot.velocity;
            self.damping.of_modes(snapshot, &frequency, ratio, &error, &off)
        };
        let mut driven = damped(&setpoint.velocity) + setpoint.feed_forward;
        if let Some(tank) = &mut self.tank {
            let work = |driven: &Vector6<f64>| driven.dot(&snapshot.velocity) * period_s;
            if work(&driven) > tank.energy_j() {
                driven = damped(&Vector6::zeros());
                withheld = Withheld::Drive;
            }
            tank.take(work(&driven));
            tank.refill(period_s);
        }
        self.last = Some(setpoint);
        (stiffness.times(&error) + driven, withheld)
    }
}

/// Error of the pose: position (m) and rotation vector (rad).
fn error<const N: usize>(snapshot: &Snapshot<N>, setpoint: &CartesianSetpoint) -> Vector6<f64> {
    let position = setpoint.position - snapshot.tcp.position;
    let rotation = rotation_error(&setpoint.rotation, &snapshot.tcp.rotation);
    Vector6::new(position.x, position.y, position.z, rotation.x, rotation.y, rotation.z)
}
