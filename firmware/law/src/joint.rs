//! The joint spring-damper: for motions in free space and for every hold.

use nalgebra::SVector;
use spherecal_shared::scalar::sqrt;

use super::snapshot::Snapshot;

/// Smallest stiffness of every joint, in N m/rad, so that light wrist joints hold
/// against friction.
const LEAST_STIFFNESS: f64 = 40.0;

/// Setpoint of the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSetpoint<const N: usize> {
    /// Angles, in rad.
    pub q: [f64; N],
    /// Velocities, in rad/s.
    pub dq: [f64; N],
}

/// The joint spring at one tick.
#[derive(Clone, Copy, Debug)]
pub struct JointSpring<const N: usize> {
    /// Torque of spring and damper without gravity and Coriolis torque, in N m.
    pub torque: SVector<f64, N>,
    /// Errors of the joints, in rad.
    pub error: SVector<f64, N>,
    /// Stiffness against the error of each joint alone, in N m/rad.
    pub stiffness: [f64; N],
}

/// The joint spring-damper.
///
/// The stiffness is the mass matrix times `natural_rad_s` squared. Every motion of
/// the arm then has that natural frequency and Lehr's damping `ratio`. A spring for
/// each joint alone would not do: where two axes align (joints 1 and 3 of an
/// upright arm), the joints can turn against each other with almost no inertia, and
/// springs made for the inertia of the whole arm become unstable. The smallest
/// stiffness is added; its damping follows from the inertia that a joint moves
/// when the others are free, `1 / (M⁻¹)ᵢᵢ`. On a drive that answers late both are
/// smaller ([`Actuation::joint_rad_s`](super::Actuation::joint_rad_s)); the first spring
/// then damps the joint as well.
#[inline]
pub fn joint_spring<const N: usize>(
    snapshot: &Snapshot<N>,
    setpoint: &JointSetpoint<N>,
    natural_rad_s: f64,
    ratio: f64,
) -> JointSpring<N> {
    let error = SVector::<f64, N>::from_fn(|i, _| setpoint.q[i] - snapshot.q[i]);
    let rate = SVector::<f64, N>::from_fn(|i, _| setpoint.dq[i] - snapshot.dq[i]);
    let natural_rad_s = natural_rad_s.min(snapshot.fastest_rad_s);
    let wanted = error * (natural_rad_s * natural_rad_s) + rate * (2.0 * ratio * natural_rad_s);
    let mut torque = snapshot.mass.multiply(&wanted);
    let mut stiffnesses = [0.0; N];
    for i in 0..N {
        let alone = SVector::<f64, N>::from_fn(|k, _| if k == i { 1.0 } else { 0.0 });
        let mobility = snapshot.mass.solve_lower(&alone).norm_squared();
        let stiffness = LEAST_STIFFNESS.min(snapshot.joint_rad_s * snapshot.joint_rad_s / mobility);
        let damping = (2.0 * ratio * sqrt(stiffness / mobility)).min(snapshot.joint_rad_s / mobility);
        torque[i] += stiffness * error[i] + damping * rate[i];
        stiffnesses[i] = natural_rad_s * natural_rad_s * snapshot.inertia[i] + stiffness;
    }
    JointSpring {
        torque,
        error,
        stiffness: stiffnesses,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Actuation, TorqueLoop, poles};
    use nalgebra::SMatrix;
    use spherecal_shared::procedure::Procedure;
    use spherecal_shared::robot::{Arm, BUILT_IN, JointLimits, built_in, iiwa7_tool};
    use std::vec::Vec;

    const PERIOD_S: f64 = 1e-3;

    /// The joint spring about a posture, linearised.
    struct Loop<const N: usize> {
        stiffness: SMatrix<f64, N, N>,
        damping: SMatrix<f64, N, N>,
        mobility: SMatrix<f64, N, N>,
    }

    impl<const N: usize> Loop<N> {
        fn at(arm: &Arm<f64, N>, drive: &Actuation<N>, q: &[f64; N]) -> Self {
            let natural_rad_s = Procedure::default().motion.natural_rad_s;
            let snapshot = Snapshot::on(drive, arm, q, &[0.0; N]).expect("a mass matrix");
            let mut this = Self {
                stiffness: SMatrix::zeros(),
                damping: SMatrix::zeros(),
                mobility: SMatrix::zeros(),
            };
            for i in 0..N {
                let mut off = JointSetpoint { q: *q, dq: [0.0; N] };
                off.q[i] += 1.0;
                this.stiffness
                    .set_column(i, &joint_spring(&snapshot, &off, natural_rad_s, 1.0).torque);
                let mut moving = JointSetpoint { q: *q, dq: [0.0; N] };
                moving.dq[i] = 1.0;
                this.damping
                    .set_column(i, &joint_spring(&snapshot, &moving, natural_rad_s, 1.0).torque);
                let alone = SVector::<f64, N>::from_fn(|k, _| if k == i { 1.0 } else { 0.0 });
                this.mobility.set_column(i, &snapshot.mass.solve(&alone));
            }
            this
        }

        /// Whether the sampled loop with the torque loop comes to rest, if commands act
        /// `delay_s` after their states and springs and dampers are `gain` times as large.
        fn is_stable(&self, motors: &[f64; N], delay_s: f64, gain: f64) -> bool {
            let law = Procedure::default().law;
            let poles = poles(motors, law.torque_loop_gain, law.torque_loop_rad_s);
            let (whole, part) = ((delay_s / PERIOD_S) as usize, delay_s / PERIOD_S % 1.0);
            let mut sent = std::vec![SVector::<f64, N>::zeros(); whole + 2];
            let acts = |sent: &[SVector<f64, N>]| {
                let newest = sent.len() - 1 - whole;
                sent[newest - 1] * part + sent[newest] * (1.0 - part)
            };
            let mut feedback = TorqueLoop::<N>::default();
            let mut q = SVector::<f64, N>::from_fn(|i, _| libm::sin(3.0 * i as f64 + 1.0));
            let mut dq = SVector::<f64, N>::zeros();
            let mut sizes = Vec::new();
            for _ in 0..900 {
                let measured = acts(&sent).into();
                let correction = feedback.correction(&measured, law.torque_loop_gain, &poles, 1e300, PERIOD_S);
                let torque = SVector::from(*correction) - (self.stiffness * q + self.damping * dq) * gain;
                feedback.sent(&torque.into());
                sent.push(torque);
                let acceleration = self.mobility * acts(&sent);
                q += dq * PERIOD_S + acceleration * (0.5 * PERIOD_S * PERIOD_S);
                dq += acceleration * PERIOD_S;
                sizes.push(q.norm() + 0.02 * dq.norm());
                if sizes.last().is_none_or(|size| !(*size < 1e9)) {
                    return false;
                }
            }
            let most = |from: usize| {
                sizes[from..from + 200]
                    .iter()
                    .fold(0.0f64, |most, size| most.max(*size))
            };
            most(700) < most(400)
        }
    }

    /// Postures all over the range of the joints. Of some the axes of several joints align.
    fn postures<const N: usize>(limits: [JointLimits; N]) -> impl Iterator<Item = [f64; N]> {
        (0..300u32).map(move |k| {
            core::array::from_fn(|i| {
                let (low, high) = (limits[i].min_rad, limits[i].max_rad);
                if i % 2 == 1 && k % (1 << (i / 2 + 2)) == 0 {
                    return low.max(0.0).min(high);
                }
                let random = libm::sin(f64::from(k) * (1.0 + 0.7371 * i as f64) * 12.9898) * 43_758.545;
                low + (random - libm::floor(random)) * (high - low)
            })
        })
    }

    /// Checks the joint spring of an arm in all postures on a drive that answers late.
    fn keeps_its_margin<const N: usize>(name: &str, latency_s: f64) {
        let robot = built_in(name).expect("a built-in robot");
        let arm = Arm::<f64, N>::new(&robot, &iiwa7_tool()).expect("an arm");
        let drive = Actuation::new([0.0; N], PERIOD_S, latency_s);
        // Holding a torque for a period is half a period of delay.
        let later_s = (latency_s + 0.5 * PERIOD_S) * 1.3 - 0.5 * PERIOD_S;
        for q in postures(core::array::from_fn(|i| robot.joints[i].limits)) {
            let closed = Loop::at(&arm, &drive, &q);
            let stable = closed.is_stable(&drive.motors, later_s, 1.0);
            assert!(stable, "{name}: 1.3 times {latency_s} s of delay at {q:?}");
            let stable = closed.is_stable(&drive.motors, latency_s, 1.5);
            assert!(
                stable,
                "{name}: 1.5 times the gain with {latency_s} s of delay at {q:?}"
            );
        }
    }

    // Fails if the joint spring of a free motion or of a hold oscillates on a built-in
    // arm whose drive answers late, with 1.3 times the delay or 1.5 times the gain:
    // where axes align, several springs add up.
    #[test]
    fn a_late_drive_leaves_the_joint_spring_its_margin() {
        for name in BUILT_IN {
            let dof = built_in(name).expect("a built-in robot").dof();
            for latency_ms in 0..6 {
                let latency_s = 1e-3 * f64::from(latency_ms);
                match dof {
                    7 => keeps_its_margin::<7>(name, latency_s),
                    _ => keeps_its_margin::<6>(name, latency_s),
                }
            }
        }
    }

    // Fails if the bound for late drives weakens the joints of a drive that answers at
    // once: there the light wrist of the built-in arm keeps its spring and its damping.
    #[test]
    fn a_prompt_drive_keeps_the_whole_spring() {
        let arm = Arm::<f64, 7>::new(&built_in("iiwa7").expect("a built-in robot"), &iiwa7_tool()).expect("an arm");
        let q = crate::testing::HOME;
        let closed = Loop::at(&arm, &Actuation::default(), &q);
        let snapshot = Snapshot::new(&arm, &q, &[0.0; 7]).expect("a mass matrix");
        let tip = SVector::<f64, 7>::from_fn(|i, _| if i == 6 { 1.0 } else { 0.0 });
        let mobility = snapshot.mass.solve_lower(&tip).norm_squared();
        let of_mass = snapshot.mass.multiply(&tip)[6];
        assert!((closed.stiffness[(6, 6)] - (400.0 * of_mass + LEAST_STIFFNESS)).abs() < 1e-9);
        let damping = 2.0 * sqrt(LEAST_STIFFNESS / mobility);
        assert!((closed.damping[(6, 6)] - (40.0 * of_mass + damping)).abs() < 1e-9);
    }
}
