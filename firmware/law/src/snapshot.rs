//! Kinematics and dynamics of the arm at one tick, computed once.

use nalgebra::{Matrix3, Matrix6, SMatrix, SVector, Vector3, Vector6};
use spherecal_shared::linalg::Cholesky;
use spherecal_shared::robot::{Arm, Dynamics, Pose};
use spherecal_shared::scalar::sqrt;

use super::Actuation;

/// Smallest pivot of the mobility `J M⁻¹ Jᵀ` in task space, in 1/kg and
/// 1/(kg m²). It bounds the task-space inertia near singularities to 100 kg and
/// 100 kg m².
const MOBILITY_FLOOR: f64 = 0.01;

/// Largest force that the law adds for the inertia of a turning tool, in N: twice what was needed on the
/// built-in arm with visible motors.
const MOST_REACTION_N: f64 = 40.0;

/// Damping of [`Snapshot::point_force`], in m²: the square of the ratio of a torque
/// error to the force error that it may cause (3 N m and 30 N).
const POINT_FORCE_DAMPING: f64 = 0.01;

/// The arm at one tick. All vectors are in F0. Task-space vectors are at the TCP,
/// with the linear part first.
#[derive(Clone, Debug)]
pub struct Snapshot<const N: usize> {
    /// Joint angles, in rad.
    pub q: [f64; N],
    /// Joint velocities, in rad/s.
    pub dq: [f64; N],
    /// Poses of frames F1..Fn.
    pub frames: [Pose<f64>; N],
    /// Pose of the TCP frame.
    pub tcp: Pose<f64>,
    /// Geometric Jacobian at the TCP.
    pub jacobian: SMatrix<f64, 6, N>,
    /// TCP velocity `J q̇`, in m/s and rad/s.
    pub velocity: Vector6<f64>,
    /// Gravity torque, in N m.
    pub gravity: SVector<f64, N>,
    /// Coriolis and centrifugal torque, in N m.
    pub coriolis: SVector<f64, N>,
    /// Generalised momentum `M q̇`.
    pub momentum: SVector<f64, N>,
    /// `Cᵀ q̇`, in N m.
    pub transposed_coriolis: SVector<f64, N>,
    /// Diagonal of the mass matrix, in kg m².
    pub inertia: [f64; N],
    /// Factor of the mass matrix, `M = L Lᵀ`.
    pub mass: Cholesky<f64, N>,
    /// `L⁻¹ Jᵀ`: one column per task axis.
    pub whitened: SMatrix<f64, N, 6>,
    /// Factor of the mobility, `J M⁻¹ Jᵀ = L_c L_cᵀ`, with bounded pivots.
    pub mobility: Cholesky<f64, 6>,
    /// Whether a pivot was bounded: the arm is near a singularity.
    pub near_singular: bool,
    /// Highest natural frequency that springs may have on this drive, in rad/s.
    pub fastest_rad_s: f64,
    /// Highest natural frequency and damping of the spring of a joint alone, in rad/s.
    pub joint_rad_s: f64,
}

impl<const N: usize> Snapshot<N> {
    /// The arm at joint angles `q` and velocities `dq`, with a drive that hides its
    /// motors. `None` if the mass matrix is not positive definite. Finite joint
    /// angles and a checked robot exclude that.
    #[inline]
    pub fn new(arm: &Arm<f64, N>, q: &[f64; N], dq: &[f64; N]) -> Option<Self> {
        Self::on(&Actuation::default(), arm, q, dq)
    }

    /// As [`new`](Self::new), on the given drive. `mass`, `mobility` and `inertia`
    /// contain its motors: they are what the commanded torque accelerates. The
    /// momentum does not: it belongs to the measured torque.
    #[inline]
    pub fn on(drive: &Actuation<N>, arm: &Arm<f64, N>, q: &[f64; N], dq: &[f64; N]) -> Option<Self> {
        let frames = arm.frames(q);
        let tcp = arm.tcp_frame(&frames);
        let jacobian = arm.jacobian(&frames, &tcp.position);
        let bodies = arm.bodies(&frames);
        let mut matrix = bodies.mass_matrix();
        arm.add_rotors(&mut matrix);
        for i in 0..N {
            matrix[(i, i)] += drive.motors[i];
        }
        let inertia = core::array::from_fn(|i| matrix[(i, i)]);
        let mass = Cholesky::new(&matrix)?;
        let mut whitened = SMatrix::<f64, N, 6>::zeros();
        for axis in 0..6 {
            let row = SVector::<f64, N>::from_fn(|i, _| jacobian[(axis, i)]);
            whitened.set_column(axis, &mass.solve_lower(&row));
        }
        let mut mobility = Matrix6::zeros();
        for i in 0..6 {
            for j in 0..=i {
                let mut sum = 0.0;
                for k in 0..N {
                    sum += whitened[(k, i)] * whitened[(k, j)];
                }
                mobility[(i, j)] = sum;
            }
        }
        let (mobility, near_singular) = Cholesky::with_pivot_floor(&mobility, MOBILITY_FLOOR)?;
        let mut velocity = Vector6::zeros();
        for i in 0..N {
            for k in 0..6 {
                velocity[k] += jacobian[(k, i)] * dq[i];
            }
        }
        let (mut momentum, transposed_coriolis) = bodies.momentum(dq);
        for i in 0..N {
            momentum[i] += arm.rotor()[i] * dq[i];
        }
        Some(Self {
            q: *q,
            dq: *dq,
            frames,
            tcp,
            jacobian,
            velocity,
            gravity: bodies.gravity(),
            coriolis: bodies.coriolis(dq),
            momentum,
            transposed_coriolis,
            inertia,
            mass,
            whitened,
            mobility,
            near_singular,
            fastest_rad_s: drive.fastest_rad_s,
            joint_rad_s: drive.joint_rad_s,
        })
    }

    /// `Jᵀ F`, in N m.
    #[inline]
    pub fn joint_torque(&self, force: &Vector6<f64>) -> SVector<f64, N> {
        let mut torque = SVector::<f64, N>::zeros();
        for i in 0..N {
            let mut sum = 0.0;
            for k in 0..6 {
                sum += self.jacobian[(k, i)] * force[k];
            }
            torque[i] = sum;
        }
        torque
    }

    /// How many times softer than `stiffness` (N m/rad) a rotational spring about the tool's axis is, because
    /// the drive allows no faster motion; at least 1. About that axis the arm has the least inertia.
    pub fn softened(&self, stiffness: f64) -> f64 {
        let axis = self.tcp.z();
        let mut mobility = 0.0;
        for k in 0..N {
            let sum: f64 = (0..3).map(|i| self.whitened[(k, 3 + i)] * axis[i]).sum();
            mobility += sum * sum;
        }
        (stiffness * mobility / (self.fastest_rad_s * self.fastest_rad_s)).max(1.0)
    }

    /// The task-space force that accelerates the TCP like the whitened joint torque
    /// `y = L⁻¹ tau`: `(J M⁻¹ Jᵀ)⁻¹ J M⁻¹ tau`.
    #[inline]
    pub fn task_force(&self, whitened_torque: &SVector<f64, N>) -> Vector6<f64> {
        let mut acceleration = Vector6::zeros();
        for axis in 0..6 {
            let mut sum = 0.0;
            for k in 0..N {
                sum += self.whitened[(k, axis)] * whitened_torque[k];
            }
            acceleration[axis] = sum;
        }
        self.mobility.solve(&acceleration)
    }

    /// The force at the TCP (F0, in N) that by itself explains an external joint
    /// torque (N m) best, damped.
    ///
    /// Near singularities of the wrist or the shoulder the torques do not determine
    /// a whole wrench, and friction of 1 N m looks like 100 N. They determine a
    /// force alone wherever the arm is not stretched.
    #[inline]
    pub fn point_force(&self, external: &SVector<f64, N>) -> Vector3<f64> {
        let mut normal = Matrix3::zeros();
        let mut force = Vector3::zeros();
        for i in 0..3 {
            for k in 0..N {
                force[i] += self.jacobian[(i, k)] * external[k];
            }
            for j in 0..=i {
                for k in 0..N {
                    normal[(i, j)] += self.jacobian[(i, k)] * self.jacobian[(j, k)];
                }
            }
            normal[(i, i)] += POINT_FORCE_DAMPING;
        }
        // Every pivot is positive because of the damping. For NaN any force will do.
        Cholesky::new(&normal).map_or(force, |factor| factor.solve(&force))
    }

    /// What no force at the TCP explains of an external joint torque (N m), in N m.
    #[inline]
    pub fn unexplained(&self, external: &SVector<f64, N>) -> SVector<f64, N> {
        let force = self.point_force(external);
        SVector::from_fn(|k, _| {
            let by_force = (0..3).map(|i| self.jacobian[(i, k)] * force[i]).sum::<f64>();
            external[k] - by_force
        })
    }

    /// Force on the TCP (F0, in N) that leaves it unaccelerated under a moment `moment` (F0, in N m)
    /// and the present joint speeds: with the mobility `B = J M⁻¹ Jᵀ` it is
    /// `−B_tt⁻¹ (B_tr m + J̇ q̇)`. It is bounded, because near singularities it need not be.
    #[inline]
    pub fn reaction(&self, moment: &Vector3<f64>) -> Vector3<f64> {
        let lower = self.mobility.lower();
        let drift = self.drift();
        // B_tt = L L' and B_tr = L R' of the factor's blocks; so L' f = −(R' m + L⁻¹ J̇ q̇).
        let mut y = Vector3::zeros();
        for i in 0..3 {
            let mut sum = drift[i];
            for k in 0..i {
                sum -= lower[(i, k)] * y[k];
            }
            y[i] = sum / lower[(i, i)];
        }
        for i in 0..3 {
            for k in 0..3 {
                y[i] += lower[(3 + k, i)] * moment[k];
            }
        }
        let mut force = Vector3::zeros();
        for i in (0..3).rev() {
            let mut sum = -y[i];
            for k in (i + 1)..3 {
                sum -= lower[(k, i)] * force[k];
            }
            force[i] = sum / lower[(i, i)];
        }
        force * (MOST_REACTION_N / force.norm().max(MOST_REACTION_N))
    }

    /// Acceleration of the TCP at constant joint speeds, `J̇ q̇`, in m/s².
    #[inline]
    fn drift(&self) -> Vector3<f64> {
        let (mut turn, mut turn_change, mut drift) = (Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        for i in 0..N {
            let about = self.frames[i].z() * self.dq[i];
            turn_change += turn.cross(&about);
            turn += about;
            let end = self.frames.get(i + 1).map_or(self.tcp.position, |next| next.position);
            let link = end - self.frames[i].position;
            drift += turn_change.cross(&link) + turn.cross(&turn.cross(&link));
        }
        drift
    }

    /// Speed of the computed TCP, in m/s.
    #[inline]
    pub fn tcp_speed(&self) -> f64 {
        let v = &self.velocity;
        sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::HOME;
    use spherecal_shared::robot::{iiwa7, iiwa7_tool};

    // Fails if the law takes a singular arm for one with an endless inertia, or a
    // regular arm for a singular one.
    #[test]
    fn the_inertia_of_a_singular_arm_is_bounded() {
        let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
        let at = |q: &[f64; 7]| Snapshot::new(&arm, q, &[0.0; 7]).expect("a mass matrix");
        for singular in [[0.0; 7], [0.3, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0]] {
            let snapshot = at(&singular);
            assert!(snapshot.near_singular);
            for axis in 0..6 {
                let pivot = snapshot.mobility.lower()[(axis, axis)];
                assert!(pivot * pivot > 0.0099, "axis {axis}: {} kg", 1.0 / (pivot * pivot));
            }
        }
        assert!(!at(&HOME).near_singular);
    }

    // Fails if the inertia of the rotors is missing in the mass matrix of the law or
    // in the momentum: both move with the joints.
    #[test]
    fn rotors_are_part_of_the_mass() {
        let (dq, mut robot) = ([0.7, -0.4, 0.3, 0.9, -1.0, 0.5, 0.2], iiwa7());
        let snapshot = |robot: &spherecal_shared::robot::Robot| {
            let arm = Arm::<f64, 7>::new(robot, &iiwa7_tool()).expect("an arm");
            Snapshot::new(&arm, &HOME, &dq).expect("a mass matrix")
        };
        let without = snapshot(&robot);
        for (joint, rotor) in robot.joints.iter_mut().zip([0.5, 0.5, 0.4, 0.4, 0.3, 0.2, 0.1]) {
            joint.rotor_kg_m2 = rotor;
        }
        let with = snapshot(&robot);
        let dq = SVector::from(dq);
        assert!((with.mass.multiply(&dq) - with.momentum).norm() < 1e-12);
        assert!((with.inertia[6] - without.inertia[6] - 0.1).abs() < 1e-12);
        assert!((with.momentum - without.momentum)[0] > 0.3);
    }
}
