//! A drive: seven joints, each a point inertia without gravity. What a drive must do are the thirty lines of `Arm` and
//! its `impl Drive`; the rest describes this arm.
//!
//! ```console
//! $ cargo run -p spherecal-link --example drive -- 7401
//! $ spherecal controller --drive tcp:127.0.0.1:7401 --host-link tcp:7402
//! ```
//!
//! `examples/python/point_arm.toml` describes this arm to spherecal. Replace `Arm` by your simulator or by the
//! interface of your robot.

use spherecal_link::tcp::{DriveServer, listen};
use spherecal_link::{Drive, LinkError};
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState};
use spherecal_shared::robot::JointLimits;

/// Inertia of each joint, in kg m².
pub(crate) const INERTIA: [f64; 7] = [2.0, 2.0, 1.0, 1.0, 0.3, 0.3, 0.1];
/// Viscous friction of each joint, in N m s/rad.
const DAMPING: f64 = 0.5;
/// Control period, in s.
const PERIOD_S: f64 = 1e-3;
/// Range in rad, speed in rad/s and torque in N m of each joint.
pub(crate) const LIMITS: JointLimits = JointLimits {
    min_rad: -2.9,
    max_rad: 2.9,
    velocity_rad_s: 2.0,
    torque_nm: 100.0,
};

/// The arm: what it says of itself, and its state.
pub(crate) struct Arm {
    hello: DriveHello,
    now: DriveState,
}

impl Arm {
    /// An arm at rest that waits for each command.
    pub(crate) fn new() -> Self {
        Self {
            hello: DriveHello {
                lock_step: true,
                simulated: true,
                ..DriveHello::new(1, [LIMITS; 7])
            },
            now: DriveState {
                session: 1,
                q: [0.0, 0.6, 0.0, -1.5, 0.0, 1.0, 0.0].into_iter().collect(),
                dq: [0.0; 7].into_iter().collect(),
                tau: [0.0; 7].into_iter().collect(),
                ..DriveState::default()
            },
        }
    }
}

impl Drive for Arm {
    fn hello(&self) -> &DriveHello {
        &self.hello
    }

    fn exchange(&mut self, command: Option<&DriveCommand>, state: &mut DriveState) -> Result<(), LinkError> {
        // Without a command, and with one that does not enable the drive, the brakes are closed.
        let torques = command.filter(|command| command.enable).map(|command| &command.tau);
        for (k, inertia) in INERTIA.into_iter().enumerate() {
            let torque = torques.map(|tau| tau[k].clamp(-LIMITS.torque_nm, LIMITS.torque_nm));
            self.now.tau[k] = torque.unwrap_or(0.0);
            // Semi-implicit Euler, with the damping at the end of the step.
            self.now.dq[k] = torque.map_or(0.0, |torque| {
                (self.now.dq[k] + torque / inertia * PERIOD_S) / (1.0 + DAMPING / inertia * PERIOD_S)
            });
            self.now.q[k] += self.now.dq[k] * PERIOD_S;
        }
        self.now.tick += 1;
        state.clone_from(&self.now);
        Ok(())
    }
}

fn main() -> Result<(), LinkError> {
    let port = std::env::args().nth(1).unwrap_or_else(|| "7401".to_owned());
    let (listener, address) = listen(&port)?;
    println!("drive on tcp:{address}");
    let mut server = DriveServer::new(Box::new(Arm::new()), false);
    loop {
        let service = server.serve(&listener)?;
        println!("a controller disconnected after {} commands", service.commands);
    }
}
