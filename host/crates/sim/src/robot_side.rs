//! The simulated plant behind the robot's own interface: as a Panda or an FR3, and as an LBR behind a KUKA cabinet.
//!
//! What the robot does itself is here: it compensates the gravity of the nominal arm and of the load that was declared,
//! holds its pose with the brakes, and estimates the external torques and the wrench at the TCP. It does not compensate
//! friction, so the controller has more to do than on a real robot. Over these interfaces a robot does not say which
//! motors lie between commanded and measured torque: [`RobotArm::undeclared`] is what its user has to find in a data sheet.

use nalgebra::SVector;
use spherecal_fci::robot as fci;
use spherecal_firmware::law::{Observer, Snapshot};
use spherecal_fri::robot as fri;
use spherecal_link::LinkError;
use spherecal_link::native::Undeclared;
use spherecal_model::robots::{RobotModel, moved};
use spherecal_shared::robot::{Arm, Dynamics as _, Inertia, Tool};

use crate::plant::{Plant, PlantConfig};
use crate::simulated::SimulatedArmError;

/// Joints of every arm with such an interface.
const JOINTS: usize = 7;
/// Pole of the robot's own estimate of external torques, in 1/s.
const OBSERVER_RAD_S: f64 = 60.0;
/// Stiffness of a Franka's own joint controller, N m/rad. A real one has up to 3,000: this is what the light wrist of the
/// simulated arm, which has no rotors, takes at 1 kHz.
const STIFFNESS_NM_RAD: [f64; JOINTS] = [600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0];
/// Its damping, N m s/rad.
const DAMPING_NM_S_RAD: [f64; JOINTS] = [50.0, 50.0, 40.0, 40.0, 10.0, 8.0, 2.0];
/// Control period of the plant, in s.
const PERIOD_S: f64 = 1e-3;

/// The simulated arm inside of a robot that has an interface of its own.
pub struct RobotArm {
    plant: Plant<JOINTS>,
    model: RobotModel,
    /// The nominal arm with the declared load: what the robot computes with.
    known: Arm<f64, JOINTS>,
    observer: Observer<JOINTS>,
    braked: bool,
    external: [f64; JOINTS],
    wrench: [f64; 6],
    /// Stiffness (N m/rad) and damping (N m s/rad) of the cabinet's joint impedance.
    impedance: (f64, f64),
}

impl RobotArm {
    /// A plant at rest at `q` (rad). The load that the robot knows is that of the model's tool; a Franka client
    /// declares another. `impedance`: stiffness (N m/rad) and damping (N m s/rad) under a KUKA overlay.
    ///
    /// # Errors
    /// The robot has another number of joints than 7, or the plant is refused.
    pub fn new(
        model: &RobotModel,
        config: &PlantConfig,
        q: &[f64],
        impedance: (f64, f64),
    ) -> Result<Self, SimulatedArmError> {
        let q: &[f64; JOINTS] = q.try_into().map_err(|_| LinkError::OtherRobot {
            drive: JOINTS,
            robot: q.len(),
        })?;
        let tool = model.tool_in_table();
        let plant = Plant::new(&model.robot, &tool, config, q)?;
        let known = Arm::new(&model.robot, &tool).map_err(crate::plant::PlantError::from)?;
        Ok(Self {
            plant,
            model: model.clone(),
            known,
            observer: Observer::default(),
            braked: true,
            external: [0.0; JOINTS],
            wrench: [0.0; 6],
            impedance,
        })
    }

    /// What this robot does not say over its interface: inertia of each motor by its data sheet (kg m²) and its delay (µs).
    pub fn undeclared(&self) -> Undeclared {
        Undeclared {
            motor_kg_m2: self.plant.declared_motors().iter().copied().collect(),
            latency_us: (self.plant.latency_s() * 1e6) as u32,
        }
    }

    /// The robot's own gravity torques at the measured angles, in N m.
    fn gravity(&self) -> SVector<f64, JOINTS> {
        let q = &self.plant.sensed().q;
        self.known.bodies(&self.known.frames(q)).gravity()
    }

    /// Moves on by 1 ms with these torques, without gravity, in N m.
    fn follow(&mut self, torque: &[f64; JOINTS]) {
        let gravity = self.gravity();
        let sensed = self.plant.step(&std::array::from_fn(|j| torque[j] + gravity[j]));
        self.braked = false;
        if let Some(snapshot) = Snapshot::new(&self.known, &sensed.q, &sensed.dq) {
            let wrench = self.observer.update(&snapshot, &sensed.tau, OBSERVER_RAD_S, PERIOD_S);
            self.external = (*self.observer.residual()).into();
            let (f, m) = (wrench.force, wrench.torque);
            self.wrench = [f.x, f.y, f.z, m.x, m.y, m.z];
        }
    }

    fn brake(&mut self) {
        self.plant.step_braked();
        self.braked = true;
        self.observer.reset();
        self.external = [0.0; JOINTS];
        self.wrench = [0.0; 6];
    }

    fn dq(&self) -> [f64; JOINTS] {
        if self.braked {
            [0.0; JOINTS]
        } else {
            self.plant.sensed().dq
        }
    }
}

impl fci::ArmHardware for RobotArm {
    fn state(&self) -> fci::ArmState {
        let sensed = self.plant.sensed();
        fci::ArmState {
            q: sensed.q,
            dq: self.dq(),
            tau: sensed.tau,
            tau_external: self.external,
            wrench_external: self.wrench,
        }
    }

    fn step(&mut self, command: fci::ArmCommand) -> fci::ArmState {
        match command {
            fci::ArmCommand::Torque(torque) => self.follow(&torque),
            fci::ArmCommand::Follow(q, dq) => {
                let sensed = self.plant.sensed();
                let torque = std::array::from_fn(|j| {
                    STIFFNESS_NM_RAD[j] * (q[j] - sensed.q[j]) + DAMPING_NM_S_RAD[j] * (dq[j] - sensed.dq[j])
                });
                self.follow(&torque);
            }
            fci::ArmCommand::Guide => self.follow(&[0.0; JOINTS]),
            fci::ArmCommand::Hold | fci::ArmCommand::Brake => self.brake(),
        }
        fci::ArmHardware::state(self)
    }

    fn set_load(&mut self, load: &spherecal_fci::wire::FlangeLoad) {
        let i = &load.inertia;
        let body = Inertia {
            mass_kg: load.mass,
            com_m: load.centre_of_mass,
            inertia_kg_m2: [i[0], i[4], i[8], i[3], i[6], i[7]],
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

impl fri::ArmHardware for RobotArm {
    fn state(&self) -> fri::ArmState {
        let sensed = self.plant.sensed();
        fri::ArmState {
            q: sensed.q,
            tau: sensed.tau,
            tau_external: self.external,
        }
    }

    fn step(&mut self, command: fri::ArmCommand, step_s: f64) -> fri::ArmState {
        let ticks = (step_s / PERIOD_S).round().clamp(1.0, 100.0) as u32;
        for _ in 0..ticks {
            match command {
                fri::ArmCommand::Brake | fri::ArmCommand::Hold => self.brake(),
                fri::ArmCommand::Guide => self.follow(&[0.0; JOINTS]),
                fri::ArmCommand::Impedance { position, overlay } => {
                    let sensed = self.plant.sensed();
                    let (stiffness, damping) = self.impedance;
                    let torque = std::array::from_fn(|j| {
                        overlay[j] + stiffness * (position[j] - sensed.q[j]) - damping * sensed.dq[j]
                    });
                    self.follow(&torque);
                }
            }
        }
        fri::ArmHardware::state(self)
    }
}

#[cfg(test)]
mod tests {
    use spherecal_model::robots;

    use super::*;

    fn arm(name: &str) -> RobotArm {
        let model = robots::load(name).expect("a built-in robot");
        let q = [0.0, -0.6, 0.0, -2.2, 0.0, 1.6, 0.7];
        RobotArm::new(&model, &PlantConfig::typical(), &q, (0.0, 0.0)).expect("an arm")
    }

    // Fails if the robot does not compensate the gravity of arm and declared load: without a torque the arm must stay.
    // A load that is missing by a kilogramme must let it sink.
    #[test]
    fn the_robot_compensates_gravity_with_the_declared_load() {
        let moved = |declared_kg: Option<f64>| {
            let mut arm = arm("panda");
            let start = fci::ArmHardware::state(&arm).q;
            if let Some(mass) = declared_kg {
                let inertia = [0.0; 9];
                let centre_of_mass = arm.model.tool.body.com_m;
                let load = spherecal_fci::wire::FlangeLoad {
                    mass,
                    centre_of_mass,
                    inertia,
                };
                fci::ArmHardware::set_load(&mut arm, &load);
            }
            for _ in 0..300 {
                fci::ArmHardware::step(&mut arm, fci::ArmCommand::Torque([0.0; JOINTS]));
            }
            let end = fci::ArmHardware::state(&arm).q;
            (0..JOINTS).fold(0.0_f64, |most, j| most.max((end[j] - start[j]).abs()))
        };
        let own = moved(None);
        assert!(own < 0.02, "friction and model errors move it by {own} rad");
        assert!(
            moved(Some(8.0)) > 5.0 * own.max(0.01),
            "an undeclared change of load shows"
        );
    }

    // Fails if a braked arm moves or shows velocity, or a cabinet's period of several milliseconds is one step.
    #[test]
    fn brakes_hold_and_periods_count() {
        let mut arm = arm("iiwa7");
        let before = arm.plant.sensed().tick;
        fri::ArmHardware::step(&mut arm, fri::ArmCommand::Brake, 5e-3);
        assert_eq!(arm.plant.sensed().tick, before + 5);
        assert_eq!(arm.dq(), [0.0; JOINTS]);
        let state = fri::ArmHardware::state(&arm);
        assert_eq!(state.tau_external, [0.0; JOINTS]);
    }
}
