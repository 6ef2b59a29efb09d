//! The parameters of a model: name, unit, nominal value, prior with its reason, free or fixed; and
//! the column of each.
//!
//! Names follow the paper: row i of the modified DH table has `alpha{i-1}`, `a{i-1}`, `theta{i}`,
//! `d{i}`. A joint whose axis is nearly parallel to the previous one has Hayati's `beta{i-1}`
//! instead of `d{i}`.
//!
//! Some parameters are fixed by default, because others have the same effect on the TCP: the four
//! of row 1 (the base), the last `theta` and `d` (the tool). A 7-axis robot keeps 22 link
//! parameters, 3 of the tool and 6 of the base: 31.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};
use spherecal_shared::robot::Robot;

use super::targets::{Reference, reference_of};
use spherecal_model::{Experiment, Target};

/// Axes closer to parallel than this use Hayati's beta, in rad.
pub const PARALLEL_RAD: f64 = 0.2;

/// Unit of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Unit {
    /// Metre.
    #[serde(rename = "m")]
    Metre,
    /// Radian.
    #[serde(rename = "rad")]
    Radian,
    /// Radian per newton metre.
    #[serde(rename = "rad/(N m)")]
    RadianPerNewtonMetre,
    /// A ratio.
    #[serde(rename = "1")]
    One,
}

impl Unit {
    /// As printed.
    pub const fn symbol(self) -> &'static str {
        match self {
            Self::Metre => "m",
            Self::Radian => "rad",
            Self::RadianPerNewtonMetre => "rad/(N m)",
            Self::One => "1",
        }
    }
}

/// The quantity of a model's column. Joints and rows count from 0 here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Twist of a row.
    Alpha(usize),
    /// Length of a row.
    A(usize),
    /// Offset along the joint axis.
    D(usize),
    /// Hayati's rotation of a row.
    Beta(usize),
    /// TCP in the flange frame.
    Tool(usize),
    /// Further target in the flange frame: target 2.. from 0, axis.
    Target(usize, usize),
    /// Rotation of the measured body about x, y or z of the flange frame.
    Body(usize),
    /// Bending of the link at a joint about x (0) or y (1) of its frame.
    Bending(usize, usize),
    /// Tilt of the base about x (0) or y (1) of F0.
    Tilt(usize),
    /// Offset of the joint angle.
    Theta(usize),
    /// Joint compliance.
    Compliance(usize),
    /// Encoder harmonic: joint, order, cosine part.
    Cosine(usize, usize),
    /// Encoder harmonic: joint, order, sine part.
    Sine(usize, usize),
    /// Base in a reference frame: frame, axis 0-2 position, 3-5 rotation.
    Base(usize, usize),
    /// Sphere's position within its certificate: index, axis.
    Sphere(usize, usize),
    /// Scale of the measured points or of the certificate, about their mean: measured over true, minus one.
    Scale,
    /// Where a sphere sat in some rows, seen from the TCP, in the flange frame: index, axis.
    Seat(usize, usize),
}

/// One row of the table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Parameter {
    /// Name, unique in the model.
    pub name: String,
    /// Its quantity.
    pub kind: Kind,
    /// Unit of all its values.
    pub unit: Unit,
    /// Value before the data; base entries take theirs from a first fit.
    pub nominal: f64,
    /// Standard deviation before the data are seen.
    pub prior_sigma: f64,
    /// Whether it is estimated.
    pub free: bool,
    /// Whether the user set the prior, which is then not widened.
    pub set_by_user: bool,
    /// Reason of the prior, or why the parameter is fixed.
    pub reason: &'static str,
}

/// The user's settings for one parameter, or for a group named by its letters (`alpha`,
/// `compliance`, `harmonic`, `sphere` ...).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Override {
    /// Nominal value, in the parameter's SI unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nominal: Option<f64>,
    /// Standard deviation of the prior, in the parameter's SI unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prior_sigma: Option<f64>,
    /// Estimated (`true`) or held at its nominal value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub free: Option<bool>,
    /// Whether the prior is only the ordinary size, as a robot's description states it: the data find the actual one. No
    /// user sets it.
    #[serde(skip)]
    pub open: bool,
}

/// Overrides by name: in TOML a table, as in
/// `[parameters.compliance]` / `prior_sigma = 5e-5`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(transparent)]
pub struct Overrides(pub BTreeMap<String, Override>);

impl Overrides {}

/// The column of each parameter.
///
/// `general | per joint: theta, compliance, cos 1, sin 1, ... | base 6 per frame | 3 per sphere | 3 per seat`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Layout {
    /// Joints.
    pub(crate) n: usize,
    /// Harmonic orders.
    pub(crate) orders: usize,
    /// Whether compliance and bending have columns.
    pub(crate) stiffness: bool,
    /// Whether row i has beta in place of d.
    pub(crate) hayati: Vec<bool>,
    /// Frames that targets are given in.
    pub(crate) references: Vec<Reference>,
    /// Ids of the spheres that have columns.
    pub(crate) spheres: Vec<u32>,
    /// Numbers of the seats that have columns.
    #[serde(default)]
    pub(crate) seats: Vec<u32>,
    /// Targets on the tool: the TCP and those that have columns of their own.
    pub(crate) targets: usize,
    /// Whether the orientation of the measured body has columns.
    pub(crate) body: bool,
}

impl Layout {
    pub(crate) fn new(experiment: &Experiment, orders: usize, stiffness: bool) -> Self {
        let mut references = BTreeSet::new();
        let mut spheres = BTreeSet::new();
        let mut seats = BTreeSet::new();
        let mut last = None;
        let (mut targets, mut body) = (1, false);
        for observation in &experiment.observations {
            match &observation.target {
                Target::Points(all) => targets = targets.max(all.len()),
                Target::Frame(_) => body = true,
                Target::Point(_) | Target::Sphere { .. } => {}
            }
            seats.extend(observation.seat);
            let reference = reference_of(&observation.target);
            let sphere = match observation.target {
                Target::Sphere { sphere, .. } => Some(sphere),
                _ => None,
            };
            if last != Some((reference, sphere)) {
                references.insert(reference);
                spheres.extend(sphere);
                last = Some((reference, sphere));
            }
        }
        Self {
            n: experiment.robot.dof(),
            orders,
            stiffness,
            hayati: hayati(&experiment.robot),
            references: references.into_iter().collect(),
            spheres: spheres.into_iter().collect(),
            seats: seats.into_iter().collect(),
            targets,
            body,
        }
    }

    /// Columns before the joint blocks.
    pub(crate) fn general(&self) -> usize {
        self.scale() + 1
    }

    /// First column of target `further` (target 2.. from 0).
    pub(crate) fn target(&self, further: usize) -> usize {
        3 * self.n + 3 + if self.stiffness { 2 * self.n + 2 } else { 0 } + 3 * further
    }

    /// First column of the measured body's orientation.
    pub(crate) fn body(&self) -> Option<usize> {
        self.body.then(|| self.target(self.targets.saturating_sub(1)))
    }

    /// Column of the scale.
    pub(crate) fn scale(&self) -> usize {
        self.target(self.targets.saturating_sub(1)) + if self.body { 3 } else { 0 }
    }

    /// Columns per joint.
    pub(crate) fn basis(&self) -> usize {
        1 + usize::from(self.stiffness) + 2 * self.orders
    }

    pub(crate) fn bending(&self, joint: usize) -> usize {
        3 * self.n + 3 + 2 * joint
    }

    pub(crate) fn tilt(&self) -> usize {
        5 * self.n + 3
    }

    pub(crate) fn joint(&self, joint: usize) -> usize {
        self.general() + joint * self.basis()
    }

    pub(crate) fn base(&self, reference: usize) -> usize {
        self.joint(self.n) + 6 * reference
    }

    pub(crate) fn sphere(&self, sphere: usize) -> usize {
        self.base(self.references.len()) + 3 * sphere
    }

    pub(crate) fn seat(&self, seat: usize) -> usize {
        self.sphere(self.spheres.len()) + 3 * seat
    }

    pub(crate) fn len(&self) -> usize {
        self.seat(self.seats.len())
    }

    /// The kinds in column order.
    pub(crate) fn kinds(&self) -> Vec<Kind> {
        let mut kinds = Vec::with_capacity(self.len());
        for row in 0..self.n {
            let third = if self.hayati[row] {
                Kind::Beta(row)
            } else {
                Kind::D(row)
            };
            kinds.extend([Kind::Alpha(row), Kind::A(row), third]);
        }
        kinds.extend((0..3).map(Kind::Tool));
        if self.stiffness {
            kinds.extend((0..self.n).flat_map(|j| [Kind::Bending(j, 0), Kind::Bending(j, 1)]));
            kinds.extend([Kind::Tilt(0), Kind::Tilt(1)]);
        }
        kinds.extend((1..self.targets).flat_map(|t| (0..3).map(move |k| Kind::Target(t - 1, k))));
        if self.body {
            kinds.extend((0..3).map(Kind::Body));
        }
        kinds.push(Kind::Scale);
        for joint in 0..self.n {
            kinds.push(Kind::Theta(joint));
            if self.stiffness {
                kinds.push(Kind::Compliance(joint));
            }
            kinds.extend((1..=self.orders).flat_map(|k| [Kind::Cosine(joint, k), Kind::Sine(joint, k)]));
        }
        kinds.extend((0..self.references.len()).flat_map(|f| (0..6).map(move |k| Kind::Base(f, k))));
        kinds.extend((0..self.spheres.len()).flat_map(|s| (0..3).map(move |k| Kind::Sphere(s, k))));
        kinds.extend((0..self.seats.len()).flat_map(|s| (0..3).map(move |k| Kind::Seat(s, k))));
        kinds
    }
}

/// Rows whose axis is nearly parallel to the previous one.
pub(crate) fn hayati(robot: &Robot) -> Vec<bool> {
    robot
        .joints
        .iter()
        .enumerate()
        .map(|(row, joint)| row > 0 && joint.mdh.alpha.sin().abs() < PARALLEL_RAD.sin())
        .collect()
}

const AXES: [&str; 3] = ["x", "y", "z"];

/// Name and unit of a parameter.
pub(crate) fn name_of(kind: Kind, layout: &Layout) -> (String, Unit) {
    let axis = |k: usize| AXES.get(k).copied().unwrap_or("?");
    match kind {
        Kind::Alpha(i) => (format!("alpha{i}"), Unit::Radian),
        Kind::A(i) => (format!("a{i}"), Unit::Metre),
        Kind::Beta(i) => (format!("beta{i}"), Unit::Radian),
        Kind::D(i) => (format!("d{}", i + 1), Unit::Metre),
        Kind::Theta(i) => (format!("theta{}", i + 1), Unit::Radian),
        Kind::Tool(k) => (format!("tool_{}", axis(k)), Unit::Metre),
        Kind::Target(t, k) => (format!("target{}_{}", t + 2, axis(k)), Unit::Metre),
        Kind::Body(k) => (format!("orientation_r{}", axis(k)), Unit::Radian),
        Kind::Bending(i, k) => (format!("bending{}_{}", i + 1, axis(k)), Unit::RadianPerNewtonMetre),
        Kind::Scale => ("scale".to_owned(), Unit::One),
        Kind::Tilt(k) => (format!("tilt_{}", axis(k)), Unit::RadianPerNewtonMetre),
        Kind::Compliance(i) => (format!("compliance{}", i + 1), Unit::RadianPerNewtonMetre),
        Kind::Cosine(i, k) => (format!("harmonic{}_cos{k}", i + 1), Unit::Radian),
        Kind::Sine(i, k) => (format!("harmonic{}_sin{k}", i + 1), Unit::Radian),
        Kind::Base(f, k) => {
            let frame = match layout.references.get(f) {
                _ if f == 0 => "base".to_owned(),
                Some(Reference::Place(place)) => format!("base_place{place}"),
                _ => "base_tracker".to_owned(),
            };
            if k < 3 {
                (format!("{frame}_{}", axis(k)), Unit::Metre)
            } else {
                (format!("{frame}_r{}", axis(k - 3)), Unit::Radian)
            }
        }
        Kind::Sphere(s, k) => {
            let id = layout.spheres.get(s).copied().unwrap_or_default();
            (format!("sphere{id}_{}", axis(k)), Unit::Metre)
        }
        Kind::Seat(s, k) => {
            let number = layout.seats.get(s).copied().unwrap_or_default();
            (format!("seat{number}_{}", axis(k)), Unit::Metre)
        }
    }
}
