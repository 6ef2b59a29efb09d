//! The torques that hold an arm against gravity, for any number of joints.

use nalgebra::Vector3;
use spherecal_model::chain::Chain;
use spherecal_shared::robot::{GRAVITY_M_S2, Inertia, Robot, Tool};

/// Torques of the actuators that hold the arm at `q` (rad) against gravity, base to flange, in N m.
///
/// `load` is the body at the flange, in the frame of the last joint. Gravity points along −z of F0.
pub fn gravity_nm(robot: &Robot, load: &Inertia, q: &[f64]) -> Vec<f64> {
    let frames = Chain::unchecked(robot, &Tool::default()).frames(q);
    let n = robot.joints.len().min(frames.len());
    let mut torques = vec![0.0; n];
    let bodies = robot.joints.iter().map(|j| &j.link).zip(0..n);
    let last = n.checked_sub(1);
    for (body, at) in bodies.chain(last.map(|at| (load, at))) {
        let com = frames[at].point(&Vector3::from(body.com_m));
        let weight = Vector3::z() * (body.mass_kg * GRAVITY_M_S2);
        for (torque, frame) in torques.iter_mut().zip(&frames).take(at + 1) {
            *torque += frame.z().dot(&(com - frame.position).cross(&weight));
        }
    }
    torques
}
