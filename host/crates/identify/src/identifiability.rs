//! What the data can determine: the singular values of their whitened Jacobian, parameters with the
//! same effect on the TCP, and the amplification of noise.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::normal::Normal;
use super::parameters::{Kind, Parameter, Unit};

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
    /// Singular values of the columns that remain without the redundant ones.
    pub singular_values: Vec<f64>,
    /// Condition number of the same.
    pub condition: f64,
    /// Parameters whose effect others have too.
    pub redundant: Vec<String>,
    /// Why each is redundant, in words.
    pub dependencies: Vec<String>,
    /// Observability indices O1 to O5 of what is left.
    pub observability: Observability,
    /// The part of a common change of all lengths that the base cannot compensate, relative to its
    /// size. It is near zero if the data do not contain the scale (one sphere, or spheres at
    /// unknown distances).
    pub scale_observability: f64,
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

/// A column is redundant if the previous columns explain it to within this part of its length. The
/// square must stay above the round-off of a sum of squares. 1e-6 is far below what any data
/// determine (condition numbers of 1e2 to 1e4).
const RESOLUTION: f64 = 1e-6;

/// Analyses the data by their normal equations at the nominal state, with weight one for all poses.
/// `table` has the geometry in the order of the equations. If several columns could be named
/// redundant, fixed parameters are named first.
pub(crate) fn analyse(design: &Normal, table: &[Parameter], poses: usize) -> Identifiability {
    let geometric = |kind: &Kind| match *kind {
        Kind::Alpha(i) | Kind::A(i) | Kind::D(i) | Kind::Beta(i) | Kind::Theta(i) => i > 0,
        Kind::Tool(_) | Kind::Target(..) | Kind::Body(_) | Kind::Base(..) => true,
        _ => false,
    };
    let mut order: Vec<usize> = (0..table.len()).filter(|c| geometric(&table[*c].kind)).collect();
    let names: Vec<String> = order.iter().map(|c| table[*c].name.clone()).collect();
    // The last column is explained by the others: fixed ones last, then the distal side, and
    // lengths after angles.
    let last = |c: usize| (!table[c].free, table[c].unit == Unit::Metre, c);
    let base = |c: usize| matches!(table[c].kind, Kind::Base(..));
    order.sort_by_key(|&c| (!base(c), last(c)));
    let norms: Vec<f64> = order.iter().map(|c| design.matrix[(*c, *c)].max(0.0).sqrt()).collect();
    let largest = norms.iter().copied().fold(0.0, f64::max);
    let mut kept: Vec<usize> = Vec::new();
    let mut factor = LowerRows::default();
    let mut redundant = Vec::new();
    for (i, &column) in order.iter().enumerate() {
        let inner: Vec<f64> = kept
            .iter()
            .map(|k| design.matrix[(order[*k], column)] / (norms[*k] * norms[i]).max(1e-300))
            .collect();
        let row = factor.forward(&inner);
        let rest = 1.0 - row.iter().map(|x| x * x).sum::<f64>();
        if norms[i] <= 1e-12 * largest {
            redundant.push((column, Vec::new()));
        } else if rest <= RESOLUTION * RESOLUTION {
            let x = factor.backward(&row);
            let terms = x.iter().zip(&kept).map(|(x, k)| (order[*k], x * norms[i] / norms[*k]));
            let sizes: Vec<f64> = x.iter().map(|x| x.abs()).collect();
            redundant.push((column, significant(terms.collect(), &sizes)));
        } else {
            factor.push(row, rest.sqrt());
            kept.push(i);
        }
    }
    let scale_observability = scale(design, table);
    let mut dependencies: Vec<String> = redundant
        .iter()
        .map(|(column, terms)| {
            let name = |c: usize| (table[c].name.as_str(), table[c].unit);
            let terms: Vec<_> = terms.iter().map(|(c, x)| (name(*c), *x)).collect();
            in_words(name(*column), &terms)
        })
        .collect();
    if scale_observability < SCALE_SEEN {
        dependencies.push("these data do not determine the scale (all lengths together): it stays nominal".to_owned());
    }
    let m = kept.len();
    // Per mm and mrad: a thousandth of per m and rad.
    let gram = DMatrix::from_fn(m, m, |r, c| design.matrix[(order[kept[r]], order[kept[c]])] * 1e-6);
    let mut values: Vec<f64> = gram.symmetric_eigenvalues().iter().map(|v| v.max(0.0).sqrt()).collect();
    values.sort_by(|a, b| b.total_cmp(a));
    let observability = Observability::new(&values, poses);
    Identifiability {
        columns: names.len(),
        rank: m,
        condition: 1.0 / observability.o2,
        redundant: redundant.iter().map(|r| table[r.0].name.clone()).collect(),
        dependencies,
        scale_observability,
        noise_amplification: 1.0 / observability.o3,
        singular_values: values,
        observability,
        names,
    }
}

/// Below this value the data do not contain the scale. Contacts on one sphere give about 0.003,
/// because of the nominal errors; spheres 300 mm apart give 0.2.
const SCALE_SEEN: f64 = 0.02;

/// See [`Identifiability::scale_observability`].
fn scale(design: &Normal, table: &[Parameter]) -> f64 {
    let lengths = |p: &Parameter| match p.kind {
        Kind::A(_) | Kind::D(_) | Kind::Tool(_) => p.nominal,
        _ => 0.0,
    };
    let direction = DVector::from_fn(design.matrix.nrows(), |i, _| table.get(i).map_or(0.0, lengths));
    let image = &design.matrix * &direction;
    let whole = direction.dot(&image);
    let base: Vec<usize> = (0..table.len())
        .filter(|c| matches!(table[*c].kind, Kind::Base(..)))
        .collect();
    let gram = design.matrix.select_rows(&base).select_columns(&base);
    let along = image.select_rows(&base);
    // With one sphere, rotations of the base are undetermined, but the least-squares share is still
    // unique.
    let Ok(inverse) = gram.pseudo_inverse(1e-9) else {
        return 0.0;
    };
    let taken = along.dot(&(inverse * &along));
    if whole > 0.0 {
        ((whole - taken).max(0.0) / whole).sqrt()
    } else {
        0.0
    }
}

/// Rows of a growing lower triangular factor.
#[derive(Default)]
struct LowerRows {
    rows: Vec<Vec<f64>>,
    diagonal: Vec<f64>,
}

impl LowerRows {
    fn forward(&self, b: &[f64]) -> Vec<f64> {
        let mut x: Vec<f64> = Vec::with_capacity(b.len());
        for ((row, diagonal), b) in self.rows.iter().zip(&self.diagonal).zip(b) {
            let known: f64 = row.iter().zip(&x).map(|(l, x)| l * x).sum();
            x.push((b - known) / diagonal);
        }
        x
    }

    fn backward(&self, b: &[f64]) -> Vec<f64> {
        let mut x = b.to_vec();
        for i in (0..x.len()).rev() {
            x[i] /= self.diagonal[i];
            let value = x[i];
            for (x, l) in x.iter_mut().zip(&self.rows[i]) {
                *x -= l * value;
            }
        }
        x
    }

    fn push(&mut self, row: Vec<f64>, diagonal: f64) {
        self.rows.push(row);
        self.diagonal.push(diagonal);
    }
}

/// Terms whose contribution (`sizes`, as parts of the column) exceeds round-off, the largest first.
fn significant(terms: Vec<(usize, f64)>, sizes: &[f64]) -> Vec<(usize, f64)> {
    let mut ranked: Vec<_> = terms.into_iter().zip(sizes).filter(|(_, s)| **s > 1e-5).collect();
    ranked.sort_by(|a, b| b.1.total_cmp(a.1));
    ranked.into_iter().map(|(term, _)| term).collect()
}

/// Says in words how a column follows from others. Factors are in SI units: one unit of the
/// parameter moves the TCP like the stated amount of each other.
pub(crate) fn in_words(name: (&str, Unit), terms: &[((&str, Unit), f64)]) -> String {
    let (name, unit) = name;
    let own = if unit == Unit::Radian { "1 rad" } else { "1 mm" };
    let amount = |other: Unit, x: f64| match (unit, other) {
        (Unit::Radian, Unit::Metre) => format!("{} mm", short(x * 1000.0)),
        (Unit::Metre, Unit::Radian) => format!("{} mrad", short(x)),
        (Unit::Metre, Unit::Metre) => format!("{} mm", short(x)),
        _ => format!("{} rad", short(x)),
    };
    match terms {
        [] => format!("{name} does not move the TCP"),
        [((other, other_unit), x)] => {
            format!(
                "{name} and {other} move the TCP alike: {own} = {}",
                amount(*other_unit, *x)
            )
        }
        many => {
            let list: Vec<String> = many
                .iter()
                .take(5)
                .map(|((other, unit), x)| format!("{} of {other}", amount(*unit, *x)))
                .collect();
            let rest = match many.len() {
                0..=5 => String::new(),
                n => format!(" and {} more", n - 5),
            };
            format!(
                "{name} moves the TCP as others together: {own} = {}{rest}",
                list.join(" + ")
            )
        }
    }
}

/// A number with at most four digits after the point, none of them a trailing zero.
fn short(x: f64) -> String {
    let text = format!("{x:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}
