//! The door for commands: what is carried out, and what is refused and why.
//!
//! Everything is checked here, before it reaches the control path: phase,
//! finiteness, normalisation, joint limits.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::{ApproachCommand, Command, PoseCommand, Refusal};
use spherecal_shared::robot::{Arm, Robot, Tool};

use super::{Configured, Controller};
use crate::law::Wrench;
use crate::motion::rotation_of;

use crate::phases::{Activity, Decoupling, Env, Moving, PoseTarget, Taring, Turning};

/// How far the TCP of a pose's posture may lie from where it is, in m: the tool
/// turns about the sphere.
const POSTURE_M: f64 = 0.1;
/// Trace of the rotation between a pose's posture and its orientation, which may
/// be 0.3 rad: a posture that solves another pose would pull the elbow away.
const POSTURE_TRACE: f64 = 1.0 + 2.0 * 0.955_336;

fn array<const N: usize>(values: &[f64]) -> Option<[f64; N]> {
    let values: [f64; N] = values.try_into().ok()?;
    values.iter().all(|x| x.is_finite()).then_some(values)
}

/// A unit vector; a NaN is none.
fn unit(direction: [f64; 3]) -> Option<Vector3<f64>> {
    let direction = Vector3::from(direction);
    ((direction.norm_squared() - 1.0).abs() < 1e-6).then_some(direction)
}

impl<const N: usize> Controller<N> {
    /// Carries out a command, or says why not. Acknowledgements, greetings and
    /// keep-alives are the link's business and always accepted.
    ///
    /// # Errors
    /// Why the command is not carried out; nothing has changed then.
    pub fn command(&mut self, command: Command) -> Result<(), Refusal> {
        self.host_heard();
        self.start(&command)
    }

    /// Carries out a command that was heard before: by reference, since the
    /// largest takes 2 kB and every copy of one some hundred instructions.
    pub(super) fn start(&mut self, command: &Command) -> Result<(), Refusal> {
        match command {
            Command::Hello | Command::Acknowledge { .. } | Command::KeepAlive => Ok(()),
            Command::Robot(robot) => self.accept_robot(robot),
            Command::Configure { tool, procedure } => {
                procedure.check().map_err(|_| Refusal::Procedure)?;
                self.accept_tool(tool)?;
                self.procedure = *procedure;
                Ok(())
            }
            Command::Move { target } => {
                let target = array::<N>(target).ok_or(Refusal::Target)?;
                self.idle()?;
                if !self
                    .safety
                    .reachable(&target, self.procedure.limits.position_margin_rad)
                {
                    return Err(Refusal::Target);
                }
                let start = self.hold.q;
                self.with_env(|env, _| Activity::Moving(Moving::new(start, target, env)))
            }
            Command::Approach(approach) => self.accept_approach(approach),
            Command::Pose(pose) => self.accept_pose(pose),
            Command::Decouple => {
                self.usable()?;
                // After a fault the arm is idle and may still hang on the sphere.
                let coupled = matches!(self.activity, Activity::Coupled);
                let hanging = self.touched && matches!(self.activity, Activity::Idle);
                if !(coupled || hanging) {
                    return Err(Refusal::Phase);
                }
                self.with_env(|env, cartesian| {
                    if !coupled {
                        let soft = crate::law::Stiffness::isotropic(
                            env.procedure.couple.stiffness_n_m,
                            env.procedure.law.rotation_nm_rad,
                        );
                        cartesian.engage(env.snapshot, soft);
                    }
                    Activity::Decoupling(Decoupling::new(env, cartesian))
                })
            }
            Command::Retreat { direction } => self.accept_retreat(*direction),
            Command::Stop => {
                if matches!(self.activity, Activity::Fault) {
                    return Err(Refusal::FaultPending);
                }
                if !matches!(self.activity, Activity::Idle) {
                    self.latch();
                    self.enter(Activity::Idle);
                }
                Ok(())
            }
            Command::ClearFault => {
                if matches!(self.activity, Activity::Fault) {
                    self.braked = false;
                    self.enter(Activity::Idle);
                }
                Ok(())
            }
            Command::HandGuide { on } => {
                if *on {
                    self.idle()?;
                    self.enter(Activity::HandGuiding);
                } else if matches!(self.activity, Activity::HandGuiding) {
                    self.latch();
                    self.enter(Activity::Idle);
                }
                Ok(())
            }
        }
    }

    /// Configured, no fault, and a drive state seen.
    fn usable(&self) -> Result<(), Refusal> {
        if matches!(self.activity, Activity::Fault) {
            return Err(Refusal::FaultPending);
        }
        if self.configured.is_none() {
            return Err(Refusal::NotConfigured);
        }
        if self.snapshot.is_none() {
            return Err(Refusal::Drive);
        }
        Ok(())
    }

    /// Usable, and holding.
    fn idle(&self) -> Result<(), Refusal> {
        self.usable()?;
        if matches!(self.activity, Activity::Idle) {
            Ok(())
        } else {
            Err(Refusal::Phase)
        }
    }

    /// A robot or tool may change while the arm does not move on its model.
    fn changeable(&self) -> Result<(), Refusal> {
        match self.activity {
            Activity::Fault => Err(Refusal::FaultPending),
            Activity::Idle => Ok(()),
            _ => Err(Refusal::Phase),
        }
    }

    fn accept_robot(&mut self, robot: &Robot) -> Result<(), Refusal> {
        self.changeable()?;
        robot.check().map_err(|_| Refusal::Robot)?;
        if robot.dof() != N {
            return Err(Refusal::Robot);
        }
        // The tool comes with Configure; until then the arm is not enabled.
        self.configured = None;
        self.snapshot = None;
        self.holding = false;
        self.robot = Some(robot.clone());
        Ok(())
    }

    fn accept_tool(&mut self, tool: &Tool) -> Result<(), Refusal> {
        self.changeable()?;
        let robot = self.robot.as_ref().ok_or(Refusal::NotConfigured)?;
        let arm = Arm::<f64, N>::new(robot, tool).map_err(|_| Refusal::Robot)?;
        self.safety.configure(robot);
        let limits = self.safety.limits();
        self.configured = Some(Configured {
            arm,
            torque_limits: core::array::from_fn(|i| limits[i].torque_nm),
            speeds: core::array::from_fn(|i| limits[i].velocity_rad_s * 0.8 * self.procedure.limits.velocity_share),
        });
        self.observer.reset();
        self.shaper.reset();
        self.torque_loop.reset();
        self.touched = false;
        Ok(())
    }

    fn accept_approach(&mut self, approach: &ApproachCommand) -> Result<(), Refusal> {
        let direction = unit(approach.direction).ok_or(Refusal::Target)?;
        self.idle()?;
        self.cartesian.sphere = approach.sphere;
        self.cartesian.direction = direction;
        self.cartesian.tare = Wrench::default();
        self.touched = true;
        self.enter(Activity::Taring(Taring::default()));
        Ok(())
    }

    /// Leaves a sphere that is not known to have been touched.
    fn accept_retreat(&mut self, direction: [f64; 3]) -> Result<(), Refusal> {
        let direction = unit(direction).ok_or(Refusal::Target)?;
        self.idle()?;
        self.cartesian.direction = direction;
        self.cartesian.tare = Wrench::default();
        self.touched = true;
        self.with_env(|env, cartesian| {
            let soft =
                crate::law::Stiffness::isotropic(env.procedure.couple.stiffness_n_m, env.procedure.law.rotation_nm_rad);
            cartesian.engage(env.snapshot, soft);
            Activity::Decoupling(Decoupling::new(env, cartesian))
        })
    }

    fn accept_pose(&mut self, command: &PoseCommand) -> Result<(), Refusal> {
        let rotation = rotation_of(&command.orientation).ok_or(Refusal::Target)?;
        if command.elbow_rad.is_some_and(|angle| !(angle.abs() <= 7.0)) {
            return Err(Refusal::Target);
        }
        let posture = if command.posture.is_empty() {
            None
        } else {
            let posture = array::<N>(&command.posture).ok_or(Refusal::Target)?;
            if !self
                .safety
                .reachable(&posture, self.procedure.limits.position_margin_rad)
            {
                return Err(Refusal::Target);
            }
            Some(posture)
        };
        self.usable()?;
        if !matches!(self.activity, Activity::Coupled) {
            return Err(Refusal::Phase);
        }
        if let (Some(posture), Some(configured), Some(snapshot)) = (&posture, &self.configured, &self.snapshot) {
            let there = configured.arm.tcp_frame(&configured.arm.frames(posture));
            let turned = (there.rotation.transpose() * rotation).trace();
            let away = (there.position - snapshot.tcp.position).norm_squared();
            if !(turned > POSTURE_TRACE && away < POSTURE_M * POSTURE_M) {
                return Err(Refusal::Target);
            }
        }
        let pose = PoseTarget {
            id: command.pose,
            rotation,
            elbow: command.elbow_rad,
            posture,
            record: command.record,
        };
        self.with_env(|env, cartesian| Activity::Turning(Turning::new(pose, env, cartesian)))
    }

    /// Makes a phase from the present state and enters it.
    fn with_env(
        &mut self,
        make: impl FnOnce(&Env<'_, N>, &mut crate::phases::CartesianState<N>) -> Activity<N>,
    ) -> Result<(), Refusal> {
        let (Some(snapshot), Some(configured)) = (&self.snapshot, &self.configured) else {
            return Err(Refusal::Drive);
        };
        let env = Env {
            snapshot,
            wrench: self.wrench,
            tau: &self.measured,
            joint_speed: 0.0,
            force_n: 0.0,
            procedure: &self.procedure,
            speeds: &configured.speeds,
            joints: self.safety.limits(),
            period_s: self.period_s,
            elapsed_s: 0.0,
            time_us: self.now_us,
            tick: self.tick,
        };
        let activity = make(&env, &mut self.cartesian);
        self.enter(activity);
        Ok(())
    }
}
