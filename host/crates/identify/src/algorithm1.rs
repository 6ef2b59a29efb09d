//! Algorithm 1 of the paper: finds redundant parameters by removing columns of the position
//! Jacobian; as printed, and corrected.
//!
//! As printed, it compares condition numbers of singular matrices, which are round-off, and never
//! resets its minimum. So its result depends on chance, and it can get stuck. The corrected form
//! takes the rank from the column-normalised matrix with a stated tolerance. It compares candidates
//! by the condition number of the remaining matrix (`σ₁/σ_rank`). Among near ties it removes
//! lengths before angles, and distal parameters first.

use nalgebra::{DMatrix, Vector3};
use serde::{Deserialize, Serialize};
use spherecal_shared::robot::{Robot, Tool};

use super::chain::{N, OWN, State};
use super::load::HoldingMoments;
use super::parameters::{Kind, Layout, Unit, hayati, name_of};

/// Relative tolerance of the rank, on columns of unit length.
pub const RANK_TOLERANCE: f64 = 1e-9;
/// Condition numbers closer than this are a tie.
const TIE: f64 = 1.05;

/// In which units the columns are compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Scaling {
    /// Millimetre per millimetre and per radian, as the paper.
    #[default]
    Millimetre,
    /// Metre per metre and per radian.
    Metre,
    /// Every column of unit length.
    Column,
}

/// A labelled Jacobian: three rows per configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct Jacobian {
    /// Columns in mm per mm or mm per rad.
    pub matrix: DMatrix<f64>,
    /// Name of each column.
    pub names: Vec<String>,
    /// Unit of each column's parameter.
    pub units: Vec<Unit>,
}

/// What is left, and what was taken out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reduction {
    /// Columns at the start.
    pub columns: usize,
    /// Rank, which is also the number of columns left (unless the algorithm got stuck).
    pub rank: usize,
    /// Names taken out, in order.
    pub removed: Vec<String>,
    /// Names left.
    pub kept: Vec<String>,
    /// Condition number of the remaining matrix, in the requested units.
    pub condition: f64,
    /// Whether the printed algorithm got stuck (its minimum never improved).
    pub stuck: bool,
}

/// Which columns a position Jacobian has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Columns {
    /// The first row's four too.
    pub first_row: bool,
    /// The tool's three.
    pub tool: bool,
    /// The base's six (positions, then rotations).
    pub base: bool,
}

/// Position Jacobian of a robot at configurations `q` (rad), in mm and rad.
pub fn position_jacobian(robot: &Robot, tool: &Tool, q: &[Vec<f64>], columns: Columns) -> Jacobian {
    let n = robot.dof().min(N);
    let layout = Layout {
        n,
        orders: 0,
        stiffness: false,
        hayati: hayati(robot),
        references: vec![super::targets::Reference::Tracker],
        spheres: Vec::new(),
        seats: Vec::new(),
        targets: 1,
        body: false,
    };
    let state = State::nominal(robot, tool, &layout);
    // By rows, as in the paper's table: alpha, a, theta, d (or beta).
    let mut kinds = Vec::new();
    for i in usize::from(!columns.first_row)..n {
        let third = if layout.hayati[i] { Kind::Beta(i) } else { Kind::D(i) };
        kinds.extend([Kind::Alpha(i), Kind::A(i), Kind::Theta(i), third]);
    }
    if columns.tool {
        kinds.extend((0..3).map(Kind::Tool));
    }
    if columns.base {
        kinds.extend((0..6).map(|k| Kind::Base(0, k)));
    }
    let (names, units): (Vec<_>, Vec<_>) = kinds.iter().map(|k| name_of(*k, &layout)).unzip();
    let mut matrix = DMatrix::zeros(3 * q.len(), kinds.len());
    let mut general = [Vector3::zeros(); OWN];
    let mut joints = [Vector3::zeros(); N];
    for (row, q) in q.iter().enumerate() {
        let mut angles = [0.0; N];
        for (slot, angle) in angles.iter_mut().zip(q) {
            *slot = *angle;
        }
        let load = HoldingMoments::default();
        let k = state.evaluate(&angles, &load);
        state.columns(&layout, &k, &load, &mut general, &mut joints);
        for (c, kind) in kinds.iter().enumerate() {
            let column = match *kind {
                Kind::Alpha(i) => general[3 * i],
                Kind::A(i) => general[3 * i + 1],
                Kind::D(i) | Kind::Beta(i) => general[3 * i + 2],
                Kind::Theta(i) => joints[i],
                Kind::Tool(axis) => general[3 * n + axis],
                Kind::Base(_, axis) if axis < 3 => Vector3::ith(axis, 1.0),
                Kind::Base(_, axis) => Vector3::ith(axis - 3, 1.0).cross(&k.tcp),
                _ => Vector3::zeros(),
            };
            let scale = if units[c] == Unit::Radian { 1000.0 } else { 1.0 };
            matrix.fixed_view_mut::<3, 1>(3 * row, c).copy_from(&(column * scale));
        }
    }
    Jacobian { matrix, names, units }
}

/// Singular values, largest first.
pub(crate) fn singular_values(matrix: &DMatrix<f64>) -> Vec<f64> {
    if matrix.ncols() == 0 || matrix.nrows() == 0 {
        return Vec::new();
    }
    let mut values: Vec<f64> = matrix.singular_values().iter().copied().collect();
    values.sort_by(|a, b| b.total_cmp(a));
    values
}

/// The triangular factor: same singular values for every subset of columns.
pub(crate) fn compress(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    if matrix.nrows() > matrix.ncols() {
        matrix.clone().qr().r()
    } else {
        matrix.clone()
    }
}

/// Every column at unit length; zero columns stay.
pub(crate) fn normalised(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let mut scaled = matrix.clone();
    let largest = matrix.column_iter().map(|c| c.norm()).fold(0.0, f64::max);
    for mut column in scaled.column_iter_mut() {
        let norm = column.norm();
        if norm > largest * 1e-12 {
            column /= norm;
        } else {
            column.fill(0.0);
        }
    }
    scaled
}

/// Rank of the column-normalised matrix, relative tolerance [`RANK_TOLERANCE`].
pub(crate) fn rank(matrix: &DMatrix<f64>) -> usize {
    let values = singular_values(&normalised(matrix));
    let largest = values.first().copied().unwrap_or_default();
    values
        .iter()
        .filter(|s| **s > RANK_TOLERANCE * largest.max(1e-300))
        .count()
}

fn scaled(jacobian: &Jacobian, scaling: Scaling) -> DMatrix<f64> {
    let mut matrix = compress(&jacobian.matrix);
    match scaling {
        Scaling::Millimetre => {}
        Scaling::Metre => {
            for (mut column, unit) in matrix.column_iter_mut().zip(&jacobian.units) {
                if *unit == Unit::Radian {
                    column /= 1000.0;
                }
            }
        }
        Scaling::Column => matrix = normalised(&matrix),
    }
    matrix
}

fn finish(jacobian: &Jacobian, matrix: &DMatrix<f64>, kept: &[usize], removed: &[usize], rank: usize) -> Reduction {
    let names = |of: &[usize]| of.iter().map(|i| jacobian.names[*i].clone()).collect();
    let values = singular_values(&matrix.select_columns(kept));
    let smallest = values.get(rank.saturating_sub(1)).copied().unwrap_or_default();
    Reduction {
        columns: jacobian.names.len(),
        rank,
        removed: names(removed),
        kept: names(kept),
        condition: values.first().copied().unwrap_or_default() / smallest,
        stuck: kept.len() > rank,
    }
}

/// Algorithm 1, corrected: the same answer for every draw of configurations.
pub fn reduce(jacobian: &Jacobian, scaling: Scaling) -> Reduction {
    let matrix = scaled(jacobian, scaling);
    let mut kept: Vec<usize> = (0..matrix.ncols()).collect();
    let mut removed = Vec::new();
    let full = rank(&matrix);
    while kept.len() > full {
        let mut candidates: Vec<(usize, f64)> = Vec::new();
        for &column in &kept {
            let rest: Vec<usize> = kept.iter().copied().filter(|c| *c != column).collect();
            let view = matrix.select_columns(&rest);
            if rank(&view) == full {
                let values = singular_values(&view);
                let condition = values[0] / values[full - 1];
                candidates.push((column, condition));
            }
        }
        let best = candidates.iter().map(|c| c.1).fold(f64::INFINITY, f64::min);
        let is_length = |c: usize| jacobian.units[c] == Unit::Metre;
        let Some((column, _)) = candidates
            .into_iter()
            .filter(|c| c.1 <= best * TIE)
            .max_by_key(|c| (is_length(c.0), c.0))
        else {
            break;
        };
        kept.retain(|c| *c != column);
        removed.push(column);
    }
    finish(jacobian, &matrix, &kept, &removed, full)
}

/// Algorithm 1 exactly as printed, with its round-off and its minimum that is never reset: for
/// comparison only.
pub fn reduce_as_printed(jacobian: &Jacobian, scaling: Scaling) -> Reduction {
    let matrix = scaled(jacobian, scaling);
    // The usual numerical rank: σ > max(rows, columns) ε σ₁.
    let measure = |m: &DMatrix<f64>| {
        let values = singular_values(m);
        let largest = values.first().copied().unwrap_or_default();
        let floor = jacobian.matrix.nrows().max(m.ncols()) as f64 * f64::EPSILON * largest;
        let rank = values.iter().filter(|s| **s > floor).count();
        (rank, largest / values.last().copied().unwrap_or_default())
    };
    let mut kept: Vec<usize> = (0..matrix.ncols()).collect();
    let mut removed = Vec::new();
    let (full, mut smallest) = measure(&matrix);
    while kept.len() > full {
        let mut remove = None;
        for &column in &kept {
            let rest: Vec<usize> = kept.iter().copied().filter(|c| *c != column).collect();
            let (r, condition) = measure(&matrix.select_columns(&rest));
            if r == full && condition < smallest {
                smallest = condition;
                remove = Some(column);
            }
        }
        let Some(column) = remove else { break };
        kept.retain(|c| *c != column);
        removed.push(column);
    }
    finish(jacobian, &matrix, &kept, &removed, full)
}
