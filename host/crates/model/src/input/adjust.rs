//! Corrections of a table that was recorded in other terms than the robot's: signs, order, zeros, couplings and units of
//! the joint columns; units, handedness, direction and order of the measurements.
//!
//! ```text
//!   columns ─ unit ─ order ─ couple ─ flip ─ zero ─▶ joint angles    (linear: q = M c + z)
//!   points  ─ unit ─ mirror ─ invert ─ shift ──────▶ targets
//! ```
//!
//! Joints are counted from 0 here, and from 1 in words.

use nalgebra::{DMatrix, DVector, Matrix3, UnitQuaternion, Vector3};

use super::error::InputError;
use super::table::{Table, rotation};
use crate::Target;

/// Corrections of a table; the default changes nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct Adjustments {
    /// Factor of each joint column; a missing one is 1.
    pub units: Vec<f64>,
    /// The column that each joint is taken from; empty for the table's own order.
    pub order: Vec<usize>,
    /// Joints that are sums of others: `q[joint] = Σ factor · q[other]`.
    pub couples: Vec<(usize, Vec<(usize, f64)>)>,
    /// Joints that count the other way.
    pub flips: Vec<usize>,
    /// Angles (rad) to add to joints.
    pub zeros: Vec<(usize, f64)>,
    /// Factor of the measured points.
    pub point_factor: f64,
    /// The points are given in a left-handed frame: their y counts the other way.
    pub mirror: bool,
    /// The poses are those of the instrument in the frame of the body.
    pub invert: bool,
    /// Rows by which the measurements lag behind their joint angles; parts of a row where the rows are a stream.
    pub shift: f64,
}

impl Default for Adjustments {
    fn default() -> Self {
        Self {
            units: Vec::new(),
            order: Vec::new(),
            couples: Vec::new(),
            flips: Vec::new(),
            zeros: Vec::new(),
            point_factor: 1.0,
            mirror: false,
            invert: false,
            shift: 0.0,
        }
    }
}

/// The mirror of a left-handed frame: y counts the other way.
fn mirror() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0))
}

/// Values at a place between the rows of a stream: a cubic whose slope at a row is that between the rows beside it. `None`
/// before the first row and behind the last.
pub fn between<'a>(row: &dyn Fn(usize) -> Option<&'a [f64]>, at: f64) -> Option<Vec<f64>> {
    if !(at >= 0.0) {
        return None;
    }
    let (i, f) = (at.floor() as usize, at.fract());
    let here = row(i)?;
    if f == 0.0 {
        return Some(here.to_vec());
    }
    let next = row(i + 1)?;
    let (before, behind) = (i.checked_sub(1).and_then(row), row(i + 2));
    let value = |(k, (a, b)): (usize, (&f64, &f64))| {
        let half = |from: Option<f64>, to: Option<f64>| Some(0.5 * (to? - from?));
        let of = |row: Option<&[f64]>| row.and_then(|row| row.get(k)).copied();
        let out = half(of(before), Some(*b)).unwrap_or(b - a);
        let into = half(Some(*a), of(behind)).unwrap_or(b - a);
        let (square, cube) = (f * f, f * f * f);
        a + (b - a) * (3.0 * square - 2.0 * cube) + out * (cube - 2.0 * square + f) + into * (cube - square)
    };
    Some(here.iter().zip(next).enumerate().map(value).collect())
}

impl Adjustments {
    /// Whether nothing is changed.
    pub fn is_nothing(&self) -> bool {
        *self == Self::default()
    }

    /// Both, this one first; joints of `then` count as this one leaves them.
    #[must_use]
    pub fn and(&self, then: &Self) -> Self {
        let mut both = self.clone();
        if !then.units.is_empty() {
            both.units.clone_from(&then.units);
        }
        if !then.order.is_empty() {
            both.order.clone_from(&then.order);
        }
        both.couples.extend(then.couples.iter().cloned());
        both.flips.extend(&then.flips);
        both.zeros.extend(&then.zeros);
        both.point_factor *= then.point_factor;
        both.mirror |= then.mirror;
        both.invert |= then.invert;
        both.shift += then.shift;
        both
    }

    /// The largest joint that is named, counted from 1; 0 for none.
    pub fn largest_joint(&self) -> usize {
        let couples = self
            .couples
            .iter()
            .flat_map(|(j, terms)| terms.iter().map(|t| t.0).chain([*j]));
        let all = self
            .order
            .iter()
            .copied()
            .chain(couples)
            .chain(self.flips.iter().copied());
        let units = self.units.len();
        all.chain(self.zeros.iter().map(|z| z.0))
            .map(|j| j + 1)
            .max()
            .unwrap_or(0)
            .max(units)
    }

    /// What is done to the angles of `n` joints but for units and zeros.
    fn mechanism(&self, n: usize) -> DMatrix<f64> {
        let mut map = DMatrix::identity(n, n);
        if self.order.len() == n {
            map = DMatrix::from_fn(n, n, |r, c| f64::from(self.order[r] == c));
        }
        let before = map.clone();
        for (joint, terms) in self.couples.iter().filter(|(j, _)| *j < n) {
            let mut row = before.row(0) * 0.0;
            for (other, factor) in terms.iter().filter(|t| t.0 < n) {
                row += before.row(*other) * *factor;
            }
            map.set_row(*joint, &row);
        }
        for &joint in self.flips.iter().filter(|j| **j < n) {
            map.row_mut(joint).neg_mut();
        }
        map
    }

    /// The joint angles of a robot with `n` joints as `M c + z` of the table's columns `c`: `M` and `z` (rad).
    pub fn joint_map(&self, n: usize) -> (DMatrix<f64>, DVector<f64>) {
        let mut map = self.mechanism(n);
        for (k, mut column) in map.column_iter_mut().enumerate() {
            column *= self.units.get(k).copied().unwrap_or(1.0);
        }
        let mut zero = DVector::zeros(n);
        for &(joint, angle) in self.zeros.iter().filter(|z| z.0 < n) {
            zero[joint] += angle;
        }
        (map, zero)
    }

    /// A measured point (m).
    pub fn point(&self, point: &Vector3<f64>) -> Vector3<f64> {
        let point = point * self.point_factor;
        if self.mirror { mirror() * point } else { point }
    }

    /// A measured frame: rotation and position (m).
    pub fn frame(&self, rotation: &Matrix3<f64>, position: &Vector3<f64>) -> (Matrix3<f64>, Vector3<f64>) {
        let at = self.point(position);
        let turn = if self.mirror {
            mirror() * rotation * mirror()
        } else {
            *rotation
        };
        if self.invert {
            let back = turn.transpose();
            (back, -(back * at))
        } else {
            (turn, at)
        }
    }

    /// Refuses a correction that does not reach every row: of points that a row does not have, or of orientations.
    fn check(&self, table: &Table) -> Result<(), InputError> {
        let refuse = |option: &str, value: String, remedy: &str| {
            Err(InputError::Field {
                file: table.file.clone(),
                field: option.to_owned(),
                value,
                remedy: remedy.to_owned(),
            })
        };
        let turned = table
            .rows()
            .filter(|row| matches!(row.target(), Target::Frame(_)))
            .count();
        if self.invert && turned < table.len() {
            return refuse(
                "--invert-poses",
                format!("for {} rows of which {turned} have an orientation", table.len()),
                "a point alone cannot be inverted: give the orientation of every pose, or leave the other rows out",
            );
        }
        let placed = table.rows().any(|row| !matches!(row.target(), Target::Sphere { .. }));
        for (given, option) in [
            (self.point_factor != 1.0, "--point-factor"),
            (self.mirror, "--mirror-points"),
        ] {
            if given && !placed {
                return refuse(
                    option,
                    "for rows of contacts".to_owned(),
                    "it corrects measured points: leave it out",
                );
            }
        }
        // Not a number is refused, too.
        if !(self.shift.abs() < table.len() as f64) {
            return refuse(
                "--shift-rows",
                format!("{} for {} rows", self.shift, table.len()),
                "shift by fewer rows than the table has",
            );
        }
        Ok(())
    }

    /// Corrects a table.
    ///
    /// # Errors
    /// Poses to invert without orientations, points to correct where there are none, and a shift beyond the last row.
    pub fn apply(&self, table: &mut Table) -> Result<(), InputError> {
        self.check(table)?;
        let n = table.joints;
        let (map, zero) = self.joint_map(n);
        // Torques do the same work on the joints as on the columns.
        let torques = self.mechanism(n).transpose().try_inverse();
        for q in table.q.chunks_exact_mut(n.max(1)) {
            let joints = &map * DVector::from_column_slice(q) + &zero;
            q.copy_from_slice(joints.as_slice());
        }
        for tau in table.tau.chunks_exact_mut(n.max(1)) {
            if let Some(torques) = &torques {
                let joints = torques * DVector::from_column_slice(tau);
                tau.copy_from_slice(joints.as_slice());
            }
        }
        let turn = self.mirror || self.invert;
        for (k, fields) in table.fields.iter_mut().enumerate() {
            let at = Vector3::from(fields.point);
            fields.point = match table.orientations.get_mut(4 * k..4 * k + 4) {
                Some(quaternion) if turn => {
                    let [w, x, y, z] = [quaternion[0], quaternion[1], quaternion[2], quaternion[3]];
                    let (r, p) = self.frame(&rotation(w, x, y, z), &at);
                    let q = UnitQuaternion::from_matrix(&r);
                    quaternion.copy_from_slice(&[q.w, q.i, q.j, q.k]);
                    p
                }
                _ => self.point(&at),
            }
            .into();
        }
        for point in table.points.chunks_exact_mut(3) {
            let moved = self.point(&Vector3::new(point[0], point[1], point[2]));
            point.copy_from_slice(moved.as_slice());
        }
        self.shift_rows(table);
        Ok(())
    }

    /// The rows of a table with `count` rows whose measurements have joint angles after the shift: the first, and how many.
    pub fn shifted_rows(&self, count: usize) -> (usize, usize) {
        let last = count.saturating_sub(1) as f64;
        let (first, end) = (self.shift.ceil().max(0.0), (last + self.shift).floor().min(last) + 1.0);
        (first as usize, (end - first).max(0.0) as usize)
    }

    /// Gives each measurement the joint angles of an earlier row (a later one for a negative shift); rows without are left
    /// out.
    fn shift_rows(&self, table: &mut Table) {
        if self.shift == 0.0 {
            return;
        }
        let (first, count) = self.shifted_rows(table.len());
        let width = table.joints;
        let moved = |values: &[f64]| -> Vec<f64> {
            let row = |k: usize| values.get(k * width..(k + 1) * width);
            let at = |k: usize| between(&row, (first + k) as f64 - self.shift).unwrap_or_else(|| vec![f64::NAN; width]);
            (0..count).flat_map(at).collect()
        };
        table.q = moved(&table.q);
        if !table.tau.is_empty() {
            table.tau = moved(&table.tau);
        }
        fn keep<T>(values: &mut Vec<T>, width: usize, first: usize, count: usize) {
            values.truncate((first + count) * width);
            values.drain(..(first * width).min(values.len()));
        }
        keep(&mut table.points, 3 * table.numbered, first, count);
        keep(&mut table.orientations, 4, first, count);
        keep(&mut table.fields, 1, first, count);
    }

    /// The options of `identify` that do this.
    pub fn options(&self) -> String {
        let mut words: Vec<String> = Vec::new();
        let list = |all: Vec<String>| all.join(",");
        if !self.order.is_empty() {
            words.push(format!(
                "--order {}",
                list(self.order.iter().map(|k| (k + 1).to_string()).collect())
            ));
        }
        let name = |factor: f64| if factor < 1.0 { "deg" } else { "rad" };
        let units = self.units.iter().enumerate().filter(|u| *u.1 != 1.0);
        let units: Vec<String> = units.map(|(k, f)| format!("{}={}", k + 1, name(*f))).collect();
        if !units.is_empty() {
            words.push(format!("--joint-unit {}", units.join(",")));
        }
        for (joint, terms) in &self.couples {
            let mut sum = String::new();
            for (other, factor) in terms {
                sum += match (*factor, sum.is_empty()) {
                    (1.0, true) => "",
                    (1.0, false) => "+",
                    _ => "-",
                };
                sum += &format!("q{}", other + 1);
            }
            words.push(format!("--couple {}={sum}", joint + 1));
        }
        if !self.flips.is_empty() {
            words.push(format!(
                "--flip {}",
                list(self.flips.iter().map(|k| (k + 1).to_string()).collect())
            ));
        }
        for (joint, angle) in &self.zeros {
            words.push(format!(
                "--zero-deg {}={}",
                joint + 1,
                (angle.to_degrees() * 1e6).round() / 1e6
            ));
        }
        if self.point_factor != 1.0 {
            words.push(format!("--point-factor {}", (self.point_factor * 1e9).round() / 1e9));
        }
        for (done, option) in [(self.mirror, "--mirror-points"), (self.invert, "--invert-poses")] {
            if done {
                words.push(option.to_owned());
            }
        }
        if self.shift != 0.0 {
            words.push(format!("--shift-rows {}", self.shift));
        }
        words.join(" ")
    }
}
