//! The simulated arm with a simulated operator, for hand-guiding: a drive like any other, and a
//! handle to the operator.

use std::sync::{Arc, Mutex, PoisonError};

use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState};
use spherecal_shared::robot::{Robot, Tool};

use spherecal_link::{Drive, LinkError};

use crate::plant::{Hand, Plant, PlantConfig};
use crate::simulated::{SimulatedArm, SimulatedArmError};

/// What operator and arm tell each other.
#[derive(Debug, Default)]
struct Talk {
    lead_to: Option<usize>,
    let_go: bool,
    there: bool,
}

/// Tells the simulated operator what to do; copies share the same operator.
#[derive(Clone, Debug, Default)]
pub struct OperatorCall(Arc<Mutex<Talk>>);

impl OperatorCall {
    fn talk(&self) -> std::sync::MutexGuard<'_, Talk> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Requests that the nest be led over a sphere (from 0).
    pub fn lead_to(&self, sphere: usize) {
        *self.talk() = Talk {
            lead_to: Some(sphere),
            ..Talk::default()
        };
    }

    /// Whether the operator reports that the nest is there.
    pub fn is_there(&self) -> bool {
        self.talk().there
    }

    /// Asks to let go.
    pub fn let_go(&self) {
        self.talk().let_go = true;
    }
}

struct HandGuidedArm<const N: usize> {
    arm: SimulatedArm<N>,
    hand: Hand,
    height_m: f64,
    call: OperatorCall,
}

impl<const N: usize> Drive for HandGuidedArm<N> {
    fn hello(&self) -> &DriveHello {
        self.arm.hello()
    }

    fn exchange(&mut self, command: Option<&DriveCommand>, state: &mut DriveState) -> Result<(), LinkError> {
        let period_s = f64::from(self.arm.hello().period_us) * 1e-6;
        let plant = self.arm.plant();
        let mut talk = self.call.talk();
        if let Some(sphere) = talk.lead_to.take() {
            self.hand.lead(plant, sphere, self.height_m);
        }
        if std::mem::take(&mut talk.let_go) {
            self.hand.let_go(plant);
        }
        self.hand.push(plant, period_s);
        talk.there = self.hand.is_there();
        drop(talk);
        self.arm.exchange(command, state)
    }

    fn move_plate(&mut self, place: u32) -> bool {
        self.arm.move_plate(place)
    }
}

/// A simulated arm at rest at `q` (rad) with an operator who leads the nest to `height_m` above the
/// centres of the spheres.
///
/// # Errors
/// The plant cannot be created, or this program was not built for the number of joints.
pub fn hand_guided_arm(
    robot: &Robot,
    tool: &Tool,
    config: &PlantConfig,
    q: &[f64],
    height_m: f64,
) -> Result<(Box<dyn Drive>, OperatorCall), SimulatedArmError> {
    fn build<const N: usize>(
        robot: &Robot,
        tool: &Tool,
        config: &PlantConfig,
        q: &[f64],
        height_m: f64,
        call: OperatorCall,
    ) -> Result<Box<dyn Drive>, SimulatedArmError> {
        let q: &[f64; N] = q.try_into().map_err(|_| LinkError::OtherRobot {
            drive: q.len(),
            robot: N,
        })?;
        Ok(Box::new(HandGuidedArm {
            arm: SimulatedArm::new(Plant::<N>::new(robot, tool, config, q)?, robot),
            hand: Hand::new(config),
            height_m,
            call,
        }))
    }
    let call = OperatorCall::default();
    let drive = match robot.dof() {
        6 => build::<6>(robot, tool, config, q, height_m, call.clone())?,
        7 => build::<7>(robot, tool, config, q, height_m, call.clone())?,
        joints => return Err(LinkError::Joints { joints }.into()),
    };
    Ok((drive, call))
}
