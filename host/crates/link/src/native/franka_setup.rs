//! What a drive tells a Franka robot before the first motion, and what it asks.

use spherecal_fci::client::{Client, ClientConfig, ClientError};
use spherecal_fci::robot::{ArmLimits as FrankaLimits, ModelError};
use spherecal_fci::wire::{CollisionBehavior, FlangeLoad, RobotMode, RobotState};
use spherecal_shared::procedure::Procedure;
use spherecal_shared::robot::{Inertia, JointLimits};

use super::{JOINTS, Undeclared};

/// Distance from the axis of joints 1 to 4, and 5 to 7, to the farthest contact, in m: it turns a threshold of the
/// force into one of the torque.
const LEVER_M: [f64; JOINTS] = [0.9, 0.9, 0.9, 0.9, 0.35, 0.35, 0.35];

/// What the drive tells the robot before the first motion.
#[derive(Clone, Debug)]
pub struct FrankaOptions {
    /// The connection.
    pub config: ClientConfig,
    /// Mass distribution of the calibration tool in the flange frame.
    pub load: Inertia,
    /// Thresholds of contact and collision, see [`collision_behavior`].
    pub thresholds: CollisionBehavior,
    /// What the handshake adds to what the robot says.
    pub undeclared: Undeclared,
}

/// Thresholds of the robot for this procedure. The robot reports a contact from the force that triggers the approach
/// (`approach.trigger_n`) on. Its reflex stands at one and a half times the force at which the controller stops the arm
/// (`limits.force_n`): the pull that releases the nest passes, and the controller reacts first.
pub fn collision_behavior(procedure: &Procedure) -> CollisionBehavior {
    let limits = FrankaLimits::PANDA.torque;
    let (contact, collision) = (procedure.approach.trigger_n, 1.5 * procedure.limits.force_n);
    let torque = |force: f64| std::array::from_fn(|j| (force * LEVER_M[j]).min(limits[j]));
    // Moments at the end effector act with the lever of the wrist.
    let force = |force: f64| {
        let moment = force * LEVER_M[JOINTS - 1];
        [force, force, force, moment, moment, moment]
    };
    CollisionBehavior::uniform(torque(contact), torque(collision), force(contact), force(collision))
}

/// Connects; clears a reflex of earlier; declares load and thresholds.
pub(super) fn open(options: &FrankaOptions) -> Result<Client, ClientError> {
    let mut client = Client::connect(&options.config)?;
    let mut state = RobotState::default();
    client.receive(&mut state)?;
    if state.robot_mode == RobotMode::Reflex {
        client.recover()?;
    }
    client.set_load(&load(&options.load))?;
    client.set_collision_behavior(&options.thresholds)?;
    Ok(client)
}

fn load(body: &Inertia) -> FlangeLoad {
    let [xx, yy, zz, xy, xz, yz] = body.inertia_kg_m2;
    FlangeLoad {
        mass: body.mass_kg,
        centre_of_mass: body.com_m,
        inertia: [xx, xy, xz, xy, yy, yz, xz, yz, zz],
    }
}

/// The limits that the robot states in its own model; `None` where the version has no model.
pub(super) fn own_limits(client: &mut Client) -> Result<Option<Result<FrankaLimits, ModelError>>, ClientError> {
    match client.robot_model() {
        Ok(model) => Ok(model.map(|text| FrankaLimits::from_urdf(&text))),
        // A robot that does not tell has the limits of its data sheet.
        Err(ClientError::Refused { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

pub(super) fn joint_limits(limits: &FrankaLimits) -> heapless::Vec<JointLimits, { spherecal_shared::MAX_JOINTS }> {
    let joint = |j: usize| JointLimits {
        min_rad: limits.lower[j],
        max_rad: limits.upper[j],
        velocity_rad_s: limits.velocity[j],
        torque_nm: limits.torque[j],
    };
    (0..JOINTS).map(joint).collect()
}
