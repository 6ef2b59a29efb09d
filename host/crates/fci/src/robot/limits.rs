//! The limits of Panda and FR3, from the maker's data sheets.

use crate::JOINTS;
use crate::wire::{CollisionBehavior, Version};

/// Joint limits of an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmLimits {
    /// Lower position limits, rad.
    pub lower: [f64; JOINTS],
    /// Upper position limits, rad.
    pub upper: [f64; JOINTS],
    /// Largest velocities, rad/s.
    pub velocity: [f64; JOINTS],
    /// Largest torques, N m.
    pub torque: [f64; JOINTS],
    /// Largest accelerations of a motion generator, rad/s^2.
    pub acceleration: [f64; JOINTS],
    /// Largest jerks of a motion generator, rad/s^3.
    pub jerk: [f64; JOINTS],
    /// How the velocity limit falls near the stops; `None` for the Panda, whose limit is constant.
    pub near_stops: Option<NearStops>,
}

/// Near a stop the velocity limit is `min(velocity, max(0, sqrt(2 deceleration distance) - offset))`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearStops {
    /// Offset, rad/s.
    pub velocity_offset: [f64; JOINTS],
    /// Deceleration, rad/s^2.
    pub deceleration: [f64; JOINTS],
    /// The stops that the formula counts from, lower, rad. They stand a little outside the position limits.
    pub lower_stop: [f64; JOINTS],
    /// The same, upper, rad.
    pub upper_stop: [f64; JOINTS],
}

impl ArmLimits {
    /// Panda.
    pub const PANDA: Self = Self {
        lower: [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973],
        upper: [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973],
        velocity: [2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61],
        torque: [87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0],
        acceleration: [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0],
        jerk: [7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10_000.0, 10_000.0],
        near_stops: None,
    };

    /// FR3.
    pub const FR3: Self = Self {
        lower: [-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159],
        upper: [2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159],
        velocity: [2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26],
        torque: [87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0],
        acceleration: [10.0; JOINTS],
        jerk: [5000.0; JOINTS],
        near_stops: Some(NearStops {
            velocity_offset: [0.30, 0.20, 0.20, 0.30, 0.35, 0.35, 0.35],
            deceleration: [6.0, 2.585, 3.5, 4.0, 17.0, 5.5, 17.0],
            lower_stop: [-2.7501, -1.7918, -2.9065, -3.0481, -2.8101, 0.54092, -3.0196],
            upper_stop: [2.7501, 1.7918, 2.9065, -0.1458, 2.8101, 4.5205, 3.0196],
        }),
    };

    /// The limits of the robot that speaks this version.
    pub const fn of(version: Version) -> &'static Self {
        if version.is_panda() { &Self::PANDA } else { &Self::FR3 }
    }

    /// Lower and upper limit of a joint's velocity at position `q`, rad/s.
    pub fn velocity_at(&self, joint: usize, q: f64) -> (f64, f64) {
        let most = self.velocity[joint];
        let Some(near) = &self.near_stops else {
            return (-most, most);
        };
        let limit = |distance: f64| {
            let braking = (2.0 * near.deceleration[joint] * distance.max(0.0)).sqrt();
            (braking - near.velocity_offset[joint]).max(0.0).min(most)
        };
        (-limit(q - near.lower_stop[joint]), limit(near.upper_stop[joint] - q))
    }
}

/// The thresholds of a robot after its start: those that the maker's examples set. They are high enough for free motion
/// and low enough to detect a firm push.
pub(super) const DEFAULT_THRESHOLDS: CollisionBehavior = {
    const TORQUE: [f64; JOINTS] = [20.0, 20.0, 18.0, 18.0, 16.0, 14.0, 12.0];
    const FORCE: [f64; 6] = [20.0, 20.0, 20.0, 25.0, 25.0, 25.0];
    CollisionBehavior::uniform(TORQUE, TORQUE, FORCE, FORCE)
};

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if the velocity limit does not fall to 0 at the stop, rises above its maximum, or is asymmetric.
    #[test]
    fn the_velocity_limit_of_the_fr3_falls_near_the_stops() {
        let limits = &ArmLimits::FR3;
        for joint in 0..JOINTS {
            let middle = 0.5 * (limits.lower[joint] + limits.upper[joint]);
            let (lower, upper) = limits.velocity_at(joint, middle);
            assert!(upper <= limits.velocity[joint] && upper > 0.5 * limits.velocity[joint]);
            assert!((lower + upper).abs() < 0.01, "{joint}: {lower} {upper}");
            assert_eq!(limits.velocity_at(joint, limits.upper[joint] + 0.1).1, 0.0);
            assert_eq!(limits.velocity_at(joint, limits.lower[joint] - 0.1).0, 0.0);
        }
        // The maker's formula for joint 1: min(2.62, sqrt(12 (2.7501 - q)) - 0.3).
        let expected = (12.0_f64 * (2.7501 - 2.6)).sqrt() - 0.3;
        assert!((limits.velocity_at(0, 2.6).1 - expected).abs() < 1e-12);
        assert_eq!(ArmLimits::PANDA.velocity_at(0, 2.8), (-2.175, 2.175));
    }

    // Fails if the robot keeps other limits than its model says.
    #[test]
    fn the_model_states_the_limits_that_are_kept() {
        let near = ArmLimits::FR3.near_stops.as_ref().expect("the FR3 has them");
        for joint in 0..JOINTS {
            let start = super::super::FR3_URDF
                .split(&format!("name=\"fr3_joint{}\"", joint + 1))
                .nth(1);
            let text = start.and_then(|t| t.split("</joint>").next()).expect("the joint");
            let number = |name: &str| -> f64 {
                let value = text
                    .split(&format!(" {name}=\""))
                    .nth(1)
                    .and_then(|t| t.split('"').next());
                value.and_then(|v| v.parse().ok()).expect("a number")
            };
            assert_eq!(number("lower"), ArmLimits::FR3.lower[joint]);
            assert_eq!(number("upper"), ArmLimits::FR3.upper[joint]);
            assert_eq!(number("velocity"), ArmLimits::FR3.velocity[joint]);
            assert_eq!(number("effort"), ArmLimits::FR3.torque[joint]);
            assert_eq!(number("velocity_offset"), near.velocity_offset[joint]);
            assert_eq!(number("deceleration_limit"), near.deceleration[joint]);
        }
    }
}
