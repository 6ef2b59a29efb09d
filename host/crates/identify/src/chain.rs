//! Kinematics of a robot whose number of joints is known only at run time.
//!
//! The constants of an observation are prepared once ([`Prepared`]). A model state ([`State`]) then
//! gives the TCP, and the columns from which the estimators build their Jacobians ([`Kinematics`]).

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use spherecal_model::input::MOST_TARGETS;
use spherecal_shared::MAX_CHAIN;
use spherecal_shared::robot::kinematics::{next_frame_turned, parameter_columns};
use spherecal_shared::robot::{LinkTransform, MdhRow, Pose, Robot, Tool};
use spherecal_shared::scalar::Real;

use super::load::HoldingMoments;
use super::parameters::Layout;
use super::seen::{RowPart, Seen};

/// Largest number of joints, as a length of arrays.
pub(crate) const N: usize = MAX_CHAIN;
/// Joints that are computed side by side.
const LANES: usize = 4;

/// Length of arrays by joint over which a robot with `n` joints is computed: no more than it needs of the room for any.
#[inline]
pub(crate) fn lanes(n: usize) -> usize {
    n.next_multiple_of(LANES).min(N)
}

/// Room for the general columns of any layout and the six of a base.
pub(crate) const OWN: usize = 5 * N + 15 + 3 * MOST_TARGETS;

/// Cosine and sine by joint.
pub(crate) type Trig = [(f64, f64); N];

/// Cosine and sine of joint angles.
pub(crate) fn trig(q: &[f64; N]) -> Trig {
    q.map(|angle| {
        let (s, c) = angle.sin_cos_of();
        (c, s)
    })
}

/// Angles up to this value are rotated by a series, in rad. The truncation error is 1e-17.
const SMALL_RAD: f64 = 0.05;

/// Cosine and sine of an angle, computed fast if it is small.
#[inline]
fn small(angle: f64) -> (f64, f64) {
    if angle.abs() < SMALL_RAD {
        let e = angle * angle;
        let sine = angle * (1.0 - e / 6.0 * (1.0 - e / 20.0 * (1.0 - e / 42.0)));
        (1.0 - e / 2.0 * (1.0 - e / 12.0 * (1.0 - e / 30.0)), sine)
    } else {
        let (s, c) = angle.sin_cos_of();
        (c, s)
    }
}

/// Cosine and sine of the sum of two angles.
#[inline]
fn sum(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    (a.0 * b.0 - a.1 * b.1, a.1 * b.0 + a.0 * b.1)
}

/// One observation, ready for the estimators.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Prepared {
    /// Index into the experiment's observations.
    pub(crate) index: usize,
    pub(crate) q: [f64; N],
    /// Cosine and sine of `q`, stored because an observation is evaluated many times.
    pub(crate) trig: Trig,
    pub(crate) load: HoldingMoments,
    /// The leading target's number, from 0: the first that was seen.
    pub(crate) lead: usize,
    /// The leading target in its reference frame, in m (a sphere's certified centre).
    pub(crate) target: Vector3<f64>,
    /// Whether noise along the instrument's line of sight differs from that across it.
    pub(crate) sighted: bool,
    /// What the row tells besides the leading target.
    pub(crate) further: Box<[Seen]>,
    /// Index of the reference frame in the layout.
    pub(crate) reference: usize,
    /// Index of the sphere in the layout.
    pub(crate) sphere: Option<usize>,
    /// Index of the row's own seat in the layout.
    pub(crate) seat: Option<usize>,
}

impl Prepared {
    /// How many numbers were measured.
    pub(crate) fn numbers(&self) -> f64 {
        3.0 * (1 + self.further.len()) as f64
    }

    /// Whether the row has more targets than one.
    #[inline]
    pub(crate) fn has_several(&self) -> bool {
        self.further.iter().any(|seen| matches!(seen, Seen::Target { .. }))
    }

    /// The part that leads the row.
    pub(crate) fn leading(&self) -> RowPart {
        RowPart::Target(self.lead)
    }

    /// All parts of the row, in order.
    pub(crate) fn parts(&self) -> impl Iterator<Item = RowPart> {
        std::iter::once(self.leading()).chain(self.further.iter().map(Seen::part))
    }
}

/// A state of the model: the geometry and the effects at one point of the search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct State {
    pub(crate) rows: Vec<MdhRow<f64>>,
    pub(crate) tcp: Vector3<f64>,
    /// Targets 2.. in the flange frame, in m.
    pub(crate) targets: Vec<Vector3<f64>>,
    /// Orientation of the measured body in the flange frame.
    pub(crate) body: Matrix3<f64>,
    /// F0 in each reference frame.
    pub(crate) bases: Vec<Pose>,
    /// Points of each reference frame about which steps rotate the base, in m: the mean of the
    /// targets, so that rotations and shifts are nearly uncorrelated.
    pub(crate) pivots: Vec<Vector3<f64>>,
    /// Compliance per joint, rad/(N m).
    pub(crate) compliance: Vec<f64>,
    /// Cosine and sine parts by joint and order, in rad.
    pub(crate) harmonics: Vec<Vec<[f64; 2]>>,
    /// Bending per joint about x and y, rad/(N m).
    pub(crate) bending: Vec<[f64; 2]>,
    /// Base tilt about x and y, rad/(N m).
    pub(crate) tilt: [f64; 2],
    /// Scale of the measured points or of the certificate, minus one.
    #[serde(default)]
    pub(crate) scale: f64,
    /// Offsets from the certificate, in m.
    pub(crate) spheres: Vec<Vector3<f64>>,
    /// Seats of rows that have one of their own: sphere minus TCP in the flange frame, in m.
    #[serde(default)]
    pub(crate) seats: Vec<Vector3<f64>>,
    #[serde(skip)]
    links: Vec<LinkTransform<f64>>,
    /// Cosine and sine of the rows' theta.
    #[serde(skip)]
    offsets: Vec<(f64, f64)>,
    /// The harmonics by order: cosine parts of all joints, then sine parts. The joints lie side by side, so that
    /// their waves are summed together.
    #[serde(skip)]
    waves: Vec<[[f64; N]; 2]>,
}

/// Intermediate results of an evaluation, for the Jacobian.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Kinematics {
    pub(crate) frames: [Pose<f64>; N],
    /// The TCP in F0, in m; of an observation its leading target.
    pub(crate) tcp: Vector3<f64>,
    /// Cosine and sine of the encoder angles.
    pub(crate) trig: Trig,
}

impl State {
    pub(crate) fn nominal(robot: &Robot, tool: &Tool, layout: &Layout) -> Self {
        let n = robot.dof();
        let mut state = Self {
            rows: robot.joints.iter().map(|j| j.mdh).collect(),
            tcp: tool.tcp(),
            targets: vec![Vector3::zeros(); layout.targets.saturating_sub(1)],
            body: Matrix3::identity(),
            bases: vec![Pose::default(); layout.references.len()],
            pivots: vec![Vector3::zeros(); layout.references.len()],
            compliance: vec![0.0; n],
            harmonics: vec![vec![[0.0; 2]; layout.orders]; n],
            bending: vec![[0.0; 2]; n],
            tilt: [0.0; 2],
            scale: 0.0,
            spheres: vec![Vector3::zeros(); layout.spheres.len()],
            seats: vec![Vector3::zeros(); layout.seats.len()],
            links: Vec::new(),
            offsets: Vec::new(),
            waves: Vec::new(),
        };
        state.refresh();
        state
    }

    /// Recomputes what follows from rows and harmonics.
    pub(crate) fn refresh(&mut self) {
        self.links = self.rows.iter().map(LinkTransform::from).collect();
        let offset = |row: &MdhRow<f64>| {
            let (s, c) = row.theta.sin_cos_of();
            (c, s)
        };
        self.offsets = self.rows.iter().map(offset).collect();
        let orders = self.harmonics.iter().map(Vec::len).max().unwrap_or_default();
        let part = |order: usize, part: usize| {
            let of = |joint: usize| Some(self.harmonics.get(joint)?.get(order)?[part]);
            std::array::from_fn(|joint| of(joint).unwrap_or_default())
        };
        self.waves = (0..orders).map(|order| [part(order, 0), part(order, 1)]).collect();
    }

    /// Corrections of the encoder angles by compliance and harmonics, in rad.
    #[inline]
    fn deviations(&self, trig: &Trig, load: &HoldingMoments) -> [f64; N] {
        let mut deviations = [0.0; N];
        for ((slot, compliance), moment) in deviations.iter_mut().zip(&self.compliance).zip(&load.joint) {
            *slot = -compliance * moment[2];
        }
        let (c, s) = (trig.map(|t| t.0), trig.map(|t| t.1));
        let (mut ck, mut sk) = (c, s);
        let lanes = lanes(self.rows.len());
        for [cosine, sine] in &self.waves {
            for j in 0..lanes {
                deviations[j] += cosine[j] * ck[j] + sine[j] * sk[j];
                (ck[j], sk[j]) = (ck[j] * c[j] - sk[j] * s[j], sk[j] * c[j] + ck[j] * s[j]);
            }
        }
        deviations
    }

    /// Frames and TCP at encoder angles `q` (at least n) under `load`.
    pub(crate) fn evaluate(&self, q: &[f64; N], load: &HoldingMoments) -> Kinematics {
        self.turned(&trig(q), load, &self.tcp)
    }

    /// Frames and leading target of an observation.
    #[inline]
    pub(crate) fn at(&self, observation: &Prepared) -> Kinematics {
        let mut tool = self.place(observation.lead);
        if let Some(seat) = observation.seat.and_then(|s| self.seats.get(s)) {
            tool += seat;
        }
        self.turned(&observation.trig, &observation.load, &tool)
    }

    #[inline]
    fn turned(&self, trig: &Trig, load: &HoldingMoments, tool: &Vector3<f64>) -> Kinematics {
        let mut frames = [Pose::identity(); N];
        let mut frame = Pose::identity();
        let deviations = self.deviations(trig, load);
        for (j, ((link, offset), slot)) in self.links.iter().zip(&self.offsets).zip(&mut frames).enumerate() {
            let (c, s) = sum(sum(trig[j], *offset), small(deviations[j]));
            frame = next_frame_turned(&frame, link, (s, c));
            *slot = frame;
        }
        Kinematics {
            tcp: self.tip(&frames, &frame, load, tool),
            frames,
            trig: *trig,
        }
    }

    /// Where a point of the flange frame (m) is in F0, with bending and tilt.
    #[inline]
    pub(crate) fn tip(
        &self,
        frames: &[Pose<f64>; N],
        flange: &Pose<f64>,
        load: &HoldingMoments,
        tool: &Vector3<f64>,
    ) -> Vector3<f64> {
        let mut tcp = flange.point(tool);
        let rigid = tcp;
        for (j, [x, y]) in self.bending.iter().enumerate().take(N) {
            if *x != 0.0 || *y != 0.0 {
                let turn = bend(&frames[j], &load.joint[j], *x, *y);
                tcp += turn.cross(&(rigid - frames[j].position));
            }
        }
        let tilt = Vector3::new(-self.tilt[0] * load.base[0], -self.tilt[1] * load.base[1], 0.0);
        tcp += tilt.cross(&rigid);
        tcp
    }

    /// Columns of the general block and of the joints, in F0: `general` has
    /// [`Layout::general`] items, `joints` one per joint.
    #[inline]
    pub(crate) fn columns(
        &self,
        layout: &Layout,
        k: &Kinematics,
        load: &HoldingMoments,
        general: &mut [Vector3<f64>],
        joints: &mut [Vector3<f64>],
    ) {
        let n = layout.n;
        let mut parent = Pose::identity();
        for i in 0..n {
            let frame = &k.frames[i];
            let (x, z): (Vector3<f64>, Vector3<f64>) = (parent.rotation.column(0).into(), frame.z());
            general[3 * i] = x.cross(&(k.tcp - parent.position));
            general[3 * i + 1] = x;
            general[3 * i + 2] = if layout.hayati[i] {
                parameter_columns(&parent, frame, &self.rows[i], &k.tcp).beta
            } else {
                z
            };
            joints[i] = z.cross(&(k.tcp - frame.position));
            parent = *frame;
        }
        for axis in 0..3 {
            general[3 * n + axis] = parent.rotation.column(axis).into();
        }
        if layout.stiffness {
            for i in 0..n {
                let frame = &k.frames[i];
                let arm = k.tcp - frame.position;
                let at = layout.bending(i);
                general[at] = bend(frame, &load.joint[i], 1.0, 0.0).cross(&arm);
                general[at + 1] = bend(frame, &load.joint[i], 0.0, 1.0).cross(&arm);
            }
            let at = layout.tilt();
            general[at] = Vector3::x().cross(&k.tcp) * -load.base[0];
            general[at + 1] = Vector3::y().cross(&k.tcp) * -load.base[1];
        }
    }

    /// The pivot of a reference frame in F0, in m.
    #[inline]
    pub(crate) fn pivot(&self, reference: usize) -> Vector3<f64> {
        match (self.bases.get(reference), self.pivots.get(reference)) {
            (Some(base), Some(pivot)) => base.inverse_point(pivot),
            _ => Vector3::zeros(),
        }
    }

    /// Residual in F0: TCP minus target, in m.
    #[inline]
    pub(crate) fn residual(&self, observation: &Prepared, tcp: &Vector3<f64>) -> Vector3<f64> {
        let mut target = observation.target;
        if let Some(offset) = observation.sphere.and_then(|s| self.spheres.get(s)) {
            target += offset;
        }
        tcp - self.true_place(observation.reference, &target)
    }

    /// Where a target (m, reference frame) that was measured with the scale is in F0.
    #[inline]
    pub(crate) fn true_place(&self, reference: usize, target: &Vector3<f64>) -> Vector3<f64> {
        match (self.bases.get(reference), self.pivots.get(reference)) {
            (Some(base), Some(pivot)) => base.inverse_point(&(target - (target - pivot) * self.scale)),
            _ => *target,
        }
    }

    /// Column of the scale for a target, in F0: how the residual moves.
    #[inline]
    pub(crate) fn scale_column(&self, reference: usize, target: &Vector3<f64>) -> Vector3<f64> {
        match (self.bases.get(reference), self.pivots.get(reference)) {
            (Some(base), Some(pivot)) => base.rotation.tr_mul(&(target - pivot)),
            _ => Vector3::zeros(),
        }
    }
}

/// Rotation of a link by bending, in F0, in rad. The link yields to the load, so the rotation is
/// against the moment that holds it.
#[inline]
pub(crate) fn bend(frame: &Pose<f64>, moment: &[f64; 3], x: f64, y: f64) -> Vector3<f64> {
    let r: &Matrix3<f64> = &frame.rotation;
    r.column(0) * (-x * moment[0]) + r.column(1) * (-y * moment[1])
}
