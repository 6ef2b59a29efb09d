//! Rows of the model for poses that are only planned: what an observation would
//! tell ([`DesignModel::observation`]) and what a prediction needs
//! ([`DesignModel::prediction`]), in the very columns that
//! [`map`](super::Method::Full) estimates.
//!
//! Columns are scaled by their prior's sigma, so that the prior's information
//! is the identity, and rows are whitened by the noise.

use nalgebra::Vector3;
use spherecal_shared::robot::{Robot, Tool};

use super::chain::{N, OWN, Prepared, State, trig};
use super::error::IdentifyError;
use super::load::Nominal;
use super::normal::{Own, Root, Whitening};
use super::options::Options;
use super::parameter_table::table;
use super::parameters::{Kind, Layout};
use spherecal_model::{Experiment, Observation, Set, Sphere, Target};

/// Prior of the base in planning (m and rad): flat enough, and well scaled.
const BASE_SIGMA: f64 = 0.02;

/// Highest harmonic order in planning: what ripples faster differs between neighbouring poses, and no choice of poses finds it.
/// With 30 in place of 12 the mean error of 24 main jobs is the same (0.235 and 0.233 mm, difference 0.002 ± 0.011), and
/// the plan takes 3.5 s more.
const PLANNED_ORDERS: usize = 12;

/// The structured model at the nominal robot, ready to give rows.
#[derive(Clone, Debug)]
pub struct DesignModel {
    layout: Layout,
    nominal: Nominal,
    state: State,
    whitening: Whitening,
    /// Free columns of the layout, and the sigma that scales each.
    free: Vec<(usize, f64)>,
    /// First of the columns that only place the plate and its spheres.
    placing: usize,
}

impl DesignModel {
    /// The model for a robot that touches `spheres` in `places` placements.
    ///
    /// # Errors
    /// What the table of parameters refuses of `options`.
    pub fn new(
        robot: &Robot,
        tool: &Tool,
        spheres: &[Sphere],
        places: u32,
        options: &Options,
    ) -> Result<Self, IdentifyError> {
        let observations = (0..places)
            .flat_map(|place| {
                spheres.iter().map(move |s| Observation {
                    seat: None,
                    q: Vec::new(),
                    tau: None,
                    target: Target::Sphere { sphere: s.id, place },
                    set: Set::Calibrate,
                })
            })
            .collect();
        let experiment = Experiment {
            robot: robot.clone(),
            tool: *tool,
            spheres: spheres.to_vec(),
            observations,
        };
        let nominal = Nominal::new(robot, tool);
        let layout = Layout::new(&experiment, options.harmonics.min(PLANNED_ORDERS), true);
        let table = table(&experiment, &layout, options)?;
        let free = table
            .iter()
            .enumerate()
            .filter(|(_, p)| p.free && p.kind != Kind::Scale)
            .map(|(i, p)| {
                let sigma = match p.kind {
                    Kind::Base(..) => p.prior_sigma.min(BASE_SIGMA),
                    _ => p.prior_sigma,
                };
                (i, sigma)
            })
            .collect();
        Ok(Self {
            placing: layout.base(0),
            state: State::nominal(robot, tool, &layout),
            nominal,
            layout,
            whitening: Whitening::new(&options.noise),
            free,
        })
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.free.len()
    }

    /// Rows of a pose on a sphere: 3 x columns, row by row, whitened and scaled.
    pub fn observation(&self, q: &[f64], sphere: u32, place: usize) -> Vec<f64> {
        let (mut columns, joints, tcp) = self.position(q);
        for axis in 0..3 {
            let e = Vector3::ith(axis, 1.0);
            columns[self.layout.base(place) + axis] = e;
            columns[self.layout.base(place) + 3 + axis] = e.cross(&tcp);
            if let Some(s) = self.layout.spheres.iter().position(|id| *id == sphere) {
                columns[self.layout.sphere(s) + axis] = -e;
            }
        }
        let root = Root::new(&self.whitening.covariance(&joints, &Own::alike(self.whitening.seating)));
        self.picked(|c| root.times(&columns[c]))
    }

    /// Rows of the TCP's prediction in F0, 3 x columns, row by row, in m per
    /// prior sigma (the base's columns are zero); the TCP itself, in m; and the
    /// variance (trace) of the joint noise of one pose, in m².
    pub fn prediction(&self, q: &[f64]) -> (Vec<f64>, Vector3<f64>, f64) {
        let (columns, joints, tcp) = self.position(q);
        let zero = Vector3::zeros();
        let rows = self.picked(|c| if c < self.placing { columns[c] } else { zero });
        let noise: f64 = joints.iter().map(Vector3::norm_squared).sum();
        (rows, tcp, noise * self.whitening.joint)
    }

    fn picked(&self, column: impl Fn(usize) -> Vector3<f64>) -> Vec<f64> {
        let m = self.free.len();
        let mut rows = vec![0.0; 3 * m];
        for (slot, (c, sigma)) in self.free.iter().enumerate() {
            let v = column(*c) * *sigma;
            (rows[slot], rows[m + slot], rows[2 * m + slot]) = (v.x, v.y, v.z);
        }
        rows
    }

    /// All columns of the TCP in F0 (base and spheres zero), the joints' own, and the TCP.
    fn position(&self, q: &[f64]) -> (Vec<Vector3<f64>>, Vec<Vector3<f64>>, Vector3<f64>) {
        let layout = &self.layout;
        let mut padded = [0.0; N];
        for (slot, angle) in padded.iter_mut().zip(q) {
            *slot = *angle;
        }
        let observation = Prepared {
            index: 0,
            q: padded,
            trig: trig(&padded),
            load: self.nominal.load(q, None),
            lead: 0,
            target: Vector3::zeros(),
            sighted: false,
            further: Box::default(),
            reference: 0,
            sphere: None,
            seat: None,
        };
        let k = self.state.at(&observation);
        let mut general = [Vector3::zeros(); OWN];
        let mut joints = [Vector3::zeros(); N];
        self.state
            .columns(layout, &k, &observation.load, &mut general, &mut joints);
        let mut columns = vec![Vector3::zeros(); layout.len()];
        columns[..layout.general()].copy_from_slice(&general[..layout.general()]);
        for (j, along) in joints.iter().enumerate().take(layout.n) {
            let mut at = layout.joint(j);
            let mut put = |value: f64| {
                columns[at] = along * value;
                at += 1;
            };
            put(1.0);
            if layout.stiffness {
                put(-observation.load.joint[j][2]);
            }
            let (c, s) = k.trig[j];
            let (mut ck, mut sk) = (c, s);
            for _ in 0..layout.orders {
                put(ck);
                put(sk);
                (ck, sk) = (ck * c - sk * s, sk * c + ck * s);
            }
        }
        (columns, joints[..layout.n].to_vec(), k.tcp)
    }
}
