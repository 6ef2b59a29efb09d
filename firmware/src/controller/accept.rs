//! Commands of the host: carries them out or refuses them.
//!
//! Everything is checked here before it reaches the control path: the phase,
//! finite numbers, normalised vectors, joint limits.

use nalgebra::Vector3;
use spherecal_shared::procedure::Limits;
use spherecal_shared::protocol::host::{ApproachCommand, Command, ImpedanceCommand, PoseCommand, Refusal};
use spherecal_shared::robot::{Arm, DrivenRobot, Tool};

use super::{Configured, Controller};
use crate::law::{Stiffness, Wrench, joint_spring};
use crate::motion::rotation_of;
use crate::safety::Pressing;

use crate::phases::{Activity, Decoupling, Departed, Env, ImpedanceHold, Moving, PoseTarget, Taring, Turning};

/// Largest distance between the TCP of a pose's posture and the present TCP, in m:
/// the tool turns about the sphere, so the TCP stays in place.
const POSTURE_M: f64 = 0.1;
/// Smallest trace of the rotation between a pose's posture and its orientation:
/// that of 0.3 rad. A posture of another pose would pull the elbow away.
const POSTURE_TRACE: f64 = 1.0 + 2.0 * 0.955_336;

fn array<const N: usize>(values: &[f64]) -> Option<[f64; N]> {
    let values: [f64; N] = values.try_into().ok()?;
    values.iter().all(|x| x.is_finite()).then_some(values)
}

/// The vector if its length is 1, which NaN has not.
fn unit(direction: [f64; 3]) -> Option<Vector3<f64>> {
    let direction = Vector3::from(direction);
    ((direction.norm_squared() - 1.0).abs() < 1e-6).then_some(direction)
}

impl<const N: usize> Controller<N> {
    /// Carries out a command at once. Handshakes, acknowledgements and keep-alives
    /// are the link's matter and always accepted.
    ///
    /// # Errors
    /// Why the command is refused. The controller is then unchanged.
    pub fn command(&mut self, command: Command) -> Result<(), Refusal> {
        self.host_heard();
        self.start(&command)
    }

    /// Carries out a command whose arrival was recorded before. The command is
    /// passed by reference: the largest takes 2 kB, and each copy would take some
    /// hundred instructions.
    pub(super) fn start(&mut self, command: &Command) -> Result<(), Refusal> {
        match command {
            Command::Hello | Command::Acknowledge { .. } | Command::KeepAlive => Ok(()),
            Command::Robot(robot) => self.accept_robot(robot),
            Command::Configure { tool, procedure } => {
                procedure.check().map_err(|_| Refusal::Procedure)?;
                self.accept_tool(tool)?;
                self.procedure = *procedure;
                self.pressing = Pressing::of(procedure.decouple);
                Ok(())
            }
            Command::Move { target } => {
                let target = array::<N>(target).ok_or(Refusal::Target)?;
                self.idle()?;
                self.answers_in_time()?;
                if !self
                    .safety
                    .reachable(&target, self.procedure.limits.position_margin_rad)
                {
                    return Err(Refusal::Target);
                }
                let start = self.hold.q;
                let external = *self.observer.residual();
                self.departed = self.snapshot.as_ref().map(|snapshot| Departed {
                    external,
                    force: snapshot.point_force(&external),
                });
                self.with_env(|env, _| Activity::Moving(Moving::new(start, target, env)))
            }
            Command::Approach(approach) => self.accept_approach(approach),
            Command::Pose(pose) => self.accept_pose(pose),
            Command::Decouple => {
                self.usable()?;
                // After a fault the arm is idle, and the nest may still be on the sphere.
                let coupled = matches!(self.activity, Activity::Coupled);
                let hanging = self.may_be_on_sphere && matches!(self.activity, Activity::Idle);
                if !(coupled || hanging) {
                    return Err(Refusal::Phase);
                }
                if !coupled {
                    self.keep_disturbance();
                }
                self.with_env(|env, cartesian| {
                    if !coupled {
                        let soft =
                            Stiffness::isotropic(env.procedure.couple.stiffness_n_m, env.procedure.law.rotation_nm_rad);
                        cartesian.engage(env.snapshot, soft);
                    }
                    Activity::Decoupling(Decoupling::new(env, cartesian))
                })
            }
            Command::Retreat { direction } => self.accept_retreat(*direction),
            Command::Impedance(spring) => self.accept_impedance(spring),
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
                    self.keep_brakes = false;
                    self.giving = None;
                    // No filter keeps anything of the states that led to the fault.
                    self.forget();
                    self.disturbance.reset();
                    self.departed = None;
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

    /// Checks that the controller is configured, without fault, and has a drive state.
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

    /// Checks that the controller is usable and idle.
    fn idle(&self) -> Result<(), Refusal> {
        self.usable()?;
        if matches!(self.activity, Activity::Idle) {
            Ok(())
        } else {
            Err(Refusal::Phase)
        }
    }

    /// Checks that robot and tool may change: no motion may depend on them.
    fn changeable(&self) -> Result<(), Refusal> {
        match self.activity {
            Activity::Fault => Err(Refusal::FaultPending),
            Activity::Idle => Ok(()),
            _ => Err(Refusal::Phase),
        }
    }

    fn accept_robot(&mut self, robot: &DrivenRobot) -> Result<(), Refusal> {
        self.changeable()?;
        robot.check().map_err(|_| Refusal::Robot)?;
        if robot.dof() != N {
            return Err(Refusal::Robot);
        }
        // The tool comes with Configure. Until then the controller has no arm.
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
        if let Some(session) = &self.session {
            session.holds(&arm)?;
        }
        let drive = self.session.as_ref().map(|session| &session.limits);
        self.safety.configure(robot, drive).map_err(|()| Refusal::Drive)?;
        self.configured = Some(Configured {
            arm,
            torque_limits: [0.0; N],
            speeds: [0.0; N],
        });
        self.set_motion_limits();
        self.take_drive();
        self.observer.reset();
        self.pressing.reset();
        self.shaper.reset();
        self.torque_loop.reset();
        self.disturbance.reset();
        self.departed = None;
        self.may_be_on_sphere = false;
        Ok(())
    }

    /// Takes over the common limits of robot and drive.
    pub(super) fn set_motion_limits(&mut self) {
        let limits = self.safety.limits();
        let share = Limits::MOTION_SHARE * self.procedure.limits.velocity_share;
        if let Some(configured) = &mut self.configured {
            configured.torque_limits = core::array::from_fn(|i| limits[i].torque_nm);
            configured.speeds = core::array::from_fn(|i| limits[i].velocity_rad_s * share);
        }
    }

    fn accept_approach(&mut self, approach: &ApproachCommand) -> Result<(), Refusal> {
        let direction = unit(approach.direction).ok_or(Refusal::Target)?;
        self.idle()?;
        self.answers_in_time()?;
        self.cartesian.sphere = approach.sphere;
        self.cartesian.direction = direction;
        self.cartesian.tare = Wrench::default();
        self.may_be_on_sphere = true;
        self.enter(Activity::Taring(Taring::default()));
        Ok(())
    }

    /// Takes over the disturbance estimate of the hold for the Cartesian spring: what is no force on the sphere.
    fn keep_disturbance(&mut self) {
        let Some(snapshot) = &self.snapshot else { return };
        let change = -snapshot.unexplained(&self.disturbance.torque()) - self.observer.known();
        let pole = self.procedure.law.observer_rad_s;
        self.observer.explain(&change, self.safety.limits(), pole);
    }

    /// Leaves a sphere that this controller does not know of.
    fn accept_retreat(&mut self, direction: [f64; 3]) -> Result<(), Refusal> {
        let direction = unit(direction).ok_or(Refusal::Target)?;
        self.idle()?;
        self.cartesian.direction = direction;
        self.cartesian.tare = Wrench::default();
        self.may_be_on_sphere = true;
        self.keep_disturbance();
        self.with_env(|env, cartesian| {
            let soft = Stiffness::isotropic(env.procedure.couple.stiffness_n_m, env.procedure.law.rotation_nm_rad);
            cartesian.engage(env.snapshot, soft);
            Activity::Decoupling(Decoupling::new(env, cartesian))
        })
    }

    /// Holds by a spring, or changes it.
    fn accept_impedance(&mut self, spring: &ImpedanceCommand) -> Result<(), Refusal> {
        spring.check().map_err(|_| Refusal::Target)?;
        if !matches!(self.activity, Activity::Impedance(_)) {
            self.idle()?;
            self.answers_in_time()?;
            self.keep_hold();
            self.cartesian.tare = Wrench::default();
            self.with_env(|env, cartesian| Activity::Impedance(ImpedanceHold::new(spring, env, cartesian)))?;
        }
        if let Activity::Impedance(hold) = &mut self.activity {
            hold.aim(spring);
            let stiffness = ImpedanceHold::stiffness(spring);
            let ramp_s = self.procedure.law.stiffness_ramp_s;
            self.cartesian.impedance.ramp_to(stiffness, ramp_s, self.period_s);
        }
        Ok(())
    }

    /// Takes over all that holds the arm against its gravity for the Cartesian spring: a soft one would give way to a wrong mass or a cable.
    fn keep_hold(&mut self) {
        let Some(snapshot) = &self.snapshot else { return };
        let spring = joint_spring(snapshot, &self.hold, self.procedure.motion.natural_rad_s, 1.0);
        let change = -(spring.torque + self.disturbance.torque()) - self.observer.known();
        let pole = self.procedure.law.observer_rad_s;
        self.observer.explain(&change, self.safety.limits(), pole);
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
        self.observer.keep();
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
            external: self.observer.residual(),
            departed: self.departed.as_ref(),
            excess: self.disturbance.excess(),
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
