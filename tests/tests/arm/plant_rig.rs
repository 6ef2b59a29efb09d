//! What the plant's tests share: a small impedance law of their own (nothing of
//! the controller is trusted here), inverse kinematics, a plant over a sphere.
#![allow(
    dead_code,
    unreachable_pub,
    clippy::missing_panics_doc,
    reason = "each test file uses a part"
)]

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use spherecal::sim::plant::{Plant, PlantConfig, Sensed};
use spherecal_shared::robot::{Arm, Dynamics, Pose, iiwa7, iiwa7_tool};

/// A Cartesian impedance law on truth-free data, with the plant's own ideal model.
pub struct Law {
    /// Its model.
    pub arm: Arm<f64, 7>,
    rest: [f64; 7],
}

impl Law {
    /// About a rest posture.
    pub fn new(q: &[f64; 7]) -> Self {
        Self {
            arm: Arm::new(&iiwa7(), &iiwa7_tool()).expect("a robot"),
            rest: *q,
        }
    }

    /// Torques towards a target frame at stiffness `k` (N/m) and `kr` (N m/rad).
    pub fn torque(&self, s: &Sensed<7>, target: &Pose<f64>, k: f64, kr: f64) -> [f64; 7] {
        let frames = self.arm.frames(&s.q);
        let bodies = self.arm.bodies(&frames);
        let tcp = self.arm.tcp_frame(&frames);
        let jacobian = self.arm.jacobian(&frames, &tcp.position);
        let dq = SVector::<f64, 7>::from(s.dq);
        let v = jacobian * dq;
        let e = target.position - tcp.position;
        let turn = nalgebra::Rotation3::from_matrix(&(target.rotation * tcp.rotation.transpose())).scaled_axis();
        let mut f = SVector::<f64, 6>::zeros();
        for i in 0..3 {
            f[i] = k * e[i] - 25.0 * v[i];
            f[i + 3] = kr * turn[i] - 4.0 * v[i + 3];
        }
        // A weak posture spring holds the elbow, in the null space of the force.
        let posture = (SVector::from(self.rest) - SVector::from(s.q)) * 2.0 - dq * 0.5;
        let square = jacobian * jacobian.transpose() + SMatrix::<f64, 6, 6>::identity() * 1e-6;
        let task = square.try_inverse().expect("regular") * (jacobian * posture);
        (jacobian.transpose() * (f - task) + posture + bodies.gravity()).into()
    }
}

/// Nose-down orientation with a turn about z.
pub fn down(yaw: f64) -> Matrix3<f64> {
    let (s, c) = yaw.sin_cos();
    Matrix3::new(c, s, 0.0, s, -c, 0.0, 0.0, 0.0, -1.0)
}

/// Joint angles for a TCP frame, by damped least squares.
pub fn reach(target: &Pose<f64>) -> [f64; 7] {
    let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("a robot");
    let mut q = [0.0, 0.7, 0.0, -1.4, 0.0, 1.0, 0.0];
    for _ in 0..300 {
        let frames = arm.frames(&q);
        let tcp = arm.tcp_frame(&frames);
        let e = target.position - tcp.position;
        let turn = nalgebra::Rotation3::from_matrix(&(target.rotation * tcp.rotation.transpose())).scaled_axis();
        let error = SVector::<f64, 6>::from_iterator(e.iter().chain(turn.iter()).copied());
        let j = arm.jacobian(&frames, &tcp.position);
        let damped = j * j.transpose() + SMatrix::<f64, 6, 6>::identity() * 1e-6;
        let step = j.transpose() * damped.try_inverse().expect("regular") * error;
        for i in 0..7 {
            q[i] += step[i].clamp(-0.2, 0.2);
        }
    }
    let tcp = arm.tcp_frame(&arm.frames(&q));
    assert!((tcp.position - target.position).norm() < 1e-9, "out of reach");
    q
}

/// An ideal plant whose nest is `offset` (m, F0) away from its seat on sphere 2.
pub fn at_sphere(config: &PlantConfig, offset: Vector3<f64>) -> (Plant<7>, Law, Pose<f64>) {
    let sphere = Plant::<7>::new(&iiwa7(), &iiwa7_tool(), config, &[0.0; 7])
        .expect("a plant")
        .world()
        .spheres[1]
        .expect("a sphere");
    let seat = Pose {
        rotation: down(core::f64::consts::PI),
        position: sphere,
    };
    let q = reach(&Pose {
        position: sphere + offset,
        ..seat
    });
    let plant = Plant::new(&iiwa7(), &iiwa7_tool(), config, &q).expect("a plant");
    (plant, Law::new(&q), seat)
}

/// Runs `ms` ticks towards a target.
pub fn run(plant: &mut Plant<7>, law: &Law, target: &Pose<f64>, k: f64, ms: u32) {
    for _ in 0..ms {
        let tau = law.torque(plant.sensed(), target, k, 200.0);
        plant.step(&tau);
    }
}

/// An ideal plant in empty space.
pub fn free() -> PlantConfig {
    PlantConfig {
        contact: false,
        ..PlantConfig::ideal()
    }
}
