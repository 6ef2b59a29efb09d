//! The simulated plant behind the interfaces of Universal Robots.
//!
//! What the robot does itself is here: it adds the gravity of the nominal arm and of the load that it was told, holds its pose
//! without a program, and tells the torques of its motors. These are what the program asked for: friction and motors lie
//! between them and the links. The simulated friction is what the robot's own compensation leaves.

use nalgebra::SVector;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, Normal};
use spherecal_link::LinkError;
use spherecal_model::robots::{RobotModel, UR_MOTOR_KG_M2, moved};
use spherecal_shared::robot::{Arm, Dynamics as _, Inertia, Tool};
use spherecal_ur::robot as ur;
use spherecal_ur::wire::Load;

use crate::plant::config::InertiaConfig;
use crate::plant::{Plant, PlantConfig, PlantError};
use crate::simulated::SimulatedArmError;

/// Joints of every arm with such an interface.
const JOINTS: usize = spherecal_ur::JOINTS;
/// Control period of the plant, in s.
const PERIOD_S: f64 = 1e-3;
/// Natural frequency of the robot's own position control, rad/s, and how fast it takes away what is left, 1/s. A real one is stiffer; this
/// is what the arm with elastic joints takes at 1 kHz.
const FOLLOW_RAD_S: f64 = 40.0;
const FOLLOW_PER_S: f64 = 8.0;

/// The simulated arm inside of a robot of Universal Robots.
pub struct UrArm {
    plant: Plant<JOINTS>,
    model: RobotModel,
    /// The nominal arm with the load that the robot was told: what it computes gravity with.
    known: Arm<f64, JOINTS>,
    holds: bool,
    /// Torques of the last period, without gravity, N m.
    asked: [f64; JOINTS],
    /// What the position control has summed up since it began: the error's integral, rad s.
    missed: [f64; JOINTS],
    /// Whether its joints give way between motor and link.
    elastic: bool,
    /// Velocities of the last setpoint, rad/s.
    followed: [f64; JOINTS],
    noise: Normal<f64>,
    random: ChaCha8Rng,
    motor_torque: [f64; JOINTS],
}

/// A plant whose motors show, as those of these robots do: their torques are commanded and measured at the motors. A plant
/// that says other motors than the presets do keeps them.
pub fn with_ur_motors(config: &PlantConfig) -> PlantConfig {
    let mut config = config.clone();
    let motors = |of: &InertiaConfig| (of.rotor_kg_m2, of.rotor_share);
    if motors(&config.inertia) == motors(&InertiaConfig::default()) {
        config.inertia = InertiaConfig {
            rotors: true,
            rotor_kg_m2: config.inertia.rotor_kg_m2.map(|_| UR_MOTOR_KG_M2),
            rotor_share: 1.0,
            ..config.inertia
        };
    }
    config
}

impl UrArm {
    /// A plant at rest at `q` (rad). The robot knows the load of the model's tool until a program tells another.
    ///
    /// # Errors
    /// The robot has another number of joints than 6, or the plant is refused.
    pub fn new(model: &RobotModel, config: &PlantConfig, q: &[f64]) -> Result<Self, SimulatedArmError> {
        let q: &[f64; JOINTS] = q.try_into().map_err(|_| LinkError::OtherRobot {
            drive: JOINTS,
            robot: q.len(),
        })?;
        let tool = model.tool_in_table();
        let noise = if config.sensors.noise {
            config.sensors.torque_white_nm
        } else {
            0.0
        };
        let mut arm = Self {
            plant: Plant::new(&model.robot, &tool, config, q)?,
            model: model.clone(),
            known: Arm::new(&model.robot, &tool).map_err(PlantError::from)?,
            holds: true,
            asked: [0.0; JOINTS],
            missed: [0.0; JOINTS],
            elastic: config.elasticity.enabled,
            followed: [0.0; JOINTS],
            noise: Normal::new(0.0, noise).map_err(|_| PlantError::Massless)?,
            random: ChaCha8Rng::seed_from_u64(config.seed),
            motor_torque: [0.0; JOINTS],
        };
        arm.measure();
        Ok(arm)
    }

    fn gravity(&self) -> [f64; JOINTS] {
        let q = &self.plant.sensed().q;
        self.known.bodies(&self.known.frames(q)).gravity().into()
    }

    /// Moves on by 1 ms with these torques, without gravity, N m.
    fn follow(&mut self, torque: [f64; JOINTS]) {
        let gravity = self.gravity();
        self.plant.step(&std::array::from_fn(|j| torque[j] + gravity[j]));
        self.asked = torque;
    }

    /// Torques of the position control, without gravity, N m.
    fn position_control(
        &mut self,
        q: &[f64; JOINTS],
        qd: &[f64; JOINTS],
        acceleration: &[f64; JOINTS],
    ) -> [f64; JOINTS] {
        let sensed = self.plant.sensed();
        let mut mass = self.known.bodies(&self.known.frames(&sensed.q)).mass_matrix();
        self.known.add_rotors(&mut mass);
        let motors = self.plant.declared_motors();
        for (j, motor) in motors.iter().enumerate() {
            mass[(j, j)] += motor;
        }
        let mut wanted = SVector::zeros();
        for j in 0..JOINTS {
            // A damper on the motor alone, which an elastic joint leaves to itself, must not turn its speed round in a period.
            let rad_s = if self.elastic {
                FOLLOW_RAD_S.min(0.25 * motors[j] / (PERIOD_S * mass[(j, j)]))
            } else {
                FOLLOW_RAD_S
            };
            let error = q[j] - sensed.q[j];
            self.missed[j] += error * PERIOD_S;
            let spring = error + FOLLOW_PER_S.min(0.5 * rad_s) * self.missed[j];
            wanted[j] = acceleration[j] + rad_s * (rad_s * spring + 2.0 * (qd[j] - sensed.dq[j]));
        }
        (mass * wanted).into()
    }

    /// What the motors' currents say after a period.
    fn measure(&mut self) {
        let (gravity, sensed) = (self.gravity(), self.plant.sensed());
        let torque: [f64; JOINTS] = std::array::from_fn(|j| {
            if self.holds {
                sensed.tau[j] - gravity[j]
            } else {
                self.asked[j]
            }
        });
        self.motor_torque = torque.map(|torque| torque + self.noise.sample(&mut self.random));
    }
}

impl ur::ArmHardware for UrArm {
    fn state(&self) -> ur::ArmState {
        let sensed = self.plant.sensed();
        ur::ArmState {
            q: sensed.q,
            qd: if self.holds { [0.0; JOINTS] } else { sensed.dq },
            moment: self.gravity(),
            motor_torque: self.motor_torque,
        }
    }

    fn step(&mut self, command: ur::ArmCommand, step_s: f64) -> ur::ArmState {
        // From rest where nothing was followed before.
        let before = std::mem::replace(
            &mut self.followed,
            match command {
                ur::ArmCommand::Follow(_, qd) => qd,
                _ => [0.0; JOINTS],
            },
        );
        let acceleration = std::array::from_fn(|j| (self.followed[j] - before[j]) / step_s.max(PERIOD_S));
        let ticks = (step_s / PERIOD_S).round().clamp(1.0, 100.0) as u32;
        for _ in 0..ticks {
            match command {
                ur::ArmCommand::Hold => {
                    self.plant.step_braked();
                }
                ur::ArmCommand::Torque(torque) => self.follow(torque),
                ur::ArmCommand::Follow(q, qd) => {
                    let torque = self.position_control(&q, &qd, &acceleration);
                    self.follow(torque);
                }
            }
        }
        if !matches!(command, ur::ArmCommand::Follow(..)) {
            self.missed = [0.0; JOINTS];
        }
        self.holds = command == ur::ArmCommand::Hold;
        self.measure();
        ur::ArmHardware::state(self)
    }

    fn set_load(&mut self, load: &Load) {
        let body = Inertia {
            mass_kg: load.mass_kg,
            com_m: load.com_m,
            inertia_kg_m2: load.inertia_kg_m2,
        };
        let tool = Tool {
            body: moved(&body, &self.model.flange),
            ..self.model.tool_in_table()
        };
        // A load that no tool can have is ignored: the arm then feels it as an external force.
        if let Ok(known) = Arm::new(&self.model.robot, &tool) {
            self.known = known;
        }
    }
}

#[cfg(test)]
mod tests {
    use spherecal_model::robots;
    use ur::ArmHardware as _;

    use super::*;

    fn moved_by(before: &ur::ArmState, after: &ur::ArmState) -> f64 {
        (0..JOINTS).fold(0.0, |most: f64, j| most.max((after.q[j] - before.q[j]).abs()))
    }

    // Fails if a resting arm sinks, a period of several milliseconds is one step of the plant, the torques of a stretched arm
    // are not those of gravity, or an arm with seven joints is taken.
    #[test]
    fn a_resting_arm_stays_and_tells_its_weight() {
        let model = robots::load("ur5e").expect("built in");
        let q = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let mut arm = UrArm::new(&model, &PlantConfig::typical(), &q).expect("an arm");
        let before = (arm.state(), arm.plant.sensed().tick);
        for _ in 0..50 {
            arm.step(ur::ArmCommand::Hold, 8e-3);
        }
        let after = arm.state();
        assert_eq!(arm.plant.sensed().tick, before.1 + 400);
        assert!(
            moved_by(&before.0, &after) < 1e-3 && after.qd == [0.0; JOINTS],
            "{after:?}"
        );
        // Level and stretched: the shoulder holds the links at their centres of mass, some 40 N m; the base holds nothing.
        assert!(
            after.moment[0].abs() < 1e-9 && (30.0..60.0).contains(&after.moment[1].abs()),
            "{after:?}"
        );
        let seven = robots::load("iiwa7").expect("built in");
        assert!(UrArm::new(&seven, &PlantConfig::typical(), &[0.0; 7]).is_err());
    }

    // Fails if a preset gives such a robot the heavy motors of another maker, or if motors that the plant states are not kept.
    #[test]
    fn a_preset_has_the_motors_of_these_robots() {
        for preset in [PlantConfig::typical(), PlantConfig::as_measured(), PlantConfig::harsh()] {
            let own = with_ur_motors(&preset).inertia;
            assert!(own.rotors && own.rotor_share == 1.0 && own.rotor_kg_m2 == [UR_MOTOR_KG_M2; 8]);
            let mut stated = preset.clone();
            (stated.inertia.rotors, stated.inertia.rotor_kg_m2) = (true, [0.3; 8]);
            assert_eq!(with_ur_motors(&stated).inertia.rotor_kg_m2, [0.3; 8]);
        }
    }

    // Fails if the robot does not add the gravity of arm and load: without a torque the arm must stay, and a load that it was
    // told wrongly must move it. Or if the motors do not tell the torque that was asked for.
    #[test]
    fn the_robot_adds_gravity_and_tells_its_motors_torques() {
        let model = robots::load("ur5e").expect("built in");
        let q = [0.1, -1.2, 1.3, -1.4, -1.5, 0.6];
        let config = with_ur_motors(&PlantConfig::typical());
        let moved = |extra_kg: f64, torque: [f64; JOINTS]| {
            let mut arm = UrArm::new(&model, &config, &q).expect("an arm");
            let body = model.tool.body;
            arm.set_load(&Load {
                mass_kg: body.mass_kg + extra_kg,
                com_m: body.com_m,
                inertia_kg_m2: body.inertia_kg_m2,
            });
            let before = arm.state();
            for _ in 0..150 {
                arm.step(ur::ArmCommand::Torque(torque), 2e-3);
            }
            let after = arm.state();
            (moved_by(&before, &after), after.motor_torque)
        };
        let own = moved(0.0, [0.0; JOINTS]).0;
        assert!(own < 0.02, "friction and model errors move it by {own} rad");
        assert!(
            moved(5.0, [0.0; JOINTS]).0 > 5.0 * own.max(0.01),
            "a load that is missing shows"
        );
        let (turned, told) = moved(0.0, [0.0, 0.0, 0.0, 0.0, 0.0, 0.5]);
        assert!(turned > 0.05 && (told[5] - 0.5).abs() < 0.2, "{turned} rad, {told:?}");
    }

    // Fails if the position control of the smallest or the largest arm, with elastic joints and friction, swings, leaves a moving
    // setpoint, or does not come to rest where it ends.
    #[test]
    fn the_position_control_keeps_to_its_setpoint() {
        // Upright, clear of spheres and plate.
        let q = [0.1, -1.5, 0.4, -1.4, -1.5, 0.6];
        for (robot, config) in [
            ("ur3e", PlantConfig::as_measured()),
            ("ur30", PlantConfig::as_measured()),
            ("ur5e", PlantConfig::harsh()),
        ] {
            let model = robots::load(robot).expect("built in");
            let mut arm = UrArm::new(&model, &with_ur_motors(&config), &q).expect("an arm");
            let speed = [0.3, -0.3, 0.3, 0.3, -0.3, 0.3];
            let (mut end, mut off, mut left) = (q, 0.0f64, 0.0f64);
            for period in 0..1000u32 {
                // To 0.3 rad/s and back to rest with 2 rad/s², as a robot moves.
                let share = f64::from(period.min(400 - period.min(400))) / 75.0;
                let qd = speed.map(|speed| speed * share.min(1.0));
                end = std::array::from_fn(|j| end[j] + qd[j] * 2e-3);
                let at = arm.step(ur::ArmCommand::Follow(end, qd), 2e-3);
                let now = (0..JOINTS).fold(0.0f64, |most, j| most.max((at.q[j] - end[j]).abs()));
                off = off.max(now);
                left = if period < 900 { 0.0 } else { left.max(now) };
            }
            // A UR30 with motors of 0.1 kg m² takes a hundredth of the gain of a small arm; a motion may end 20 mrad off.
            assert!(off < 0.01 && left < 0.002, "{robot}: {off} and {left} rad off");
        }
    }
}
