//! Moments by which gravity loads the joints, computed with the nominal robot.

use nalgebra::Vector3;
use spherecal_shared::robot::kinematics::next_frame;
use spherecal_shared::robot::{GRAVITY_M_S2, LinkTransform, Pose, Robot, Tool};

use spherecal_shared::MAX_CHAIN as N;

/// Moments that hold the robot against gravity, computed with the nominal model.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct HoldingMoments {
    /// At the origin of each joint's frame, in the frame's axes, in N m; the z
    /// component is the joint torque.
    pub(crate) joint: [[f64; 3]; N],
    /// At the base, about x and y of F0, in N m.
    pub(crate) base: [f64; 2],
}

/// The nominal robot as slices, the input of the loads.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Nominal {
    links: Vec<LinkTransform<f64>>,
    bodies: Vec<(f64, Vector3<f64>)>,
    /// The description has no masses; [`ASSUMED_LINK_KG`] is used instead.
    assumed: bool,
}

/// Assumed mass of each link of a robot whose description has none, half way to the next joint.
/// Only the change of the load from pose to pose matters, because the fitted compliance absorbs its
/// size. On the real arm of `mukca_iiwa14.csv`, whose URDF has no masses, it gives nearly the same
/// result as the arm's own masses.
const ASSUMED_LINK_KG: f64 = 3.0;

impl Nominal {
    pub(crate) fn new(robot: &Robot, tool: &Tool) -> Self {
        let last = robot.dof().saturating_sub(1);
        let bodies = robot.joints.iter().enumerate().map(|(i, joint)| {
            let body = if i == last {
                joint.link.combined(&tool.body)
            } else {
                joint.link
            };
            (body.mass_kg, body.com())
        });
        let links: Vec<_> = robot.joints.iter().map(|j| LinkTransform::from(&j.mdh)).collect();
        let mut bodies: Vec<_> = bodies.collect();
        let assumed = robot.joints.iter().all(|joint| joint.link.mass_kg <= 0.0);
        if assumed {
            for (i, body) in bodies.iter_mut().enumerate() {
                let end = links.get(i + 1).map_or_else(|| tool.tcp(), |next| next.origin);
                let total = body.0 + ASSUMED_LINK_KG;
                *body = (total, (body.1 * body.0 + end * (0.5 * ASSUMED_LINK_KG)) / total);
            }
        }
        Self { links, bodies, assumed }
    }

    /// Mass (kg) and centre of mass (m, own frame) of joint `j`'s link as the loads use them.
    pub(crate) fn body(&self, j: usize) -> (f64, Vector3<f64>) {
        self.bodies.get(j).copied().unwrap_or_default()
    }

    /// Whether the masses are assumed, because the description has none.
    pub(crate) fn assumed(&self) -> bool {
        self.assumed
    }

    /// Loads at joint angles `q`; measured torques replace the joints' own.
    pub(crate) fn load(&self, q: &[f64], measured: Option<&[f64]>) -> HoldingMoments {
        let mut load = HoldingMoments::default();
        let mut frames = [Pose::identity(); N];
        let n = self.links.len().min(q.len()).min(N);
        let mut frame = Pose::identity();
        for i in 0..n {
            frame = next_frame(&frame, &self.links[i], q[i]);
            frames[i] = frame;
        }
        let mut mass = 0.0;
        let mut moment = Vector3::zeros();
        for i in (0..n).rev() {
            let (m, com) = &self.bodies[i];
            mass += m;
            moment += frames[i].point(com) * *m;
            let holding = (moment - frames[i].position * mass).cross(&Vector3::z()) * GRAVITY_M_S2;
            load.joint[i] = frames[i].rotation.tr_mul(&holding).into();
        }
        let holding = moment.cross(&Vector3::z()) * GRAVITY_M_S2;
        load.base = [holding.x, holding.y];
        for (slot, tau) in load.joint.iter_mut().zip(measured.into_iter().flatten()) {
            slot[2] = *tau;
        }
        load
    }
}
