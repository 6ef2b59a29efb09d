//! The setpoint generator: turns targets into setpoints of limited speed and
//! acceleration.
//!
//! It stands between the phases, which have targets, and the control law, which
//! follows setpoints.

use nalgebra::{Matrix3, Vector3};
use spherecal_shared::scalar::sqrt;

use crate::law::{JointSetpoint, rotation_about, rotation_error};

/// A motion from rest to rest along a quintic `s(t)` from 0 to 1: position, speed
/// and acceleration are continuous.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Profile {
    duration_s: f64,
}

impl Profile {
    /// Peak of `ds/dt` times the duration.
    const PEAK_SPEED: f64 = 1.875;
    /// Peak of `d²s/dt²` times the duration squared.
    const PEAK_ACCELERATION: f64 = 5.773_502_691_896_258;

    /// The shortest profile over `distance` within a speed and an acceleration
    /// (in the unit of the distance per s and per s²).
    pub(crate) fn over(distance: f64, speed: f64, acceleration: f64) -> Self {
        let distance = distance.abs();
        let by_speed = Self::PEAK_SPEED * distance / speed;
        let by_acceleration = sqrt(Self::PEAK_ACCELERATION * distance / acceleration);
        Self {
            duration_s: by_speed.max(by_acceleration),
        }
    }

    /// The longer of the two.
    pub(crate) fn max(self, other: Self) -> Self {
        Self {
            duration_s: self.duration_s.max(other.duration_s),
        }
    }

    /// Duration, in s.
    #[cfg(test)]
    pub(crate) fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// `s`, `ds/dt` (1/s) and `d²s/dt²` (1/s²) at time `t` (s).
    #[inline]
    pub(crate) fn at(&self, t: f64) -> (f64, f64, f64) {
        if !(t < self.duration_s) {
            return (1.0, 0.0, 0.0);
        }
        let x = (t / self.duration_s).max(0.0);
        let s = x * x * x * (10.0 + x * (-15.0 + 6.0 * x));
        let ds = 30.0 * x * x * (1.0 + x * (-2.0 + x)) / self.duration_s;
        let dds = 60.0 * x * (1.0 + x * (-3.0 + 2.0 * x)) / (self.duration_s * self.duration_s);
        (s, ds, dds)
    }
}

/// A motion of all joints together.
#[derive(Clone, Debug)]
pub(crate) struct JointMove<const N: usize> {
    start: [f64; N],
    target: [f64; N],
    profile: Profile,
}

impl<const N: usize> JointMove<N> {
    /// A motion from `start` to `target` (rad). No joint exceeds `speed` or its
    /// own value of `limits` (rad/s), or `acceleration` (rad/s²).
    pub(crate) fn new(start: [f64; N], target: [f64; N], speed: f64, limits: &[f64; N], acceleration: f64) -> Self {
        let mut profile = Profile { duration_s: 0.0 };
        for i in 0..N {
            profile = profile.max(Profile::over(target[i] - start[i], speed.min(limits[i]), acceleration));
        }
        Self { start, target, profile }
    }

    /// Duration, in s.
    pub(crate) fn duration_s(&self) -> f64 {
        self.profile.duration_s
    }

    /// The target, in rad.
    pub(crate) fn target(&self) -> &[f64; N] {
        &self.target
    }

    /// Setpoint at time `t` (s) since the start.
    #[inline]
    pub(crate) fn at(&self, t: f64) -> JointSetpoint<N> {
        let (s, ds, _) = self.profile.at(t);
        let mut setpoint = JointSetpoint {
            q: self.target,
            dq: [0.0; N],
        };
        for i in 0..N {
            let distance = self.target[i] - self.start[i];
            setpoint.q[i] = self.start[i] + distance * s;
            setpoint.dq[i] = distance * ds;
        }
        setpoint
    }
}

/// A turn of the tool about the TCP, with a motion of the elbow at the same time.
#[derive(Clone, Debug)]
pub(crate) struct TurnMove {
    start: Matrix3<f64>,
    target: Matrix3<f64>,
    axis: Vector3<f64>,
    angle: f64,
    elbow_start: f64,
    elbow_change: f64,
    profile: Profile,
}

/// Orientation and elbow of a [`TurnMove`] at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TurnSetpoint {
    /// Orientation in F0.
    pub(crate) rotation: Matrix3<f64>,
    /// Angular velocity in F0, in rad/s.
    pub(crate) angular: Vector3<f64>,
    /// Angular acceleration in F0, in rad/s².
    pub(crate) angular_acceleration: Vector3<f64>,
    /// Elbow angle, in rad.
    pub(crate) elbow: f64,
    /// Rate of the elbow angle, in rad/s.
    pub(crate) elbow_rate: f64,
    /// Acceleration of the elbow angle, in rad/s².
    pub(crate) elbow_acceleration: f64,
}

impl TurnMove {
    /// A motion between two orientations (F0), along the shortest rotation, and
    /// two elbow angles (rad), within a speed (rad/s) and an acceleration (rad/s²).
    pub(crate) fn new(
        start: Matrix3<f64>,
        target: Matrix3<f64>,
        elbow: (f64, f64),
        speed: f64,
        acceleration: f64,
    ) -> Self {
        let rotation = rotation_error(&target, &start);
        let angle = rotation.norm();
        let axis = if angle > 1e-12 { rotation / angle } else { Vector3::z() };
        let turn = core::f64::consts::TAU;
        let change = elbow.1 - elbow.0;
        let elbow_change = change - turn * libm::round(change / turn);
        let profile = Profile::over(angle, speed, acceleration).max(Profile::over(elbow_change, speed, acceleration));
        Self {
            start,
            target,
            axis,
            angle,
            elbow_start: elbow.0,
            elbow_change,
            profile,
        }
    }

    /// Duration, in s.
    pub(crate) fn duration_s(&self) -> f64 {
        self.profile.duration_s
    }

    /// Setpoint at time `t` (s) since the start.
    #[inline]
    pub(crate) fn at(&self, t: f64) -> TurnSetpoint {
        let (s, ds, dds) = self.profile.at(t);
        let rotation = if s >= 1.0 {
            self.target
        } else {
            rotation_about(&self.axis, self.angle * s) * self.start
        };
        TurnSetpoint {
            rotation,
            angular: self.axis * (self.angle * ds),
            angular_acceleration: self.axis * (self.angle * dds),
            elbow: self.elbow_start + self.elbow_change * s,
            elbow_rate: self.elbow_change * ds,
            elbow_acceleration: self.elbow_change * dds,
        }
    }
}

/// Rotation matrix of a unit quaternion w, x, y, z.
///
/// `None` if a component is not finite or the norm is not 1 to within 1e-6.
pub(crate) fn rotation_of(quaternion: &[f64; 4]) -> Option<Matrix3<f64>> {
    let [w, x, y, z] = *quaternion;
    let norm2 = w * w + x * x + y * y + z * z;
    if !((norm2 - 1.0).abs() < 2e-6) {
        return None;
    }
    let scale = 1.0 / sqrt(norm2);
    let (w, x, y, z) = (w * scale, x * scale, y * scale, z * scale);
    #[rustfmt::skip]
    let rotation = Matrix3::new(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z),       2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),       1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),       2.0 * (y * z + w * x),       1.0 - 2.0 * (x * x + y * y),
    );
    Some(rotation)
}

/// A setpoint that moves along a line: it accelerates, then keeps its speed, and
/// stops after `length` (which may be infinite).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LineMove {
    direction: Vector3<f64>,
    speed: f64,
    acceleration: f64,
    length: f64,
    travelled: f64,
    now: f64,
}

impl LineMove {
    /// A motion along a unit vector, within a speed (m/s) and an acceleration
    /// (m/s²), over a length (m).
    pub(crate) fn new(direction: Vector3<f64>, speed: f64, acceleration: f64, length: f64) -> Self {
        Self {
            direction,
            speed,
            acceleration,
            length,
            travelled: 0.0,
            now: 0.0,
        }
    }

    /// Advances by one period. Returns displacement (m) and velocity (m/s).
    #[inline]
    pub(crate) fn step(&mut self, period_s: f64) -> (Vector3<f64>, Vector3<f64>) {
        // The speed from which the remaining distance suffices to stop.
        let left = (self.length - self.travelled).max(0.0);
        let stopping = if left < 1.0 {
            sqrt(2.0 * self.acceleration * left)
        } else {
            self.speed
        };
        self.now = (self.now + self.acceleration * period_s).min(self.speed).min(stopping);
        self.travelled = (self.travelled + self.now * period_s).min(self.length);
        (self.direction * self.travelled, self.direction * self.now)
    }

    /// Whether the end is reached, to 0.1 mm.
    pub(crate) fn finished(&self) -> bool {
        self.length - self.travelled < 1e-4
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        // Fails if a setpoint exceeds the speed or the acceleration, jumps, or misses its end.
        #[test]
        fn profiles_keep_their_limits(distance in 0.001f64..3.0, speed in 0.05f64..2.0, acceleration in 0.1f64..10.0) {
            let profile = Profile::over(distance, speed, acceleration);
            let n = 2000;
            let dt = profile.duration_s() / f64::from(n);
            let (mut last, mut last_rate, mut last_change) = profile.at(0.0);
            prop_assert_eq!((last, last_rate, last_change), (0.0, 0.0, 0.0));
            for k in 1..=n {
                let (s, ds, dds) = profile.at(f64::from(k) * dt);
                prop_assert!(s >= last && ds * distance <= speed * 1.000_001);
                prop_assert!((ds - last_rate).abs() * distance <= acceleration * dt * 1.001);
                prop_assert!((s - last - 0.5 * (ds + last_rate) * dt).abs() < 1e-6);
                prop_assert!((ds - last_rate - 0.5 * (dds + last_change) * dt).abs() * profile.duration_s() < 1e-6);
                (last, last_rate, last_change) = (s, ds, dds);
            }
            prop_assert!((last - 1.0).abs() < 1e-12);
        }

        // Fails if the turn does not start and end as asked, or if its angular velocity is not its derivative.
        #[test]
        fn turns_are_consistent(a in prop::array::uniform3(0.1f64..1.0), b in prop::array::uniform3(-1.0f64..-0.1), t in 0.05f64..0.95) {
            let rotation = |v: [f64; 3]| { let v = Vector3::from(v); rotation_about(&(v / v.norm()), v.norm()) };
            let turn = TurnMove::new(rotation(a), rotation(b), (3.0, -3.0), 0.5, 1.5);
            prop_assert!((turn.at(0.0).rotation - rotation(a)).norm() < 1e-12);
            prop_assert!((turn.at(turn.duration_s()).rotation - rotation(b)).norm() < 1e-12);
            // From 3 to -3 rad the short way leads through pi.
            prop_assert!((turn.at(1e9).elbow - (3.0 + core::f64::consts::TAU - 6.0)).abs() < 1e-12);
            let (h, t) = (1e-6, t * turn.duration_s());
            let difference = rotation_error(&turn.at(t + h).rotation, &turn.at(t - h).rotation) / (2.0 * h);
            prop_assert!((difference - turn.at(t).angular).norm() < 1e-5);
        }

        // Fails if the line overshoots, exceeds its speed or never ends.
        #[test]
        fn lines_end(length in 0.002f64..0.3, speed in 0.005f64..0.25) {
            let mut line = LineMove::new(Vector3::z(), speed, 0.5, length);
            let mut ticks = 0;
            while !line.finished() {
                let (p, v) = line.step(1e-3);
                prop_assert!(p.z <= length + 1e-12 && v.z <= speed + 1e-12);
                ticks += 1;
                prop_assert!(ticks < 200_000, "the line must end");
            }
        }

        #[test]
        fn quaternions_become_rotations(v in prop::array::uniform3(0.01f64..1.7)) {
            let v = Vector3::from(v);
            let (s, c) = libm::sincos(0.5 * v.norm());
            let u = v / v.norm() * s;
            let rotation = rotation_of(&[c, u.x, u.y, u.z]).expect("a unit quaternion");
            prop_assert!((rotation - rotation_about(&(v / v.norm()), v.norm())).norm() < 1e-12);
        }
    }

    #[test]
    fn bad_quaternions_are_refused() {
        assert!(rotation_of(&[1.0, 0.1, 0.0, 0.0]).is_none());
        assert!(rotation_of(&[f64::NAN, 0.0, 0.0, 0.0]).is_none());
    }
}
