//! The mass with which an arm meets a sphere.
//!
//! The controller holds the tool's orientation in an approach. What a sphere stops is then the translational part of
//! `(J M^-1 J')^-1`: a few kilograms in most postures, and many times as much where the arm is folded or stretched, because a
//! small step of the tool then needs large turns of heavy links.
//!
//! Along the approach the magnet draws the nest on: its work, pull times [`MAGNET_REACH_M`], adds to the energy of the approach.
//! A sphere stops the momentum of both within [`STOP_S`]. A rim may meet a sphere from any side, without the magnet's work, and
//! stops within [`RIM_S`]. Either force has to stay within the limit of the fault `force`.

use nalgebra::{Cholesky, Matrix3, SMatrix, Vector3};
use spherecal_shared::procedure::Procedure;
use spherecal_shared::robot::{Arm, Dynamics, Robot, Tool};

use super::path::Obstacle;

/// Work of a magnet over its pull on a seated sphere, in m: the pull falls to a quarter within 1 mm (assumed, as in the simulated nest).
const MAGNET_REACH_M: f64 = 0.001;
/// Time within which a sphere stops the tool along the approach, in s. With it the paper's magnet and 100 N allow 24.7 kg: simulated
/// UR20 that met spheres with 30 to 51 kg pressed with 110 to 203 N, where this says 113 to 160.
const STOP_S: f64 = 0.013;
/// Time within which a sphere stops a rim, in s.
const RIM_S: f64 = 0.010;
/// Speed of a rim at the contact, as a multiple of that of the approach.
const DRAWN_ON: f64 = 1.2;

/// What an arm may do to a sphere as it meets it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Force of the fault `force`, in N.
    pub limit_n: f64,
    /// Speed of the approach, in m/s.
    pub speed_m_s: f64,
    /// Pull of the magnet on a seated sphere, in N.
    pub magnet_n: f64,
}

impl From<&Procedure> for Contact {
    fn from(procedure: &Procedure) -> Self {
        Self {
            limit_n: procedure.limits.force_n,
            speed_m_s: procedure.approach.speed_m_s,
            magnet_n: procedure.decouple.magnet_n,
        }
    }
}

impl Contact {
    /// Largest mass along the approach, in kg: `(m v)² + 2 m W = p²` with the magnet's work `W` and the largest momentum `p`.
    fn most_along_kg(&self) -> f64 {
        let (work, most) = (self.magnet_n * MAGNET_REACH_M, self.limit_n * STOP_S);
        let square = self.speed_m_s * self.speed_m_s;
        // The root without cancellation; a speed of 0 is allowed.
        most * most / (work + (work * work + square * most * most).sqrt())
    }

    /// Largest mass in any direction, in kg.
    fn most_any_kg(&self) -> f64 {
        self.limit_n * RIM_S / (DRAWN_ON * self.speed_m_s)
    }
}

/// Checks that an arm at joint angles `q` (rad) meets a sphere along the unit direction of F0, and from any side, with no more mass
/// than the contact allows. Of an arm that no controller drives, or whose masses are not known, nothing is checked.
/// Errors: [`Obstacle::Heavy`].
pub(super) fn check(
    robot: &Robot,
    tool: &Tool,
    contact: &Contact,
    q: &[f64],
    direction: &Vector3<f64>,
) -> Result<(), Obstacle> {
    let masses = match q.len() {
        6 => masses::<6>(robot, tool, q),
        7 => masses::<7>(robot, tool, q),
        _ => None,
    };
    let Some(masses) = masses else {
        return Ok(());
    };
    let along = (direction.dot(&(masses * direction)), contact.most_along_kg());
    let any = (masses.symmetric_eigenvalues().max(), contact.most_any_kg());
    for (kg, most_kg) in [along, any] {
        if kg > most_kg {
            return Err(Obstacle::Heavy { kg, most_kg });
        }
    }
    Ok(())
}

/// Masses that the tool shows at joint angles (rad) in each direction of F0 while its orientation is held, in kg: `d' m d` along a
/// unit direction `d`.
fn masses<const N: usize>(robot: &Robot, tool: &Tool, q: &[f64]) -> Option<Matrix3<f64>> {
    let arm = Arm::<f64, N>::new(robot, tool).ok()?;
    let frames = arm.frames(q.try_into().ok()?);
    let jacobian: SMatrix<f64, 6, N> = arm.jacobian(&frames, &arm.tcp_frame(&frames).position);
    let mut mass = arm.bodies(&frames).mass_matrix();
    arm.add_rotors(&mut mass);
    let mobility = jacobian * Cholesky::new(mass)?.solve(&jacobian.transpose());
    Some(mobility.try_inverse()?.fixed_view::<3, 3>(0, 0).into_owned())
}

#[cfg(test)]
#[path = "contact_mass_tests.rs"]
mod tests;
