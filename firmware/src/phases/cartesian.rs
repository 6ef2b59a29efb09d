//! State that the Cartesian phases share.

use nalgebra::{Matrix3, SVector, Vector3, Vector6};

use super::Env;
use crate::contact::SeatingWatch;
use crate::law::{CartesianSetpoint, Impedance, NullSpace, Snapshot, Stiffness, Wrench, rotation_error};

/// State that the Cartesian phases pass to each other.
#[derive(Clone, Debug)]
pub(crate) struct CartesianState<const N: usize> {
    /// Id of the sphere.
    pub(crate) sphere: u32,
    /// Direction of the approach in F0, a unit vector.
    pub(crate) direction: Vector3<f64>,
    /// The tare, F0: a wrench that is model error. The law compensates it, too. What no wrench explains is
    /// [`explained`](Self::explained).
    pub(crate) tare: Wrench,
    /// What the phase takes out of the external joint torque in this tick, in N m: it is no contact.
    pub(crate) explained: SVector<f64, N>,
    /// Computed TCP at contact, in m.
    pub(crate) contact: Vector3<f64>,
    /// The watch over the seated nest.
    pub(crate) watch: SeatingWatch<N>,
    /// The spring.
    pub(crate) impedance: Impedance,
    /// Setpoint of the spring.
    pub(crate) setpoint: CartesianSetpoint,
    /// Setpoint of the null space.
    pub(crate) null_space: NullSpace<N>,
}

impl<const N: usize> Default for CartesianState<N> {
    fn default() -> Self {
        Self {
            sphere: 0,
            direction: Vector3::zeros(),
            tare: Wrench::default(),
            explained: SVector::zeros(),
            contact: Vector3::zeros(),
            watch: SeatingWatch::default(),
            impedance: Impedance::new(Stiffness::isotropic(0.0, 0.0)),
            setpoint: CartesianSetpoint::at(Vector3::zeros(), Matrix3::identity()),
            null_space: NullSpace::Free,
        }
    }
}

impl<const N: usize> CartesianState<N> {
    /// Takes over from the joint law without a jump. The setpoints of the spring and
    /// of the elbow are where the arm is. The tare is compensated: a soft spring
    /// would give way to it by centimetres.
    pub(crate) fn engage(&mut self, snapshot: &Snapshot<N>, stiffness: Stiffness) {
        self.setpoint = CartesianSetpoint::at(snapshot.tcp.position, snapshot.tcp.rotation);
        self.setpoint.feed_forward = self.compensation(Vector3::zeros());
        self.impedance = Impedance::new(stiffness);
        self.null_space = NullSpace::at(snapshot);
    }

    /// Holds the joints where they are, no longer the elbow. Near a singularity of the shoulder joints 1 and 3 turn against each
    /// other and hardly move the elbow, so that its spring does not stop them.
    pub(crate) fn hold_posture(&mut self, snapshot: &Snapshot<N>) {
        if matches!(self.null_space, NullSpace::Elbow { .. }) {
            self.null_space = NullSpace::Posture(snapshot.q);
        }
    }

    /// Sets the setpoint to where the arm is, with the orientation `rotation`.
    pub(crate) fn relatch(&mut self, snapshot: &Snapshot<N>, rotation: Matrix3<f64>) {
        self.setpoint = CartesianSetpoint::at(snapshot.tcp.position, rotation);
        self.setpoint.feed_forward = self.compensation(Vector3::zeros());
    }

    /// Force and torque added to the spring's: the compensation of the tare, and
    /// `pull` (F0, in N).
    pub(crate) fn compensation(&self, pull: Vector3<f64>) -> Vector6<f64> {
        let (f, t) = (pull - self.tare.force, -self.tare.torque);
        Vector6::new(f.x, f.y, f.z, t.x, t.y, t.z)
    }

    /// Starts the ramp to the same translational stiffness along all axes.
    pub(crate) fn soften(&mut self, env: &Env<'_, N>, stiffness_n_m: f64) {
        let law = &env.procedure.law;
        let to = Stiffness::isotropic(stiffness_n_m, law.rotation_nm_rad);
        self.impedance.ramp_to(to, law.stiffness_ramp_s, env.period_s);
    }

    /// Whether the orientation error is certainly less than `angle` (rad, at most
    /// half a turn). `false` means unknown. It needs no arc tangent.
    pub(crate) fn surely_within(&self, snapshot: &Snapshot<N>, angle: f64) -> bool {
        let trace = self.setpoint.rotation.dot(&snapshot.tcp.rotation);
        // 3 - trace equals 2 (1 - cos error), which grows with the error, and
        // 2 (1 - cos x) is never less than x² - x⁴/12.
        let square = angle * angle;
        3.0 - trace < square - square * square / 12.0
    }

    /// Orientation error of the arm, in rad.
    pub(crate) fn orientation_error(&self, snapshot: &Snapshot<N>) -> f64 {
        rotation_error(&self.setpoint.rotation, &snapshot.tcp.rotation).norm()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::law::rotation_about;
    use crate::phases::scene::Scene;
    use spherecal_shared::robot::elbow::elbow;
    use spherecal_shared::robot::{Arm, built_in, iiwa7_tool};

    // Fails if an error that is beyond an angle counts as surely within it, or if the cheap bound is
    // so loose that it never helps: of 0.3 rad it must give away less than 2 mrad.
    #[test]
    fn what_is_surely_within_is_within() {
        let scene = Scene::new();
        let mut cartesian = scene.engaged(-Vector3::z());
        let axis = Vector3::new(0.48, -0.6, 0.64);
        for angle in [0.05, 0.3, 1.0, 2.0, 3.0] {
            for share in [0.0, 0.5, 0.9999, 1.0001, 1.2] {
                let error = angle * share;
                cartesian.setpoint.rotation = rotation_about(&axis, error) * scene.snapshot.tcp.rotation;
                if error <= core::f64::consts::PI {
                    assert!((cartesian.orientation_error(&scene.snapshot) - error).abs() < 1e-9);
                }
                let within = cartesian.surely_within(&scene.snapshot, angle);
                assert!(!within || error < angle, "{error} of {angle} rad");
            }
        }
        cartesian.setpoint.rotation = rotation_about(&axis, 0.2985) * scene.snapshot.tcp.rotation;
        assert!(cartesian.surely_within(&scene.snapshot, 0.3));
    }

    // Fails if an arm gets a null space that it has not: the elbow of seven joints, the present posture where
    // the elbow is not defined (a stretched arm), and nothing for six joints.
    #[test]
    fn the_null_space_is_that_of_the_arm() {
        let bent = Scene::new();
        let null_space = bent.engaged(-Vector3::z()).null_space;
        let now = elbow(&bent.snapshot.frames).expect("an elbow");
        assert_eq!(
            null_space,
            NullSpace::Elbow {
                angle: now.angle,
                rate: 0.0,
                acceleration: 0.0,
            }
        );
        let q = [0.1, 0.7, 0.0, 0.0, 0.0, 0.5, 0.0];
        let stretched = Scene::at(&q, &[0.0; 7]);
        assert_eq!(stretched.engaged(-Vector3::z()).null_space, NullSpace::Posture(q));
        let robot = built_in("ur5e").expect("a built-in robot");
        let arm = Arm::<f64, 6>::new(&robot, &iiwa7_tool()).expect("an arm");
        let snapshot = Snapshot::new(&arm, &[0.1, -1.0, 1.2, 0.3, 1.0, 0.2], &[0.0; 6]).expect("a mass matrix");
        let mut cartesian = CartesianState::<6>::default();
        cartesian.engage(&snapshot, Stiffness::isotropic(50.0, 200.0));
        assert_eq!(cartesian.null_space, NullSpace::Free);
    }

    // Fails if the tare has another sign in what the law compensates.
    #[test]
    fn the_tare_is_compensated() {
        let mut cartesian = Scene::new().engaged(Vector3::new(0.0, 0.6, -0.8));
        cartesian.tare = Wrench {
            force: Vector3::new(1.0, 2.0, 3.0),
            torque: Vector3::new(0.1, 0.2, 0.3),
        };
        let sum = cartesian.compensation(Vector3::new(10.0, 20.0, 30.0));
        assert!((sum - Vector6::new(9.0, 18.0, 27.0, -0.1, -0.2, -0.3)).norm() < 1e-12);
    }
}
