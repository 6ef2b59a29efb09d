//! The simulated plant as a drive.
//!
//! The only connection between plant and drive link. Only [`Sensed`](crate::plant::Sensed) passes,
//! which is what real hardware shows.

use spherecal_link::{Drive, LinkError};
use spherecal_model::TrackerSession;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState, DriveStatus};
use spherecal_shared::robot::{Robot, Tool};

use crate::plant::{Disturbance, Plant, PlantConfig, PlantError};

/// Session number of the plant: it starts once.
const SESSION: u32 = 1;

/// A drive whose arm can be disturbed, for fault injection. Only a simulated arm can.
pub trait Disturb: Drive {
    /// Lets it happen.
    fn disturb(&mut self, what: &Disturbance);
}

/// The plant behind a drive's face.
pub struct SimulatedArm<const N: usize> {
    plant: Plant<N>,
    hello: DriveHello,
    tick: u64,
    seen: bool,
    /// Whether the brakes have been open. Until then nothing moves that they would stop.
    released: bool,
}

impl<const N: usize> SimulatedArm<N> {
    /// A drive that moves `plant`, an arm with the nominal limits of `robot`.
    pub fn new(plant: Plant<N>, robot: &Robot) -> Self {
        // The data sheet of the drive.
        let motor_kg_m2 = plant.declared_motors().iter().copied().collect();
        let latency_us = (plant.latency_s() * 1e6) as u32;
        Self {
            plant,
            hello: DriveHello {
                lock_step: true,
                motor_kg_m2,
                latency_us,
                simulated: true,
                ..DriveHello::new(SESSION, robot.joints.iter().map(|joint| joint.limits))
            },
            tick: 0,
            seen: false,
            released: false,
        }
    }

    /// The plant, for code that disturbs it or reads its truth.
    pub fn plant(&mut self) -> &mut Plant<N> {
        &mut self.plant
    }
}

impl<const N: usize> Drive for SimulatedArm<N> {
    fn hello(&self) -> &DriveHello {
        &self.hello
    }

    fn exchange(&mut self, command: Option<&DriveCommand>, state: &mut DriveState) -> Result<(), LinkError> {
        let mut braked = true;
        if command.is_none() && self.seen {
            self.tick += 1;
            self.plant.step_braked();
        }
        self.seen = true;
        if let Some(command) = command {
            self.tick += 1;
            if command.enable {
                let tau: &[f64; N] = command.tau.as_slice().try_into().map_err(|_| LinkError::Torques {
                    found: command.tau.len(),
                    joints: N,
                })?;
                self.plant.step(tau);
                self.released = true;
                braked = false;
            } else if self.released {
                self.plant.step_braked();
            }
        }
        let sensed = self.plant.sensed();
        state.session = self.hello.session;
        state.tick = self.tick;
        fill(&mut state.q, &sensed.q);
        // With closed brakes the arm stands still.
        fill(&mut state.dq, if braked { &[0.0; N] } else { &sensed.dq });
        fill(&mut state.tau, &sensed.tau);
        state.status = DriveStatus::Ready;
        Ok(())
    }

    fn move_plate(&mut self, place: u32) -> bool {
        self.plant.move_plate(place)
    }
}

impl<const N: usize> Disturb for SimulatedArm<N> {
    fn disturb(&mut self, what: &Disturbance) {
        self.plant.suffer(what);
    }
}

fn fill<const N: usize>(joints: &mut spherecal_shared::Joints, values: &[f64; N]) {
    joints.clear();
    // Robots have at most as many joints as the message can carry.
    let _ = joints.extend_from_slice(values);
}

/// A simulated arm with as many joints as `robot`, at rest at `q` (rad).
///
/// # Errors
/// The plant cannot be created, or this program was not built for the number of joints.
pub fn simulated_arm(
    robot: &Robot,
    tool: &Tool,
    config: &PlantConfig,
    q: &[f64],
) -> Result<Box<dyn Disturb>, SimulatedArmError> {
    fn build<const N: usize>(
        robot: &Robot,
        tool: &Tool,
        config: &PlantConfig,
        q: &[f64],
    ) -> Result<Box<dyn Disturb>, SimulatedArmError> {
        let q: &[f64; N] = q.try_into().map_err(|_| LinkError::OtherRobot {
            drive: q.len(),
            robot: N,
        })?;
        let plant = Plant::<N>::new(robot, tool, config, q)?;
        Ok(Box::new(SimulatedArm::new(plant, robot)))
    }
    match robot.dof() {
        6 => build::<6>(robot, tool, config, q),
        7 => build::<7>(robot, tool, config, q),
        joints => Err(LinkError::Joints { joints }.into()),
    }
}

/// Why there is no simulated arm.
#[derive(Debug, thiserror::Error)]
pub enum SimulatedArmError {
    /// The plant was refused.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The drive was refused.
    #[error(transparent)]
    Link(#[from] LinkError),
}

/// A shot of a session at joint angles (rad): what the encoders show (rad), and the point (m).
type Shot = dyn FnMut(TrackerSession, &[f64]) -> Result<(Vec<f64>, [f64; 3]), LinkError> + Send;

/// The simulated tracker of an arm, in its state before the first shot.
pub struct SimulatedTracker(Box<Shot>);

impl SimulatedTracker {
    /// The tracker of the arm that is drawn from `config`.
    ///
    /// # Errors
    /// The plant cannot be created, or this program was not built for the number of joints.
    pub fn new(robot: &Robot, tool: &Tool, config: &PlantConfig) -> Result<Self, SimulatedArmError> {
        fn made<const N: usize>(
            robot: &Robot,
            tool: &Tool,
            config: &PlantConfig,
        ) -> Result<SimulatedTracker, SimulatedArmError> {
            let mut plant = Plant::<N>::new(robot, tool, config, &[0.0; N])?;
            Ok(SimulatedTracker(Box::new(move |session, q| {
                let q: &[f64; N] = q.try_into().map_err(|_| LinkError::OtherRobot {
                    drive: N,
                    robot: q.len(),
                })?;
                plant.tracker_session(session);
                let shot = plant.tracker_shot(q);
                Ok((shot.q_encoder.to_vec(), shot.point_m))
            })))
        }
        match robot.dof() {
            6 => made::<6>(robot, tool, config),
            7 => made::<7>(robot, tool, config),
            joints => Err(LinkError::Joints { joints }.into()),
        }
    }

    /// The arm stands at `q` (rad) and the tracker, set up for `session`, measures. Returns the
    /// joint angles that the encoders show, in rad, and the point in the tracker's frame, in m.
    ///
    /// # Errors
    /// The number of angles differs from the number of joints.
    pub fn shot(&mut self, session: TrackerSession, q: &[f64]) -> Result<(Vec<f64>, [f64; 3]), LinkError> {
        (self.0)(session, q)
    }
}

#[cfg(test)]
mod tests {
    use spherecal_shared::Joints;
    use spherecal_shared::robot::{iiwa7, iiwa7_tool};

    use super::*;

    // Fails if an arm with closed brakes keeps its velocity until they open again, or if its
    // sensors stop while they are closed.
    #[test]
    fn brakes_take_the_motion() {
        let home = [0.0, 0.4, 0.0, -1.5, 0.0, 1.0, 0.0];
        let plant = Plant::new(&iiwa7(), &iiwa7_tool(), &PlantConfig::typical(), &home).expect("a plant");
        let mut arm = SimulatedArm::new(plant, &iiwa7());
        let mut state = DriveState::default();
        let mut run = |arm: &mut SimulatedArm<7>, enable: bool, ticks: u64| {
            let mut seen = Vec::new();
            for tick in 0..ticks {
                let tau = Joints::from_slice(&[0.0; 7]).expect("seven of eight");
                let command = DriveCommand {
                    session: SESSION,
                    tick,
                    tau,
                    enable,
                    ..DriveCommand::default()
                };
                arm.exchange(Some(&command), &mut state).expect("a state");
                seen.push(state.q.to_vec());
            }
            seen
        };
        run(&mut arm, true, 100);
        assert!(arm.plant().truth().kinetic_j > 0.5, "it falls");
        let seen = run(&mut arm, false, 10);
        assert_eq!(arm.plant().truth().kinetic_j, 0.0);
        assert!(seen.windows(2).all(|w| w[0] != w[1]), "encoders have noise");
        run(&mut arm, true, 1);
        assert!(arm.plant().truth().kinetic_j < 1e-3, "it falls again");
    }
}
