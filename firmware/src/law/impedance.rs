//! The Cartesian spring-damper: `F = K e + D (v_d − v)` at the TCP.

use nalgebra::{Matrix3, Vector3, Vector6};

use super::damping::Damping;
use super::snapshot::Snapshot;
use super::stiffness::Stiffness;

/// Setpoint of the Cartesian spring: the pose that the TCP is pulled to, in F0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CartesianSetpoint {
    /// Position, in m.
    pub position: Vector3<f64>,
    /// Orientation.
    pub rotation: Matrix3<f64>,
    /// Velocity: linear in m/s, angular in rad/s.
    pub velocity: Vector6<f64>,
    /// Force and torque added to those of the spring, in N and N m.
    pub feed_forward: Vector6<f64>,
}

impl CartesianSetpoint {
    /// A setpoint at rest.
    pub fn at(position: Vector3<f64>, rotation: Matrix3<f64>) -> Self {
        Self {
            position,
            rotation,
            velocity: Vector6::zeros(),
            feed_forward: Vector6::zeros(),
        }
    }
}

/// Rotation vector from `actual` to `desired` in F0, in rad: the logarithm of
/// `R_d Rᵀ`.
#[inline]
pub fn rotation_error(desired: &Matrix3<f64>, actual: &Matrix3<f64>) -> Vector3<f64> {
    // Of R_d R^T only the skew part and the trace, which the logarithm needs.
    let mut skew = Vector3::zeros();
    let mut trace = 0.0;
    for k in 0..3 {
        let d = desired.column(k);
        let a = actual.column(k);
        skew.x += d[2] * a[1] - d[1] * a[2];
        skew.y += d[0] * a[2] - d[2] * a[0];
        skew.z += d[1] * a[0] - d[0] * a[1];
        trace += d[0] * a[0] + d[1] * a[1] + d[2] * a[2];
    }
    let sine = 0.5 * skew.norm();
    let cosine = 0.5 * (trace - 1.0);
    // angle / (2 sin angle), which tends to 1/2 for small angles (to 1e-13).
    // Near half a turn the axis is undefined; the lower bound on the sine bounds
    // the error.
    let factor = if sine < 1e-6 && cosine > 0.0 {
        0.5
    } else {
        0.5 * libm::atan2(sine, cosine) / sine.max(1e-6)
    };
    skew * factor
}

/// The Cartesian impedance: the present stiffness, its ramp and the damping.
#[derive(Clone, Debug)]
pub struct Impedance {
    stiffness: Stiffness,
    from: Stiffness,
    to: Stiffness,
    share: f64,
    rate: f64,
    damping: Damping,
}

impl Impedance {
    /// An impedance with the given stiffness.
    pub fn new(stiffness: Stiffness) -> Self {
        Self {
            stiffness,
            from: stiffness,
            to: stiffness,
            share: 1.0,
            rate: 1.0,
            damping: Damping::default(),
        }
    }

    /// Starts a ramp to `stiffness` over `ramp_s` seconds, in ticks of `period_s`.
    pub(crate) fn ramp_to(&mut self, stiffness: Stiffness, ramp_s: f64, period_s: f64) {
        self.from = self.stiffness;
        self.to = stiffness;
        self.share = 0.0;
        self.rate = if ramp_s > period_s { period_s / ramp_s } else { 1.0 };
    }

    /// Whether the stiffness ramp is over.
    pub(crate) fn settled(&self) -> bool {
        self.share >= 1.0
    }

    /// The present stiffness.
    pub fn stiffness(&self) -> &Stiffness {
        &self.stiffness
    }

    /// Force of the spring-damper on the TCP, F0, in N and N m. Advances the
    /// stiffness ramp by one tick. `ratio` is Lehr's damping ratio.
    #[inline]
    pub fn force<const N: usize>(
        &mut self,
        snapshot: &Snapshot<N>,
        setpoint: &CartesianSetpoint,
        ratio: f64,
    ) -> Vector6<f64> {
        if self.share < 1.0 {
            self.share = (self.share + self.rate).min(1.0);
            self.stiffness = Stiffness::between(&self.from, &self.to, self.share);
        }
        let position = setpoint.position - snapshot.tcp.position;
        let rotation = rotation_error(&setpoint.rotation, &snapshot.tcp.rotation);
        let error = Vector6::new(position.x, position.y, position.z, rotation.x, rotation.y, rotation.z);
        let velocity_error = setpoint.velocity - snapshot.velocity;
        let damping = self.damping.force(snapshot, &self.stiffness, ratio, &velocity_error);
        self.stiffness.times(&error) + damping + setpoint.feed_forward
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::HOME;
    use spherecal_shared::robot::{Arm, iiwa7, iiwa7_tool};

    // Fails if an axis without stiffness has no damping: a soft arm would drift on.
    #[test]
    fn an_axis_without_stiffness_is_damped_too() {
        let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
        let snapshot = Snapshot::new(&arm, &HOME, &[0.0; 7]).expect("a mass matrix");
        let mut impedance = Impedance::new(Stiffness::isotropic(0.0, 200.0));
        let mut setpoint = CartesianSetpoint::at(snapshot.tcp.position, snapshot.tcp.rotation);
        for _ in 0..30 {
            impedance.force(&snapshot, &setpoint, 0.7);
        }
        for axis in 0..3 {
            setpoint.velocity = Vector6::zeros();
            setpoint.velocity[axis] = 1.0;
            let force = impedance.force(&snapshot, &setpoint, 0.7);
            assert!(force[axis] > 0.3, "axis {axis}: {force:?}");
        }
    }
}
