//! The whitened columns of one pose, and the gradient that they add up to.

use nalgebra::{Matrix3, Vector3};

use super::groups::add_all;
use super::whitening::{Conditional, Root, Whitening};
use crate::chain::{Kinematics, N, OWN, Prepared, State, lanes};
use crate::parameters::Layout;
use crate::seen::Seen;

/// One part of a pose: its whitened columns and residual.
pub(super) struct PoseColumns {
    pub(super) own: [Vector3<f64>; OWN],
    pub(super) joints: [Vector3<f64>; N],
    /// Whitened columns of what the parts of the row share; only of rows with several.
    shared: Option<Vec<Vector3<f64>>>,
    pub(super) trig: [(f64, f64); N],
    pub(super) residual: Vector3<f64>,
}

impl PoseColumns {
    /// Hands every part of a row to `put`, in order: the leading one, then each of the others given
    /// those before it.
    #[inline]
    pub(super) fn each(
        state: &State,
        layout: &Layout,
        observation: &Prepared,
        whitening: &Whitening,
        weight: f64,
        mut put: impl FnMut(&Self),
    ) {
        let leading = Self::new(state, layout, observation, whitening, weight);
        put(&leading);
        if observation.further.is_empty() {
            return;
        }
        let k = state.at(observation);
        let mut before = vec![leading];
        for seen in &observation.further {
            let next = Self::given(&before, state, layout, observation, &k, seen, whitening, weight);
            put(&next);
            before.push(next);
        }
    }

    /// A part of a row given those before it.
    fn given(
        before: &[Self],
        state: &State,
        layout: &Layout,
        observation: &Prepared,
        k: &Kinematics,
        seen: &Seen,
        whitening: &Whitening,
        weight: f64,
    ) -> Self {
        let (n, general) = (layout.n, layout.general());
        let mut own = [Vector3::zeros(); OWN];
        let mut joints = [Vector3::zeros(); N];
        let (residual, arm) = state.part_columns(layout, observation, k, seen, &mut own, &mut joints);
        let rotation = state
            .bases
            .get(observation.reference)
            .map_or_else(Matrix3::identity, |base| base.rotation);
        for axis in 0..3 {
            let e = rotation.row(axis).transpose();
            match seen {
                Seen::Target { .. } => {
                    own[general + axis] = e;
                    own[general + 3 + axis] = e.cross(&arm);
                }
                // A shift of the base does not turn it.
                Seen::Body(_) => own[general + 3 + axis] = e,
            }
        }
        // The columns that are shared do not hold the row's weight, as the factor between the parts does not.
        let root = weight.sqrt();
        let earlier = || before.iter().filter_map(|part| part.shared.as_deref());
        let (sight, arm) = match seen {
            Seen::Target { at, number } => {
                let moved = state.moved(k, &observation.load, *number);
                (state.sight(observation, at), Some(moved.tcp - k.tcp))
            }
            Seen::Body(_) => (Vector3::zeros(), None),
        };
        let mut shared = whitening.shared(&joints[..n], arm);
        let given = Conditional::new(whitening, &whitening.own(seen.part(), sight), &shared, earlier());
        for (c, column) in shared.iter_mut().enumerate() {
            *column = given.times(column, earlier().map(|before| before[c]));
        }
        for (c, column) in own[..general + 6].iter_mut().enumerate() {
            *column = given.times(&(*column * root), before.iter().map(|b| b.own[c]));
        }
        for (c, column) in joints[..n].iter_mut().enumerate() {
            *column = given.times(&(*column * root), before.iter().map(|b| b.joints[c]));
        }
        Self {
            own,
            joints,
            shared: Some(shared),
            trig: k.trig,
            residual: given.times(&(residual * root), before.iter().map(|b| b.residual)),
        }
    }

    /// The leading part of a row.
    #[inline]
    pub(super) fn new(
        state: &State,
        layout: &Layout,
        observation: &Prepared,
        whitening: &Whitening,
        weight: f64,
    ) -> Self {
        let n = layout.n;
        let general = layout.general();
        let mut own = [Vector3::zeros(); OWN];
        let mut joints = [Vector3::zeros(); N];
        let kinematics = state.at(observation);
        state.columns(layout, &kinematics, &observation.load, &mut own, &mut joints);
        layout.lead(observation.lead, &mut own);
        own[layout.scale()] = state.scale_column(observation.reference, &observation.target);
        let rotation = state
            .bases
            .get(observation.reference)
            .map_or_else(Matrix3::identity, |base| base.rotation);
        let arm = kinematics.tcp - state.pivot(observation.reference);
        for axis in 0..3 {
            // Row `axis` of R₀ is R₀ᵀ e_axis: the reference frame's axis in F0.
            let e = rotation.row(axis).transpose();
            own[general + axis] = e;
            own[general + 3 + axis] = e.cross(&arm);
        }
        let leading = whitening.leading(observation, state.sight(observation, &observation.target));
        let arm = observation.has_several().then(Vector3::zeros);
        let shared = (!observation.further.is_empty()).then(|| whitening.shared(&joints[..n], arm));
        let covariance = match &shared {
            Some(shared) => whitening.covariance(shared, &leading),
            None => whitening.covariance(&joints[..n], &leading),
        };
        let root = Root::new(&covariance);
        let shared = shared.map(|columns| columns.iter().map(|column| root.times(column)).collect());
        let root = root.scaled(weight.sqrt());
        for column in &mut own[..general + 6] {
            *column = root.times(column);
        }
        for column in &mut joints[..n] {
            *column = root.times(column);
        }
        Self {
            own,
            joints,
            shared,
            trig: kinematics.trig,
            residual: root.times(&state.residual(observation, &kinematics.tcp)),
        }
    }

    /// Writes `φ_j` of every joint to its slot of `phi`. The joints' waves are turned on together, order by order.
    #[inline]
    pub(super) fn bases<'p>(&self, layout: &Layout, observation: &Prepared, phi: impl Iterator<Item = &'p mut [f64]>) {
        let mut slots: [&mut [f64]; N] = std::array::from_fn(|_| &mut [][..]);
        let mut first = 1;
        for ((slot, phi), moment) in slots.iter_mut().zip(phi).zip(&observation.load.joint) {
            phi[0] = 1.0;
            if layout.stiffness {
                phi[1] = -moment[2];
                first = 2;
            }
            *slot = phi;
        }
        let mut waves = Waves::new(layout.n, &self.trig, [1.0; N]);
        for k in 0..layout.orders {
            let at = first + 2 * k;
            for (slot, (c, s)) in slots.iter_mut().zip(waves.ck.iter().zip(&waves.sk)) {
                if let Some([cosine, sine]) = slot.get_mut(at..at + 2) {
                    (*cosine, *sine) = (*c, *s);
                }
            }
            waves.turn();
        }
    }

    #[inline]
    pub(super) fn add_gradient(&self, layout: &Layout, observation: &Prepared, sum: &mut Gradient) {
        for (to, column) in sum.own.iter_mut().zip(&self.own) {
            *to += column.dot(&self.residual);
        }
        let basis = layout.basis();
        let along = self.joints.map(|joint| joint.dot(&self.residual));
        let mut first = 1;
        for ((to, along), moment) in sum
            .joints
            .chunks_exact_mut(basis)
            .zip(&along)
            .zip(&observation.load.joint)
        {
            to[0] += along;
            if layout.stiffness {
                to[1] -= along * moment[2];
                first = 2;
            }
        }
        let mut waves = Waves::new(layout.n, &self.trig, along);
        for k in 0..layout.orders {
            let at = first + 2 * k;
            for (to, (c, s)) in sum.joints.chunks_exact_mut(basis).zip(waves.ck.iter().zip(&waves.sk)) {
                to[at] += c;
                to[at + 1] += s;
            }
            waves.turn();
        }
    }
}

/// Cosine and sine of one multiple of every joint's angle, times a factor.
struct Waves {
    lanes: usize,
    c: [f64; N],
    s: [f64; N],
    ck: [f64; N],
    sk: [f64; N],
}

impl Waves {
    /// The first multiple.
    #[inline]
    fn new(n: usize, trig: &[(f64, f64); N], factor: [f64; N]) -> Self {
        let (c, s) = (trig.map(|t| t.0), trig.map(|t| t.1));
        Self {
            lanes: lanes(n),
            c,
            s,
            ck: std::array::from_fn(|j| factor[j] * c[j]),
            sk: std::array::from_fn(|j| factor[j] * s[j]),
        }
    }

    /// The next multiple.
    #[inline]
    fn turn(&mut self) {
        for j in 0..self.lanes.min(N) {
            let (ck, sk) = (self.ck[j], self.sk[j]);
            self.ck[j] = ck * self.c[j] - sk * self.s[j];
            self.sk[j] = sk * self.c[j] + ck * self.s[j];
        }
    }
}

/// Gradient of one group: own columns, then the joints' blocks.
pub(super) struct Gradient {
    pub(super) own: Vec<f64>,
    pub(super) joints: Vec<f64>,
}

impl Gradient {
    pub(super) fn new(layout: &Layout) -> Self {
        Self {
            own: vec![0.0; layout.general() + 6],
            joints: vec![0.0; layout.n * layout.basis()],
        }
    }

    pub(super) fn add(&mut self, other: &Self) {
        add_all(&mut self.own, &other.own);
        add_all(&mut self.joints, &other.joints);
    }
}
