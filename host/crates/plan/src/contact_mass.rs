//! The mass with which an arm meets a sphere.
//!
//! The controller holds the tool's orientation in an approach. What a sphere stops is then the translational part of
//! `(J M^-1 J')^-1`: a few kilograms in most postures, and many times as much where the arm is folded or stretched, because a
//! small step of the tool then needs large turns of heavy links.
//!
//! Within 10 ms a sphere stops a mass `m` of the speed `v` with `m v / 10 ms`. This has to stay within the limit of the fault
//! `force`, together with the magnet's pull along the approach. A rim may meet a sphere from any side.

use nalgebra::{Cholesky, Matrix3, SMatrix, Vector3};
use spherecal_shared::procedure::{Approach, Limits};
use spherecal_shared::robot::{Arm, Dynamics, Robot, Tool};

use super::path::Obstacle;

/// Pull of the magnet, in N.
const MAGNET_N: f64 = 26.5;
/// Time within which a sphere stops the tool, in s.
const STOP_S: f64 = 0.010;
/// Speed at the contact, as a multiple of that of the approach: the magnet draws the arm on.
const DRAWN_ON: f64 = 1.2;

/// Checks that an arm at joint angles `q` (rad) meets a sphere along the unit direction of F0 with at most 24.5 kg, and with at most
/// 33 kg from any side. A simulated UR20 that met spheres with 30 to 51 kg pressed with 110 to 203 N. Of an arm that no controller
/// drives, or whose masses are not known, nothing is checked.
///
/// # Errors
/// [`Obstacle::Heavy`].
pub(super) fn check(robot: &Robot, tool: &Tool, q: &[f64], direction: &Vector3<f64>) -> Result<(), Obstacle> {
    let masses = match q.len() {
        6 => masses::<6>(robot, tool, q),
        7 => masses::<7>(robot, tool, q),
        _ => None,
    };
    let Some(masses) = masses else {
        return Ok(());
    };
    let (limit_n, speed_m_s) = (Limits::default().force_n, DRAWN_ON * Approach::default().speed_m_s);
    let most = |force: f64| force * STOP_S / speed_m_s;
    let along = (direction.dot(&(masses * direction)), most(limit_n - MAGNET_N));
    let any = (masses.symmetric_eigenvalues().max(), most(limit_n));
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
