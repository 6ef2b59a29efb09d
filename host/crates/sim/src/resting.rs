//! The simulated plant with closed brakes, behind the interfaces of Universal Robots.

use spherecal_link::LinkError;
use spherecal_model::robots::RobotModel;
use spherecal_shared::robot::{Arm, Dynamics as _};
use spherecal_ur::robot as ur;

use crate::plant::{Plant, PlantConfig};
use crate::simulated::SimulatedArmError;

/// Joints of every arm with such an interface.
const JOINTS: usize = spherecal_ur::JOINTS;
/// Control period of the plant, in s.
const PERIOD_S: f64 = 1e-3;

/// An arm that rests: nobody commands it.
pub struct RestingArm {
    plant: Plant<JOINTS>,
    /// The nominal arm with its tool: what the robot computes gravity with.
    known: Arm<f64, JOINTS>,
}

impl RestingArm {
    /// A plant at rest at `q` (rad).
    ///
    /// # Errors
    /// The robot has another number of joints than 6, or the plant is refused.
    pub fn new(model: &RobotModel, config: &PlantConfig, q: &[f64]) -> Result<Self, SimulatedArmError> {
        let q: &[f64; JOINTS] = q.try_into().map_err(|_| LinkError::OtherRobot {
            drive: JOINTS,
            robot: q.len(),
        })?;
        let tool = model.tool_in_table();
        Ok(Self {
            plant: Plant::new(&model.robot, &tool, config, q)?,
            known: Arm::new(&model.robot, &tool).map_err(crate::plant::PlantError::from)?,
        })
    }
}

impl ur::ArmHardware for RestingArm {
    fn state(&self) -> ur::ArmState {
        let q = self.plant.sensed().q;
        ur::ArmState {
            q,
            qd: [0.0; JOINTS],
            moment: self.known.bodies(&self.known.frames(&q)).gravity().into(),
        }
    }

    fn step(&mut self, step_s: f64) -> ur::ArmState {
        let ticks = (step_s / PERIOD_S).round().clamp(1.0, 100.0) as u32;
        for _ in 0..ticks {
            self.plant.step_braked();
        }
        ur::ArmHardware::state(self)
    }
}

#[cfg(test)]
mod tests {
    use spherecal_model::robots;
    use ur::ArmHardware as _;

    use super::*;

    // Fails if a resting arm sinks, a period of several milliseconds is one step of the plant, the torques of a stretched arm
    // are not those of gravity, or an arm with seven joints is taken.
    #[test]
    fn a_resting_arm_stays_and_tells_its_weight() {
        let model = robots::load("ur5e").expect("built in");
        let q = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let mut arm = RestingArm::new(&model, &PlantConfig::typical(), &q).expect("an arm");
        let before = (arm.state(), arm.plant.sensed().tick);
        for _ in 0..50 {
            arm.step(8e-3);
        }
        let after = arm.state();
        assert_eq!(arm.plant.sensed().tick, before.1 + 400);
        assert!(
            (0..6).all(|j| (after.q[j] - before.0.q[j]).abs() < 1e-3 && after.qd[j] == 0.0),
            "{after:?}"
        );
        // Level and stretched: the shoulder holds the links at their centres of mass, some 40 N m; the base holds nothing.
        assert!(
            after.moment[0].abs() < 1e-9 && (30.0..60.0).contains(&after.moment[1].abs()),
            "{after:?}"
        );
        let seven = robots::load("iiwa7").expect("built in");
        assert!(RestingArm::new(&seven, &PlantConfig::typical(), &[0.0; 7]).is_err());
    }
}
