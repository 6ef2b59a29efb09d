//! An arm with errors, and what an instrument sees of it.

use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use spherecal_identify::{Calibration, Experiment, Observation, Pose, Set, Target};
use spherecal_model::Chain;
use spherecal_shared::robot::{Robot, Tool, iiwa7, iiwa7_tool};

/// Where the targets are in the flange frame, in m.
pub(crate) const POINTS: [[f64; 3]; 3] = [[0.05, 0.0, 0.1], [-0.12, 0.08, 0.05], [0.02, -0.15, 0.12]];
/// Deviation of each joint in each row, in rad: common to all targets of the row.
const JOINT_RAD: f64 = 2e-4;
/// Compliance of every joint, in rad/(N m).
const COMPLIANCE: f64 = 4e-6;

/// Noise of one target along each axis.
#[derive(Clone, Copy)]
pub(crate) struct Noise {
    pub(crate) mm: f64,
}

impl Noise {
    pub(crate) fn of(mm: f64) -> Self {
        Self { mm }
    }
}

pub(crate) struct Drawn {
    rng: ChaCha8Rng,
    chain: Chain,
    bodies: Vec<(f64, Vector3<f64>)>,
    robot: Robot,
    /// F0 in the frame of the instrument.
    base: Pose,
    /// The measured body in the flange frame.
    body: Matrix3<f64>,
}

fn normal(rng: &mut ChaCha8Rng, sigma: f64) -> f64 {
    let z: f64 = StandardNormal.sample(rng);
    z * sigma
}

/// The tool without mass, as the identification is told.
fn tool() -> Tool {
    Tool {
        tcp_m: POINTS[0],
        ..iiwa7_tool()
    }
}

impl Drawn {
    pub(crate) fn new(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut robot = iiwa7();
        for joint in robot.joints.iter_mut().skip(1) {
            joint.mdh.a += normal(&mut rng, 2e-4);
            joint.mdh.d += normal(&mut rng, 2e-4);
            joint.mdh.alpha += normal(&mut rng, 4e-4);
            joint.mdh.theta += normal(&mut rng, 7e-4);
        }
        // What base and tool take over has no error of its own.
        let last = robot.joints.len() - 1;
        robot.joints[last].mdh.d = iiwa7().joints[last].mdh.d;
        robot.joints[last].mdh.theta = iiwa7().joints[last].mdh.theta;
        let bodies = robot.joints.iter().enumerate().map(|(i, joint)| {
            let body = if i == last {
                joint.link.combined(&tool().body)
            } else {
                joint.link
            };
            (body.mass_kg, body.com())
        });
        Self {
            bodies: bodies.collect(),
            chain: Chain::unchecked(&robot, &tool()),
            robot,
            base: Pose {
                rotation: Rotation3::from_euler_angles(0.4, -0.3, 1.9).into_inner(),
                position: Vector3::new(2.0, -1.0, 0.5),
            },
            body: Rotation3::from_euler_angles(1.0, 0.4, -0.7).into_inner(),
            rng,
        }
    }

    /// Torques that hold the arm, in N m: the slope of its potential energy.
    fn torques(&self, q: &[f64]) -> Vec<f64> {
        let energy = |q: &[f64]| -> f64 {
            let frames = self.chain.frames(q);
            let of = |(frame, (mass, com)): (&Pose, &(f64, Vector3<f64>))| mass * 9.80665 * frame.point(com).z;
            frames.iter().zip(&self.bodies).map(of).sum()
        };
        let slope = |i: usize| {
            let by = |step: f64| {
                let mut q = q.to_vec();
                q[i] += step;
                energy(&q)
            };
            (by(1e-5) - by(-1e-5)) / 2e-5
        };
        (0..q.len()).map(slope).collect()
    }

    /// The flange in F0, with the joints off by `deviation` (rad).
    fn flange(&self, q: &[f64], deviation: &[f64]) -> Pose {
        let torques = self.torques(q);
        let stands = q.iter().zip(&torques).zip(deviation);
        let stands: Vec<f64> = stands.map(|((q, tau), off)| q - COMPLIANCE * tau + off).collect();
        self.chain.frames(&stands)[q.len() - 1]
    }

    /// The true TCP in F0, in m.
    pub(crate) fn tcp(&self, q: &[f64]) -> Vector3<f64> {
        self.flange(q, &[0.0; 7]).point(&Vector3::from(POINTS[0]))
    }

    /// The true value of a parameter of the geometry or of a target; none of the others.
    pub(crate) fn truth(&self, name: &str) -> Option<f64> {
        let rest = |prefix: &str| name.strip_prefix(prefix)?.parse::<usize>().ok();
        if let Some(target) = name.strip_prefix("target") {
            let (number, axis) = target.split_once('_')?;
            let axis = ["x", "y", "z"].iter().position(|a| *a == axis)?;
            return Some(POINTS[number.parse::<usize>().ok()? - 1][axis]);
        }
        let row = |i: usize| self.robot.joints.get(i).map(|j| j.mdh);
        None.or_else(|| Some(row(rest("alpha")?)?.alpha))
            .or_else(|| Some(row(rest("a")?)?.a))
            .or_else(|| Some(row(rest("d")?.checked_sub(1)?)?.d))
            .or_else(|| Some(row(rest("theta")?.checked_sub(1)?)?.theta))
    }

    fn configuration(&mut self) -> Vec<f64> {
        (0..7).map(|_| self.rng.random_range(-1.5..1.5)).collect()
    }

    fn experiment(&mut self, rows: usize, mut measure: impl FnMut(&mut Self, &Pose) -> Target) -> Experiment {
        let observations = (0..rows).map(|_| {
            let q = self.configuration();
            let off: Vec<f64> = (0..7).map(|_| normal(&mut self.rng, JOINT_RAD)).collect();
            let flange = self.flange(&q, &off);
            let at = self.base.compose(&flange);
            Observation {
                seat: None,
                q,
                tau: None,
                target: measure(self, &at),
                set: Set::Calibrate,
            }
        });
        Experiment {
            robot: iiwa7(),
            tool: tool(),
            spheres: Vec::new(),
            observations: observations.collect(),
        }
    }

    /// Rows in which as many targets as `noise` has are seen.
    pub(crate) fn points(&mut self, rows: usize, noise: &[Noise]) -> Experiment {
        self.experiment(rows, |own, flange| {
            let points = POINTS.iter().zip(noise).map(|(place, noise)| {
                let off = Vector3::from_fn(|_, _| normal(&mut own.rng, noise.mm / 1e3));
                Some((flange.point(&Vector3::from(*place)) + off).into())
            });
            Target::Points(points.collect())
        })
    }

    /// Rows of three targets on a tool that is turned about the flange by so much in each (mrad, each axis), by no joint.
    pub(crate) fn turning(&mut self, rows: usize, noise: Noise, mrad: f64) -> Experiment {
        self.experiment(rows, |own, flange| {
            let turn = Rotation3::new(Vector3::from_fn(|_, _| normal(&mut own.rng, mrad / 1e3))).into_inner();
            let points = POINTS.map(|place| {
                let off = Vector3::from_fn(|_, _| normal(&mut own.rng, noise.mm / 1e3));
                Some((flange.position + flange.rotation * turn * Vector3::from(place) + off).into())
            });
            Target::Points(points.into())
        })
    }

    /// Rows with the pose of the tool, noise in mm and mrad.
    pub(crate) fn poses(&mut self, rows: usize, mm: f64, mrad: f64) -> Experiment {
        self.seen_poses(rows, mm, mm, mrad)
    }

    /// The same of an instrument whose noise along the line of sight, from the origin of its frame, is `depth_mm`.
    pub(crate) fn seen_poses(&mut self, rows: usize, mm: f64, depth_mm: f64, mrad: f64) -> Experiment {
        self.experiment(rows, |own, flange| {
            let off = Vector3::from_fn(|_, _| normal(&mut own.rng, mm / 1e3));
            let sight = flange.point(&Vector3::from(POINTS[0])).normalize();
            let off = off + sight * (sight.dot(&off) * (depth_mm / mm - 1.0));
            let turn = Vector3::from_fn(|_, _| normal(&mut own.rng, mrad / 1e3));
            Target::Frame(Box::new(Pose {
                rotation: Rotation3::new(turn).into_inner() * flange.rotation * own.body,
                position: flange.point(&Vector3::from(POINTS[0])) + off,
            }))
        })
    }
}

/// Mean error of the TCP in new poses after the best rigid fit, in mm.
pub(crate) fn tcp_error_mm(drawn: &Drawn, found: &Calibration) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(99);
    let poses: Vec<Vec<f64>> = (0..200)
        .map(|_| (0..7).map(|_| rng.random_range(-1.5..1.5)).collect())
        .collect();
    let from: Vec<_> = poses.iter().map(|q| found.tcp_m(q, None)).collect();
    let onto: Vec<_> = poses.iter().map(|q| drawn.tcp(q)).collect();
    let pose = spherecal_model::fit_pose(&from, &onto).expect("spread points");
    let errors = from.iter().zip(&onto).map(|(a, b)| (pose.point(a) - b).norm() * 1e3);
    errors.sum::<f64>() / poses.len() as f64
}

/// How many free parameters with a known truth are beyond two of their sigmas, and how many there are.
pub(crate) fn beyond_two_sigmas(drawn: &Drawn, found: &Calibration) -> (f64, f64) {
    let (mut beyond, mut all) = (0.0, 0.0);
    for p in found.parameters.iter().filter(|p| p.free) {
        let Some(truth) = drawn.truth(&p.name) else { continue };
        all += 1.0;
        if (p.estimate - truth).abs() > 2.0 * p.sigma {
            beyond += 1.0;
        }
    }
    (beyond, all)
}
