//! What the model may leave out: causes of error that are functions of where the
//! arm stands, of time, or of the coupling.
//!
//! Each cause is a set of columns in the space of TCP displacements. Nothing is
//! said here about how large it is: [`discrepancy`](super::discrepancy) finds that
//! from the data. The list is made from what is known of arms in general; the
//! shapes are wide on purpose.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::linear::Posture;
use crate::course::Course;

/// When an observation was made, and in which coupling. Predictions are made for
/// the end of the measurement and in no coupling.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Occasion {
    /// Share of the whole time, 0 to 1.
    pub(crate) time: f64,
    /// Number of the coupling; none for a prediction.
    pub(crate) coupling: Option<usize>,
    /// Number of the run of rows in it, as [`Course::runs`] counts; none for a prediction.
    pub(crate) run: Option<usize>,
}

impl Occasion {
    /// The moment of predictions.
    pub(crate) const NOW: Self = Self {
        time: 1.0,
        coupling: None,
        run: None,
    };
}

/// A cause of error that the model has no parameter for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Cause {
    /// The TCP moves by a smooth function of one joint's angle: sag of what the
    /// arm stands on, cables, a link that bends in another way than gravity says.
    Deflection(usize),
    /// The TCP moves with the orientation of the tool: form of the seat, target
    /// or reflector that is not where it seems.
    Orientation,
    /// A joint gives way to its torque in another way than in proportion:
    /// stiffness that grows with load, hysteresis.
    Torque(usize),
    /// A joint's error depends on other joints' angles.
    Cross(usize),
    /// Joint zeros move with time.
    ZeroDrift,
    /// Link lengths move with time: warm-up.
    LinkDrift,
    /// The plate or the tracker moves with time.
    ReferenceDrift,
    /// Each coupling seats a little elsewhere.
    Seat,
    /// The seat in the nest changes while the nest turns: each run of rows sits a little elsewhere in it.
    Nest,
}

impl Cause {
    /// Whether it is a function of where the arm stands alone.
    pub(crate) fn of_posture(&self) -> bool {
        matches!(
            self,
            Self::Deflection(_) | Self::Orientation | Self::Torque(_) | Self::Cross(_)
        )
    }

    /// For people.
    pub(crate) fn words(&self) -> String {
        match self {
            Self::Deflection(j) => format!("the TCP is displaced by a function of joint {}'s angle", j + 1),
            Self::Orientation => "the TCP is displaced by a function of the tool's orientation".to_owned(),
            Self::Torque(j) => format!("joint {} does not yield in proportion to its torque", j + 1),
            Self::Cross(j) => format!("joint {}'s error depends on other joints", j + 1),
            Self::ZeroDrift => "joint zeros drift with time".to_owned(),
            Self::LinkDrift => "link lengths drift with time".to_owned(),
            Self::ReferenceDrift => "the plate or tracker drifts with time".to_owned(),
            Self::Seat => "couplings seat differently".to_owned(),
            Self::Nest => "the seat in the nest changes while it turns".to_owned(),
        }
    }
}

/// Harmonics of one joint's angle in a deflection: sine and cosine of orders 1 and 2,
/// which follow any slow function over the range of a joint.
const DEFLECTION: usize = 4;
/// Columns that a wide cause keeps.
const KEPT: usize = 12;
/// Random waves that stand for a smooth function of two joints.
const WAVES: usize = 48;

/// A wave over two joints: two frequencies, the other joint, the phase.
type Wave = (f64, f64, usize, f64);

/// A cause with what its columns are made from.
#[derive(Clone, Debug)]
pub(crate) struct Shape {
    pub(crate) cause: Cause,
    /// Typical torque of the joint, in N m.
    torque: f64,
    waves: Vec<Wave>,
    couplings: usize,
    runs: usize,
    n: usize,
}

/// Every cause that data of this kind can show. `torques` are the typical torques
/// of the joints over the data, in N m; `seated` says whether the data are contacts with spheres.
pub(crate) fn shapes(torques: &[f64], course: &Course, seated: bool, timed: bool) -> Vec<Shape> {
    let (couplings, runs) = (course.couplings(), course.runs().last().map_or(0, |run| run + 1));
    let n = torques.len();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut shapes = Vec::new();
    let mut add = |cause: Cause, torque: f64, waves: Vec<Wave>| {
        shapes.push(Shape {
            cause,
            torque,
            waves,
            couplings,
            runs,
            n,
        });
    };
    for j in 0..n {
        add(Cause::Deflection(j), 0.0, Vec::new());
    }
    add(Cause::Orientation, 0.0, Vec::new());
    let largest = torques.iter().copied().fold(0.0, f64::max);
    for (j, &torque) in torques.iter().enumerate() {
        if torque > 1e-3 * largest && torque > 0.0 {
            add(Cause::Torque(j), torque, Vec::new());
        }
    }
    for j in 0..n {
        let mut wave = |_| {
            let other = (j + rng.random_range(1..n.max(2))) % n;
            let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
            let (own, across) = (normal(), normal());
            (own, across, other, rng.random_range(0.0..core::f64::consts::TAU))
        };
        let waves = if n > 1 {
            (0..WAVES).map(&mut wave).collect()
        } else {
            Vec::new()
        };
        if !waves.is_empty() {
            add(Cause::Cross(j), 0.0, waves);
        }
    }
    if timed {
        add(Cause::ZeroDrift, 0.0, Vec::new());
        add(Cause::LinkDrift, 0.0, Vec::new());
        add(Cause::ReferenceDrift, 0.0, Vec::new());
    }
    if couplings > 1 {
        add(Cause::Seat, 0.0, Vec::new());
    }
    if seated && runs > 1 {
        add(Cause::Nest, 0.0, Vec::new());
    }
    shapes
}

impl Shape {
    /// Number of columns.
    pub(crate) fn width(&self) -> usize {
        match self.cause {
            Cause::Deflection(_) => 3 * DEFLECTION,
            Cause::Orientation => 27,
            Cause::Torque(_) => 3,
            Cause::Cross(_) => self.waves.len(),
            Cause::ZeroDrift => 2 * (self.n - 1),
            Cause::LinkDrift => 4 * self.n,
            Cause::ReferenceDrift => 9,
            Cause::Seat => 3 * self.couplings,
            Cause::Nest => 3 * self.runs,
        }
    }

    /// Columns that it keeps at most: of a wide cause those along which the data vary most. A run of rows has
    /// columns of its own, which no others stand for.
    pub(crate) fn most(&self) -> usize {
        match self.cause {
            Cause::Nest => usize::MAX,
            _ => KEPT,
        }
    }

    /// Displacement of the TCP in F0, in m, by one unit of each column. `out` has
    /// [`Self::width`] items.
    pub(crate) fn fill(&self, p: &Posture, m: &Occasion, out: &mut [Vector3<f64>]) {
        out.fill(Vector3::zeros());
        match self.cause {
            Cause::Deflection(j) => {
                let (s, c) = p.q[j].sin_cos();
                for (k, value) in [s, c, 2.0 * s * c, c * c - s * s].into_iter().enumerate() {
                    for axis in 0..3 {
                        out[3 * k + axis] = Vector3::ith(axis, value);
                    }
                }
            }
            Cause::Orientation => {
                for axis in 0..3 {
                    for k in 0..9 {
                        out[9 * axis + k] = p.flange.column(axis) * p.flange[k];
                    }
                }
            }
            Cause::Torque(j) => {
                let t = p.torque[j] / self.torque;
                out[0] = p.joints[j] * (t * t.abs());
                out[1] = p.joints[j] * (t * t);
                out[2] = p.joints[j] * (5.0 * t).tanh();
            }
            Cause::Cross(j) => {
                for (slot, (own, across, other, phase)) in out.iter_mut().zip(&self.waves) {
                    *slot = p.joints[j] * (own * p.q[j] + across * p.q[*other] + phase).cos();
                }
            }
            Cause::ZeroDrift => {
                for j in 1..self.n {
                    out[2 * j - 2] = p.joints[j] * m.time;
                    out[2 * j - 1] = p.joints[j] * m.time.powi(2);
                }
            }
            Cause::LinkDrift => {
                for (k, length) in p.lengths.iter().enumerate() {
                    out[2 * k] = length * m.time;
                    out[2 * k + 1] = length * m.time.powi(2);
                }
            }
            Cause::ReferenceDrift => {
                if m.coupling.is_some() {
                    for axis in 0..3 {
                        out[axis] = Vector3::ith(axis, m.time);
                        out[3 + axis] = Vector3::ith(axis, m.time.powi(2));
                        out[6 + axis] = Vector3::<f64>::ith(axis, m.time).cross(&p.tcp);
                    }
                }
            }
            Cause::Seat => {
                if let Some(own) = m.coupling.filter(|c| *c < self.couplings) {
                    for axis in 0..3 {
                        out[3 * own + axis] = Vector3::ith(axis, 1.0);
                    }
                }
            }
            Cause::Nest => {
                if let Some(own) = m.run.filter(|run| *run < self.runs) {
                    for axis in 0..3 {
                        out[3 * own + axis] = p.flange.column(axis).into();
                    }
                }
            }
        }
    }
}
