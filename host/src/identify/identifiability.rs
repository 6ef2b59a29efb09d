//! What the data at hand can tell: the singular values of their whitened
//! Jacobian, which parameters move the TCP alike, and how noise is amplified.

use nalgebra::{DMatrix, Vector3};
use serde::{Deserialize, Serialize};

use super::algorithm1::{normalised, rank, singular_values};
use super::chain::{N, Prepared, State};
use super::normal::{Root, Whitening};
use super::parameters::{Kind, Layout, Parameter, Unit};

/// Result of the analysis, over the geometric parameters: links, tool and base.
///
/// Columns are in mm and mrad, rows whitened by the noise.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Identifiability {
    /// Names of the columns analysed.
    pub names: Vec<String>,
    /// Their number.
    pub columns: usize,
    /// Their rank.
    pub rank: usize,
    /// Singular values of the columns left after the redundant ones are taken out.
    pub singular_values: Vec<f64>,
    /// Condition number of the same.
    pub condition: f64,
    /// Parameters that others stand for.
    pub redundant: Vec<String>,
    /// Why each is redundant, in words.
    pub dependencies: Vec<String>,
    /// Observability indices O1 to O5 of what is left.
    pub observability: Observability,
    /// Largest factor by which the noise of one coordinate enters a parameter:
    /// `1/σ_min`, in mm or mrad per unit of whitened noise.
    pub noise_amplification: f64,
}

/// The five observability indices, from singular values `σ₁ ≥ … ≥ σ_m` and N poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Observability {
    /// `(σ₁…σ_m)^(1/m) / √N`: volume.
    pub o1: f64,
    /// `σ_m/σ₁`: inverse condition number.
    pub o2: f64,
    /// `σ_m`: smallest singular value.
    pub o3: f64,
    /// `σ_m²/σ₁`: noise amplification index.
    pub o4: f64,
    /// `1/Σ(1/σ)`: harmonic mean, over m.
    pub o5: f64,
}

impl Observability {
    /// From singular values (largest first) and the number of poses.
    pub fn new(values: &[f64], poses: usize) -> Self {
        let (Some(first), Some(last)) = (values.first().copied(), values.last().copied()) else {
            return Self::default();
        };
        let m = values.len() as f64;
        let log: f64 = values.iter().map(|s| s.ln()).sum();
        Self {
            o1: (log / m).exp() / (poses.max(1) as f64).sqrt(),
            o2: last / first,
            o3: last,
            o4: last * last / first,
            o5: 1.0 / values.iter().map(|s| 1.0 / s).sum::<f64>(),
        }
    }
}

/// Poses per block of the triangular accumulation.
const CHUNK: usize = 64;

/// Triangular factor of the whitened Jacobian of `columns` (all geometric).
fn triangle(
    state: &State,
    layout: &Layout,
    prepared: &[Prepared],
    whitening: &Whitening,
    columns: &[Kind],
    units: &[Unit],
) -> DMatrix<f64> {
    let m = columns.len();
    let mut r = DMatrix::zeros(0, m);
    let mut general = [Vector3::zeros(); 5 * N + 16];
    let mut joints = [Vector3::zeros(); N];
    for chunk in prepared.chunks(CHUNK) {
        let above = r.nrows();
        let mut stack = DMatrix::zeros(above + 3 * chunk.len(), m);
        stack.rows_mut(0, above).copy_from(&r);
        for (b, observation) in chunk.iter().enumerate() {
            let k = state.evaluate(&observation.q, &observation.load);
            state.columns(layout, &k, &observation.load, &mut general, &mut joints);
            let root = Root::new(&whitening.covariance(&joints[..layout.n], observation.sphere.is_some()));
            for (c, kind) in columns.iter().enumerate() {
                let column = match *kind {
                    Kind::Alpha(i) => general[3 * i],
                    Kind::A(i) => general[3 * i + 1],
                    Kind::D(i) | Kind::Beta(i) => general[3 * i + 2],
                    Kind::Theta(i) => joints[i],
                    Kind::Tool(axis) => general[3 * layout.n + axis],
                    Kind::Base(f, axis) if f == observation.reference => {
                        let rotation = &state.bases[f].rotation;
                        if axis < 3 {
                            rotation.row(axis).transpose()
                        } else {
                            rotation.row(axis - 3).transpose().cross(&(k.tcp - state.pivot(f)))
                        }
                    }
                    _ => continue,
                };
                // SI columns to per mm and per mrad: both a thousandth.
                let scale = if units[c] == Unit::RadianPerNewtonMetre {
                    1.0
                } else {
                    1e-3
                };
                let white = root.times(&column) * scale;
                stack.fixed_view_mut::<3, 1>(above + 3 * b, c).copy_from(&white);
            }
        }
        r = if stack.nrows() > m { stack.qr().r() } else { stack };
    }
    r
}

/// Analyses the data. `table` is the model's; its fixed parameters are the first
/// to be named redundant where a choice is free.
pub(crate) fn analyse(
    state: &State,
    layout: &Layout,
    table: &[Parameter],
    prepared: &[Prepared],
    whitening: &Whitening,
) -> Identifiability {
    let geometric = |kind: &Kind| match *kind {
        Kind::Alpha(i) | Kind::A(i) | Kind::D(i) | Kind::Beta(i) | Kind::Theta(i) => i > 0,
        Kind::Tool(_) | Kind::Base(..) => true,
        _ => false,
    };
    let chosen: Vec<&Parameter> = table.iter().filter(|p| geometric(&p.kind)).collect();
    let kinds: Vec<Kind> = chosen.iter().map(|p| p.kind).collect();
    let units: Vec<Unit> = chosen.iter().map(|p| p.unit).collect();
    let names: Vec<String> = chosen.iter().map(|p| p.name.clone()).collect();
    let r = triangle(state, layout, prepared, whitening, &kinds, &units);
    let scaled = normalised(&r);
    let full = rank(&r);
    let mut kept: Vec<usize> = (0..names.len()).collect();
    let mut redundant = Vec::new();
    // Fixed parameters first, then from the flange inwards, lengths first.
    let mut order: Vec<usize> = kept.clone();
    order.sort_by_key(|&c| (chosen[c].free, units[c] != Unit::Metre, usize::MAX - c));
    for column in order {
        if kept.len() == full {
            break;
        }
        let rest: Vec<usize> = kept.iter().copied().filter(|c| *c != column).collect();
        if rank(&scaled.select_columns(&rest)) == full {
            kept = rest;
            redundant.push(column);
        }
    }
    let values = singular_values(&r.select_columns(&kept));
    let observability = Observability::new(&values, prepared.len());
    Identifiability {
        columns: names.len(),
        rank: full,
        condition: 1.0 / observability.o2,
        redundant: redundant.iter().map(|c| names[*c].clone()).collect(),
        dependencies: redundant
            .iter()
            .map(|c| dependency(&r, &kept, *c, &names, &units))
            .collect(),
        noise_amplification: 1.0 / observability.o3,
        singular_values: values,
        observability,
        names,
    }
}

/// How one column follows from the kept ones, in words.
///
/// `matrix` has columns per mm and mrad (or any unit that is the same for both).
pub(crate) fn dependency(
    matrix: &DMatrix<f64>,
    kept: &[usize],
    column: usize,
    names: &[String],
    units: &[Unit],
) -> String {
    let name = &names[column];
    let basis = matrix.select_columns(kept);
    let target = matrix.column(column).into_owned();
    let scales: Vec<f64> = basis.column_iter().map(|c| c.norm().max(1e-300)).collect();
    let norm = target.norm();
    let largest = scales.iter().copied().fold(0.0, f64::max);
    if norm <= largest * 1e-9 {
        return format!("{name} does not move the TCP");
    }
    let mut unit_basis = basis;
    for (mut c, s) in unit_basis.column_iter_mut().zip(&scales) {
        c /= *s;
    }
    let svd = unit_basis.svd(true, true);
    let Ok(x) = svd.solve(&(target / norm), RANK_SOLVE) else {
        return format!("{name} moves the TCP as a combination of others");
    };
    // Coefficients in the parameters' own units: both columns are per 0.001.
    let mut terms: Vec<(usize, f64)> = (0..kept.len())
        .filter(|&i| x[i].abs() > 1e-6)
        .map(|i| (kept[i], x[i] * norm / scales[i]))
        .collect();
    terms.sort_by(|a, b| {
        (b.1.abs() * scales_of(kept, &scales, b.0)).total_cmp(&(a.1.abs() * scales_of(kept, &scales, a.0)))
    });
    let unit = |c: usize| if units[c] == Unit::Radian { "rad" } else { "m" };
    let amount = |c: usize, value: f64| {
        // 1 rad of this is as so many mm of that; same units need no conversion.
        if units[c] == Unit::Metre && units[column] == Unit::Radian {
            format!("{:.4} mm", value * 1000.0)
        } else if units[c] == Unit::Radian && units[column] == Unit::Metre {
            format!("{value:.4} mrad")
        } else {
            format!("{value:.4} {}", unit(c))
        }
    };
    let own = if units[column] == Unit::Radian { "1 rad" } else { "1 m" };
    let own_small = if units[column] == Unit::Metre { "1 mm" } else { own };
    match terms.as_slice() {
        [] => format!("{name} does not move the TCP"),
        [(c, value)] => {
            let left = if units[*c] == Unit::Radian { own_small } else { own };
            format!(
                "{name} and {} move the TCP alike: {left} = {}",
                names[*c],
                amount(*c, *value)
            )
        }
        many => {
            let list: Vec<String> = many
                .iter()
                .take(5)
                .map(|(c, value)| format!("{} of {}", amount(*c, *value), names[*c]))
                .collect();
            let rest = if many.len() > 5 {
                format!(" and {} more", many.len() - 5)
            } else {
                String::new()
            };
            format!(
                "{name} moves the TCP as others together: {own} = {}{rest}",
                list.join(" + ")
            )
        }
    }
}

const RANK_SOLVE: f64 = 1e-10;

fn scales_of(kept: &[usize], scales: &[f64], column: usize) -> f64 {
    kept.iter()
        .position(|c| *c == column)
        .and_then(|i| scales.get(i))
        .copied()
        .unwrap_or_default()
}
