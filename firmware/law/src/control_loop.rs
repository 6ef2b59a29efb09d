//! The loop in one piece: a state in, a torque out.
//!
//! spherecal's own controller puts the parts together itself, because its phases lie between them.

use nalgebra::SVector;
use spherecal_shared::procedure::{Law, Procedure};
use spherecal_shared::robot::{Arm, JointLimits, Pose, Robot, Tool};

use super::error::LawError;
use super::live::LiveSpring;
use super::passivity::Tank;
use super::{
    Actuation, Axes, CartesianSetpoint, EnergyLimit, FullStiffness, JointSetpoint, NullSpace, Observer, Shaped,
    Snapshot, TorqueLoop, TorqueShaper, Withheld, Wrench, joint_spring, poles,
};

/// What the arm is pulled to.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "it lives on the stack: the law allocates nothing"
)]
pub enum Goal<const N: usize> {
    /// Pose of the TCP: Cartesian impedance.
    Pose(CartesianSetpoint),
    /// Joint angles: joint impedance. Every motion has the natural frequency `natural_rad_s` (rad/s) and the damping
    /// ratio 1.
    Joints {
        /// Angles and speeds.
        setpoint: JointSetpoint<N>,
        /// Natural frequency, in rad/s.
        natural_rad_s: f64,
    },
}

/// What a cycle of the loop gives.
#[derive(Clone, Copy, Debug)]
pub struct Output<const N: usize> {
    /// Torques for the drive, in N m.
    pub torque: [f64; N],
    /// What limited them.
    pub limited: Shaped,
    /// Pose of the TCP, F0.
    pub tcp: Pose<f64>,
    /// Wrench of the environment on the arm at the TCP.
    pub wrench: Wrench,
    /// Whether the arm is near a singularity: stiffness and wrench mean less there.
    pub near_singular: bool,
    /// What the passivity guard held back.
    pub withheld: Withheld,
}

/// The law, if its numbers are possible.
fn checked(law: Law) -> Result<Law, LawError> {
    let procedure = Procedure {
        law,
        ..Procedure::default()
    };
    procedure.check()?;
    Ok(law)
}

/// An impedance loop of `N` joints.
///
/// It holds the arm where the first state finds it. Goal, null space, stiffness and law may change between any two
/// cycles; nothing jumps, because stiffness and torques keep their rates.
#[derive(Clone, Debug)]
pub struct ImpedanceLoop<const N: usize> {
    /// What the arm is pulled to; none: where the next state finds it.
    pub goal: Option<Goal<N>>,
    /// Null space of a Cartesian goal; none: as the next state finds it.
    pub null_space: Option<NullSpace<N>>,
    law: Law,
    arm: Arm<f64, N>,
    limits: [JointLimits; N],
    drive: Actuation<N>,
    gravity_by_drive: bool,
    period_s: f64,
    spring: LiveSpring,
    observer: Observer<N>,
    torque_loop: TorqueLoop<N>,
    shaper: TorqueShaper<N>,
}

impl<const N: usize> ImpedanceLoop<N> {
    /// A loop that is called once in `period_s` (s) for an arm with a tool. `gravity_by_drive`: the drive adds the torque
    /// of gravity itself.
    ///
    /// # Errors
    /// [`LawError::Robot`] and [`LawError::Law`].
    pub fn new<const MOST: usize>(
        robot: &Robot<MOST>,
        tool: &Tool,
        law: Law,
        drive: Actuation<N>,
        gravity_by_drive: bool,
        period_s: f64,
    ) -> Result<Self, LawError> {
        let law = checked(law)?;
        let arm = Arm::new(robot, tool)?;
        Ok(Self {
            goal: None,
            null_space: None,
            law,
            arm,
            // The arm has been made of as many joints.
            limits: core::array::from_fn(|i| robot.joints[i].limits),
            drive,
            gravity_by_drive,
            period_s,
            spring: LiveSpring::default(),
            observer: Observer::default(),
            torque_loop: TorqueLoop::default(),
            shaper: TorqueShaper::default(),
        })
    }

    /// Ramps to a Cartesian stiffness in the axes of the base or the tool within [`Law::stiffness_ramp_s`], from the present one. It
    /// is 0 at the beginning.
    ///
    /// # Errors
    /// [`LawError::Stiffness`]; the stiffness stays as it is then.
    pub fn set_stiffness(&mut self, stiffness: impl Into<FullStiffness>, axes: Axes) -> Result<(), LawError> {
        let stiffness = stiffness.into();
        stiffness.check()?;
        let rate = (self.period_s / self.law.stiffness_ramp_s.max(self.period_s)).min(1.0);
        self.spring.ramp_to(stiffness, axes, rate);
        Ok(())
    }

    /// Takes another law from the next cycle on.
    ///
    /// # Errors
    /// [`LawError::Law`]; the law stays as it is then.
    pub fn set_law(&mut self, law: Law) -> Result<(), LawError> {
        self.law = checked(law)?;
        Ok(())
    }

    /// Bounds the energy that changes of a Cartesian goal and its stiffness give, by a full tank; `None` ends this. A goal of joints
    /// and the null space are not bounded.
    ///
    /// # Errors
    /// [`LawError::Energy`]; the guard stays as it is then.
    pub fn set_energy_limit(&mut self, limit: Option<EnergyLimit>) -> Result<(), LawError> {
        self.spring.tank = limit.map(Tank::new).transpose()?;
        Ok(())
    }

    /// Energy in the tank, in J; `None` without a guard.
    pub fn tank_j(&self) -> Option<f64> {
        self.spring.tank.as_ref().map(Tank::energy_j)
    }

    /// Starts anew: from the next state on the arm is held where it is, with the stiffness as it is.
    pub fn reset(&mut self) {
        (self.goal, self.null_space) = (None, None);
        self.spring.forget();
        self.observer.reset();
        self.torque_loop.reset();
        self.shaper.reset();
    }

    /// One cycle: joint angles `q` (rad), speeds `dq` (rad/s) and the torques `tau` (N m) that the actuators exert on
    /// their links, with gravity.
    ///
    /// `None` for a state with a number that is not finite; it changes nothing. The drive may get its last torque again
    /// for a few cycles, then the brakes.
    pub fn step(&mut self, q: &[f64; N], dq: &[f64; N], tau: &[f64; N]) -> Option<Output<N>> {
        if !q.iter().chain(dq).chain(tau).all(|x| x.is_finite()) {
            return None;
        }
        let snapshot = Snapshot::on(&self.drive, &self.arm, q, dq)?;
        let law = &self.law;
        let wrench = self.observer.update(&snapshot, tau, law.observer_rad_s, self.period_s);
        let at_rest = || Goal::Pose(CartesianSetpoint::at(snapshot.tcp.position, snapshot.tcp.rotation));
        let mut withheld = Withheld::Nothing;
        let mut wanted = match self.goal.get_or_insert_with(at_rest) {
            Goal::Pose(setpoint) => {
                let (force, held) = self.spring.force(&snapshot, setpoint, law.damping_ratio, self.period_s);
                withheld = held;
                let null_space = self.null_space.get_or_insert_with(|| NullSpace::at(&snapshot));
                let ratio = law.elbow_damping_ratio;
                snapshot.joint_torque(&force) + null_space.torque(&snapshot, &self.limits, law.elbow_nm_rad, ratio)
            }
            Goal::Joints {
                setpoint,
                natural_rad_s,
            } => {
                self.spring.forget();
                joint_spring(&snapshot, setpoint, *natural_rad_s, 1.0).torque
            }
        };
        wanted += snapshot.coriolis;
        let (mut delivered, mut limits) = (SVector::from(*tau), self.limits.map(|limits| limits.torque_nm));
        if self.gravity_by_drive {
            delivered -= snapshot.gravity;
            limits = core::array::from_fn(|i| (limits[i] - snapshot.gravity[i].abs()).max(0.0));
        } else {
            wanted += snapshot.gravity;
        }
        let delivered = delivered.into();
        let motors = &self.drive.motors;
        let exerted = self.torque_loop.exerted(&delivered, dq, motors, self.period_s);
        let poles = poles(motors, law.torque_loop_gain, law.torque_loop_rad_s);
        wanted += SVector::from(*self.torque_loop.correction(
            &exerted,
            law.torque_loop_gain,
            &poles,
            law.torque_loop_nm,
            self.period_s,
        ));
        let share = self.period_s / (self.period_s + self.drive.smoothing_s);
        let step = law.torque_rate_nm_s * self.period_s;
        let (torque, limited) = self.shaper.shape(&wanted, &delivered, &limits, step, share);
        self.torque_loop.sent(&torque);
        Some(Output {
            torque,
            limited,
            tcp: snapshot.tcp,
            wrench,
            near_singular: snapshot.near_singular,
            withheld,
        })
    }
}
