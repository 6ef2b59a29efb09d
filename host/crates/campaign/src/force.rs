//! How well the joint torques tell the wrench at the TCP.
//!
//! The controller estimates the wrench from the joint torques, `tau = J' F`. Where the arm is near a singular posture some
//! direction of `F` hardly moves a torque, so a small error of a torque sensor is a large force: 92 to 186 N were seen in
//! free motions. If the torques err by the standard deviations `s`, no unbiased estimate of the wrench has a smaller
//! covariance than `(J diag(s)^-2 J')^-1` (Gauss and Markov).
//!
//! The errors are those that the controller allows for, 1.5 % of each joint's largest torque. A tare takes out what stays
//! the same, so near a contact the estimate is better than stated.

use nalgebra::{Matrix3, Matrix6};
use spherecal_model::chain::Chain;
use spherecal_shared::protocol::host::Sample;
use spherecal_shared::robot::{Robot, Tool};

/// Force at which the controller's guard stops a free motion, in N. A smaller force alarms nobody.
const VAGUE_N: f64 = 15.0;
/// Largest standard uncertainty that is stated, in N or N m: at a singular posture there is none.
const MOST: f64 = 1e4;

/// Standard uncertainties of an estimated wrench, along the axes of F0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrenchError {
    /// Of the force, in N.
    pub force_n: [f32; 3],
    /// Of the torque, in N m.
    pub torque_nm: [f32; 3],
    /// Of the force in the direction that is known least, in N.
    pub worst_n: f64,
}

/// An arm and the errors of its torque sensors.
#[derive(Clone, Debug)]
pub struct ForceSense {
    chain: Chain,
    /// For each joint, 1/(N m)².
    weights: Vec<f64>,
}

impl ForceSense {
    /// The torque sensors of `robot`, with `tool` in the last frame of its table.
    pub fn new(robot: &Robot, tool: &Tool) -> Self {
        let chain = Chain::unchecked(robot, tool);
        let weights = chain.limits().iter().map(|limits| limits.sensor_error_nm().powi(-2));
        Self {
            weights: weights.collect(),
            chain,
        }
    }

    /// How well the torques tell the wrench of a sample.
    pub fn error(&self, sample: &Sample) -> WrenchError {
        let q: Vec<f64> = sample
            .q
            .iter()
            .take(self.weights.len())
            .map(|q| f64::from(*q))
            .collect();
        let jacobian = self.chain.tcp_jacobian(&q);
        let mut information = Matrix6::zeros();
        for (k, weight) in self.weights.iter().enumerate() {
            let column = jacobian.column(k);
            information += column * column.transpose() * *weight;
        }
        let covariance = information.cholesky().map(|factor| factor.inverse());
        let root = |variance: f64| if variance < MOST * MOST { variance.sqrt() } else { MOST };
        let of = |k: usize| root(covariance.map_or(f64::INFINITY, |c| c[(k, k)]));
        let worst = covariance.map_or(f64::INFINITY, |c| {
            let force: Matrix3<f64> = c.fixed_view::<3, 3>(0, 0).into();
            force.symmetric_eigenvalues().max()
        });
        WrenchError {
            force_n: [0, 1, 2].map(|k| of(k) as f32),
            torque_nm: [3, 4, 5].map(|k| of(k) as f32),
            worst_n: root(worst),
        }
    }

    /// Whether the force of a sample says nothing: it is large, and the errors of the sensors alone explain it.
    pub fn is_vague(&self, sample: &Sample) -> bool {
        let force_n = magnitude(sample);
        force_n > VAGUE_N && force_n < self.error(sample).worst_n
    }
}

/// Magnitude of a sample's force, in N.
pub(crate) fn magnitude(sample: &Sample) -> f64 {
    sample.force_n.iter().map(|f| f64::from(*f).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use nalgebra::{Cholesky, SMatrix, SVector};
    use proptest::prelude::*;
    use spherecal_shared::robot::{iiwa7, iiwa7_tool};

    use super::*;

    fn sample(q: [f64; 7]) -> Sample {
        let mut sample = Sample::default();
        for (slot, q) in sample.q.iter_mut().zip(q) {
            *slot = q as f32;
        }
        sample
    }

    proptest! {
        // Fails if the stated covariance is not that of weighted least squares, by differences of positions and another
        // way to solve it.
        #[test]
        fn errors_of_torques_become_errors_of_forces(q in prop::array::uniform7(-1.5f64..1.5)) {
            prop_assume!(q[3].abs() > 0.3 && q[5].abs() > 0.3);
            let (robot, tool) = (iiwa7(), iiwa7_tool());
            let chain = Chain::unchecked(&robot, &tool);
            let sample = sample(q);
            let q: Vec<f64> = sample.q.iter().take(7).map(|q| f64::from(*q)).collect();
            // The rows of the regression: torque of each joint, in units of its error, by force and torque at the TCP.
            let mut rows = SMatrix::<f64, 7, 6>::zeros();
            for k in 0..7 {
                let turned = |by: f64| {
                    let mut q = q.clone();
                    q[k] += by;
                    chain.pose(&q)
                };
                let (ahead, behind) = (turned(1e-5), turned(-1e-5));
                let speed = (ahead.position - behind.position) / 2e-5;
                let turn = (ahead.rotation * behind.rotation.inverse()).scaled_axis() / 2e-5;
                let error = 0.015 * robot.joints[k].limits.torque_nm;
                for i in 0..3 {
                    rows[(k, i)] = speed[i] / error;
                    rows[(k, 3 + i)] = turn[i] / error;
                }
            }
            let factor = Cholesky::new(rows.transpose() * rows).expect("regular");
            let said = ForceSense::new(&robot, &tool).error(&sample);
            let mut sum = 0.0;
            for i in 0..3 {
                for (k, said) in [(i, said.force_n[i]), (3 + i, said.torque_nm[i])] {
                    let unit = SVector::<f64, 6>::from_fn(|j, _| f64::from(u8::from(j == k)));
                    let expected = factor.solve(&unit)[k].sqrt();
                    prop_assert!((f64::from(said) / expected - 1.0).abs() < 1e-3, "{k}: {said}, {expected}");
                }
                sum += f64::from(said.force_n[i]).powi(2);
            }
            prop_assert!(said.worst_n <= sum.sqrt() * 1.001 && said.worst_n >= (sum / 3.0).sqrt() * 0.999);
        }
    }

    // Fails if the 92 to 186 N that were seen in free motions near singular postures are taken for forces, or if a push of
    // 30 N in a good posture is not.
    #[test]
    fn forces_near_singular_postures_are_vague() {
        let sense = ForceSense::new(&iiwa7(), &iiwa7_tool());
        let with = |q: [f64; 7], force: f32| Sample {
            force_n: [0.0, force, 0.0],
            ..sample(q)
        };
        let good = [0.0, 0.7, 0.0, -1.2, 0.0, 1.24, 0.0];
        // The wrist in line, the shoulder in line, the arm stretched; nearly so.
        for q in [
            [0.0, 0.7, 0.0, -1.2, 1.57, 0.02, 0.0],
            [0.0, 0.02, 1.57, -1.2, 0.0, 1.24, 0.0],
            [0.3, 0.7, 0.2, -0.02, 0.1, 1.2, 0.0],
        ] {
            assert!(sense.is_vague(&with(q, 186.0)), "{:?}", sense.error(&sample(q)));
        }
        assert!(!sense.is_vague(&with(good, 30.0)));
        assert!(sense.error(&sample(good)).worst_n < VAGUE_N);
        let stretched = sense.error(&sample([0.0; 7]));
        assert!(stretched.worst_n <= MOST && stretched.force_n.iter().all(|f| f.is_finite()));
        let nothing = sense.error(&sample([f64::NAN; 7]));
        assert!((nothing.worst_n - MOST).abs() < 1.0, "{nothing:?}");
    }
}
