//! A Cartesian spring that the host sets while it holds the arm.
//!
//! The rest of the spring glides to where the host wants it, so that a target may be a step or a stream.

use nalgebra::{Matrix3, Vector3, Vector6};
use spherecal_shared::protocol::host::{Fault, ImpedanceCommand};
use spherecal_shared::robot::Pose;

use super::{CartesianState, Env, Next};
use crate::law::{Stiffness, rotation_about, rotation_error};

/// Largest speed of the spring's rest, in m/s and rad/s: below the 0.25 m/s of ISO 10218-1 beside a person, and as fast
/// as the tool turns on a sphere.
const SPEED_M_S: f64 = 0.1;
const SPEED_RAD_S: f64 = 0.5;
/// Rate at which it covers what is left, in 1/s; it gains speed within half of its inverse.
const RATE_PER_S: f64 = 5.0;
/// Turn that is over, in rad/s: 0.2 µrad are left.
const OVER_RAD_S: f64 = 1e-6;

/// Moves `velocity` towards the one that covers `to_go`, within `speed`.
fn glide(velocity: &mut Vector3<f64>, to_go: &Vector3<f64>, speed: f64, period_s: f64) {
    let within = |v: Vector3<f64>, most: f64| v * (most / v.norm().max(most));
    let wanted = within(to_go * RATE_PER_S, speed);
    *velocity += within(wanted - *velocity, 2.0 * RATE_PER_S * speed * period_s);
}

/// Holds by the spring.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ImpedanceHold {
    /// Where the arm was when the hold began.
    from: Pose<f64>,
    /// Where the spring is to rest.
    position: Vector3<f64>,
    rotation: Matrix3<f64>,
    velocity: Vector3<f64>,
    angular: Vector3<f64>,
}

impl ImpedanceHold {
    /// Holds the arm where it is, with the stiffness of a checked command.
    pub(crate) fn new<const N: usize>(
        command: &ImpedanceCommand,
        env: &Env<'_, N>,
        cartesian: &mut CartesianState<N>,
    ) -> Self {
        cartesian.engage(env.snapshot, Self::stiffness(command));
        let from = env.snapshot.tcp;
        Self {
            from,
            position: from.position,
            rotation: from.rotation,
            velocity: Vector3::zeros(),
            angular: Vector3::zeros(),
        }
    }

    /// The stiffness of a command.
    pub(crate) fn stiffness(command: &ImpedanceCommand) -> Stiffness {
        Stiffness {
            translation: Matrix3::from_diagonal(&command.stiffness_n_m.into()),
            rotation: command.rotation_nm_rad,
        }
    }

    /// Sends the rest of the spring to where a checked command wants it.
    pub(crate) fn aim(&mut self, command: &ImpedanceCommand) {
        self.position = self.from.position + Vector3::from(command.offset_m);
        let turn = Vector3::from(command.turn_rad);
        // An angle that is too small for an axis turns nothing.
        let angle = turn.norm();
        self.rotation = rotation_about(&(turn / angle.max(1e-12)), angle) * self.from.rotation;
    }

    /// One tick.
    pub(crate) fn step<const N: usize>(&mut self, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Next<N> {
        let setpoint = &mut cartesian.setpoint;
        glide(
            &mut self.velocity,
            &(self.position - setpoint.position),
            SPEED_M_S,
            env.period_s,
        );
        setpoint.position += self.velocity * env.period_s;
        let to_turn = rotation_error(&self.rotation, &setpoint.rotation);
        glide(&mut self.angular, &to_turn, SPEED_RAD_S, env.period_s);
        let speed = self.angular.norm();
        if speed > OVER_RAD_S {
            let turned = rotation_about(&(self.angular / speed), speed * env.period_s);
            setpoint.rotation = turned * setpoint.rotation;
        }
        let (v, w) = (self.velocity, self.angular);
        setpoint.velocity = Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z);
        let limits = &env.procedure.limits;
        let off = (setpoint.position - env.snapshot.tcp.position).norm();
        if off > limits.path_m {
            return Next::fail(Fault::PathDeviation, off, limits.path_m);
        }
        if !cartesian.surely_within(env.snapshot, limits.turn_rad) {
            let off = cartesian.orientation_error(env.snapshot);
            if off > limits.turn_rad {
                return Next::fail(Fault::PathDeviation, off, limits.turn_rad);
            }
        }
        Next::Stay
    }
}
