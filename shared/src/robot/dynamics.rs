//! Inverse dynamics, mass matrix and momentum, all in base coordinates.
//!
//! Every spatial quantity is given at the origin of F0. Nothing is transformed
//! from link to link, and composite inertias are sums. One pass over the bodies
//! ([`Dynamics::bodies`]) serves gravity, mass matrix, Coriolis torques and
//! momentum, so that a control tick can compute all of them.
//!
//! The equation of motion, where `tau` is the torque of the actuators on the links
//! and `tau_ext` that of the environment:
//!
//! `M(q) q̈ + c(q, q̇) + g(q) = tau + tau_ext`

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::arm::Arm;
use super::pose::Pose;
use crate::scalar::{Real, lit};

/// Gravity of the reference data, in m/s².
pub const GRAVITY_M_S2: f64 = 9.81;

/// Spatial inertia of a body about the origin of F0.
#[derive(Clone, Copy, Debug)]
struct Spatial<T: Real> {
    mass: T,
    /// First moment: mass times centre of mass, in kg m.
    moment: Vector3<T>,
    /// Second moment about the origin: xx, yy, zz, xy, xz, yz, in kg m².
    second: [T; 6],
}

impl<T: Real> Spatial<T> {
    #[inline]
    fn add(&mut self, other: &Self) {
        self.mass += other.mass;
        self.moment += other.moment;
        for (a, b) in self.second.iter_mut().zip(&other.second) {
            *a += *b;
        }
    }

    /// Force and torque (about the origin) of this inertia times a motion. `w` is
    /// the angular part; `v` is the linear part, the velocity of the body's point
    /// at the origin.
    #[inline]
    fn times(&self, w: &Vector3<T>, v: &Vector3<T>) -> (Vector3<T>, Vector3<T>) {
        let [xx, yy, zz, xy, xz, yz] = self.second;
        let linear = v * self.mass + w.cross(&self.moment);
        let turned = Vector3::new(
            xx * w.x + xy * w.y + xz * w.z,
            xy * w.x + yy * w.y + yz * w.z,
            xz * w.x + yz * w.y + zz * w.z,
        );
        (linear, self.moment.cross(v) + turned)
    }
}

/// The bodies of an arm in one configuration, about the origin of F0.
#[derive(Clone, Debug)]
pub struct Bodies<T: Real, const N: usize> {
    /// Joint screws, the motion at unit joint speed: axis, and moment `O × z`.
    axis: [Vector3<T>; N],
    moment: [Vector3<T>; N],
    single: [Spatial<T>; N],
    composite: [Spatial<T>; N],
}

/// The dynamics of an [`Arm`]. The trait keeps them apart from its geometry.
pub trait Dynamics<T: Real, const N: usize> {
    /// Spatial inertias of all bodies, from the poses of frames F1..Fn in F0.
    fn bodies(&self, frames: &[Pose<T>; N]) -> Bodies<T, N>;
    /// Adds the reflected rotor inertias (kg m²) to the diagonal of a mass matrix.
    fn add_rotors(&self, mass: &mut SMatrix<T, N, N>);
    /// Inertia of the last link with its tool and rotor about the last joint, in kg m²: the last item of the mass
    /// matrix's diagonal. It is the same in every posture.
    fn last_inertia(&self) -> T;
}

impl<T: Real, const N: usize> Dynamics<T, N> for Arm<T, N> {
    #[inline]
    fn bodies(&self, frames: &[Pose<T>; N]) -> Bodies<T, N> {
        let zero = T::zero();
        let nothing = Spatial {
            mass: zero,
            moment: Vector3::zeros(),
            second: [zero; 6],
        };
        let mut bodies = Bodies {
            axis: [Vector3::zeros(); N],
            moment: [Vector3::zeros(); N],
            single: [nothing; N],
            composite: [nothing; N],
        };
        for i in 0..N {
            let frame = &frames[i];
            let body = &self.bodies[i];
            let z = frame.z();
            bodies.axis[i] = z;
            bodies.moment[i] = frame.position.cross(&z);
            bodies.single[i] = spatial(&frame.rotation, &frame.point(&body.com), body.mass, &body.inertia);
        }
        let mut sum = nothing;
        for i in (0..N).rev() {
            sum.add(&bodies.single[i]);
            bodies.composite[i] = sum;
        }
        bodies
    }

    fn last_inertia(&self) -> T {
        let rotor = self.rotor.last().copied().unwrap_or_else(T::zero);
        self.bodies.last().map_or(rotor, |body| {
            let (x, y) = (body.com.x, body.com.y);
            rotor + body.inertia[(2, 2)] + body.mass * (x * x + y * y)
        })
    }

    fn add_rotors(&self, mass: &mut SMatrix<T, N, N>) {
        for i in 0..N {
            mass[(i, i)] += self.rotor[i];
        }
    }
}

/// Spatial inertia about the origin of F0. `r` is the body's rotation, `c` its
/// centre of mass, `inertia` its inertia about `c` in its own axes.
#[inline]
fn spatial<T: Real>(r: &Matrix3<T>, c: &Vector3<T>, mass: T, inertia: &Matrix3<T>) -> Spatial<T> {
    let half = r * inertia;
    let entry = |i: usize, j: usize| half[(i, 0)] * r[(j, 0)] + half[(i, 1)] * r[(j, 1)] + half[(i, 2)] * r[(j, 2)];
    let moment = c * mass;
    let (mx, my, mz) = (moment.x, moment.y, moment.z);
    Spatial {
        mass,
        moment,
        second: [
            entry(0, 0) + my * c.y + mz * c.z,
            entry(1, 1) + mx * c.x + mz * c.z,
            entry(2, 2) + mx * c.x + my * c.y,
            entry(0, 1) - mx * c.y,
            entry(0, 2) - mx * c.z,
            entry(1, 2) - my * c.z,
        ],
    }
}

impl<T: Real, const N: usize> Bodies<T, N> {
    /// Joint torques that hold the arm against gravity, in N m.
    #[inline]
    pub fn gravity(&self) -> SVector<T, N> {
        let g = lit::<T>(GRAVITY_M_S2);
        let mut torque = SVector::<T, N>::zeros();
        for i in 0..N {
            // Minus the power of the weight m g (along −z) at unit joint speed: m g
            // times the upward velocity of the composite centre of mass.
            let (z, o) = (&self.axis[i], &self.moment[i]);
            let c = &self.composite[i];
            torque[i] = g * (o.z * c.mass + z.x * c.moment.y - z.y * c.moment.x);
        }
        torque
    }

    /// Mass matrix of the links without the rotors, in kg m².
    #[inline]
    pub fn mass_matrix(&self) -> SMatrix<T, N, N> {
        let mut mass = SMatrix::<T, N, N>::zeros();
        for i in 0..N {
            let (force, torque) = self.composite[i].times(&self.axis[i], &self.moment[i]);
            for j in 0..=i {
                let entry = self.axis[j].dot(&torque) + self.moment[j].dot(&force);
                mass[(i, j)] = entry;
                mass[(j, i)] = entry;
            }
        }
        mass
    }

    /// Coriolis and centrifugal torques `c(q, q̇)` without gravity, in N m.
    #[inline]
    pub fn coriolis(&self, dq: &[T; N]) -> SVector<T, N> {
        let (mut w, mut v) = (Vector3::zeros(), Vector3::zeros());
        let (mut dw, mut dv) = (Vector3::zeros(), Vector3::zeros());
        let mut forces = [(Vector3::zeros(), Vector3::zeros()); N];
        for i in 0..N {
            let (sw, sv) = (self.axis[i] * dq[i], self.moment[i] * dq[i]);
            // Rate of the screw, which moves with the parent: (w, v) crm (sw, sv).
            dw += w.cross(&sw);
            dv += w.cross(&sv) + v.cross(&sw);
            w += sw;
            v += sv;
            let body = &self.single[i];
            let (inertial_f, inertial_n) = body.times(&dw, &dv);
            let (p, l) = body.times(&w, &v);
            forces[i] = (inertial_f + w.cross(&p), inertial_n + w.cross(&l) + v.cross(&p));
        }
        let mut torque = SVector::<T, N>::zeros();
        let (mut f, mut n) = (Vector3::zeros(), Vector3::zeros());
        for i in (0..N).rev() {
            f += forces[i].0;
            n += forces[i].1;
            torque[i] = self.axis[i].dot(&n) + self.moment[i].dot(&f);
        }
        torque
    }

    /// Generalised momentum `p = M q̇` of the links, and `Cᵀ(q, q̇) q̇`. The momentum
    /// observer needs both, and gravity (`ṗ = tau + tau_ext + Cᵀ q̇ − g`).
    #[inline]
    pub fn momentum(&self, dq: &[T; N]) -> (SVector<T, N>, SVector<T, N>) {
        let (mut w, mut v) = (Vector3::zeros(), Vector3::zeros());
        let mut before = [(Vector3::zeros(), Vector3::zeros()); N];
        let mut own = [(Vector3::zeros(), Vector3::zeros()); N];
        for i in 0..N {
            before[i] = (w, v);
            w += self.axis[i] * dq[i];
            v += self.moment[i] * dq[i];
            own[i] = self.single[i].times(&w, &v);
        }
        let mut momentum = SVector::<T, N>::zeros();
        let mut transposed = SVector::<T, N>::zeros();
        let (mut p, mut l) = (Vector3::zeros(), Vector3::zeros());
        for i in (0..N).rev() {
            p += own[i].0;
            l += own[i].1;
            let (z, m) = (&self.axis[i], &self.moment[i]);
            momentum[i] = z.dot(&l) + m.dot(&p);
            let (w, v) = &before[i];
            transposed[i] = w.cross(z).dot(&l) + (w.cross(m) + v.cross(z)).dot(&p);
        }
        (momentum, transposed)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::robot::{built_in, iiwa7_tool};

    proptest! {
        // Fails if the inertia of the last link is not that of the mass matrix, rotor included.
        #[test]
        fn the_last_inertia_is_that_of_the_mass_matrix(
            name in prop::sample::select(&["iiwa7", "iiwa14", "fr3", "panda"][..]),
            q in prop::array::uniform7(-1.8f64..1.8),
            rotor in 0.0f64..0.5,
        ) {
            let mut robot = built_in(name).expect("built in");
            robot.joints[6].rotor_kg_m2 = rotor;
            let arm = Arm::<f64, 7>::new(&robot, &iiwa7_tool()).expect("an arm");
            let mut matrix = arm.bodies(&arm.frames(&q)).mass_matrix();
            arm.add_rotors(&mut matrix);
            prop_assert!((arm.last_inertia() - matrix[(6, 6)]).abs() < 1e-12);
        }
    }
}
