//! A table as CSV again, in SI units and without a loss of digits.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::table::{Labels, Table, rotation};
use crate::{Pose, Set, Target};

fn cell(name: &str) -> String {
    format!("\"{}\"", name.replace('"', "\"\""))
}

impl Table {
    /// Gives every row other joints (as many each) and moves what was measured. `row` returns both from the row's own
    /// joint columns: angles in rad, and what takes the measured body to its new place (m). Torques are of the columns and
    /// are left out.
    pub fn with_joints(&mut self, row: impl Fn(&[f64]) -> (Vec<f64>, Pose<f64>)) {
        let mut q = Vec::with_capacity(self.q.len());
        for k in 0..self.len() {
            let own = self.q.get(k * self.joints..(k + 1) * self.joints).unwrap_or_default();
            let (angles, motion) = row(own);
            q.extend_from_slice(&angles);
            let width = 3 * self.numbered;
            let points = self.points.get_mut(k * width..(k + 1) * width).unwrap_or_default();
            let point = self.fields.get_mut(k).map(|f| &mut f.point[..]).unwrap_or_default();
            for triple in points.chunks_exact_mut(3).chain(std::iter::once(point)) {
                let moved = motion.point(&Vector3::new(triple[0], triple[1], triple[2]));
                triple.copy_from_slice(moved.as_slice());
            }
            if motion.rotation != Matrix3::identity()
                && let Some([w, x, y, z]) = self.orientations.get_mut(4 * k..4 * k + 4)
                && !w.is_nan()
            {
                let turned = motion.rotation * rotation(*w, *x, *y, *z);
                let turned = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turned));
                (*w, *x, *y, *z) = (turned.w, turned.i, turned.j, turned.k);
            }
        }
        self.joints = q.len() / self.len().max(1);
        self.q = q;
        self.tau.clear();
    }

    /// The table as `identify` takes it; `places` are the names of the placements, and `label` the name of the label
    /// column, where there is one.
    pub fn to_csv(&self, places: &Labels, label: Option<&str>) -> String {
        let has = |wanted: fn(&super::TableRow<'_>) -> bool| self.rows().any(|row| wanted(&row));
        let torques = has(|r| r.tau.is_some());
        let point = has(|r| r.point.is_some());
        let frame = has(|r| matches!(r.target(), Target::Frame(_)));
        let sphere = has(|r| r.sphere.is_some());
        let place = self.rows().any(|r| !places.name(r.place).is_empty());
        let set = has(|r| r.set.is_some());
        let n = self.joints;
        let mut columns: Vec<String> = (1..=n).map(|k| format!("q{k}")).collect();
        if torques {
            columns.extend((1..=n).map(|k| format!("tau{k}")));
        }
        for k in 1..=self.numbered {
            columns.extend(["x", "y", "z"].map(|axis| format!("{axis}{k}_m")));
        }
        let names = [
            (point, "x_m,y_m,z_m"),
            (frame, "qw,qx,qy,qz"),
            (sphere, "sphere"),
            (place, "place"),
            (set, "set"),
        ];
        columns.extend(names.iter().filter(|n| n.0).map(|n| n.1.to_owned()));
        columns.extend(label.map(cell));
        let mut out = columns.join(",") + "\n";
        let numbers = |values: &[f64]| -> Vec<String> {
            let word = |v: &f64| if v.is_nan() { String::new() } else { v.to_string() };
            values.iter().map(word).collect()
        };
        let mut line = 1;
        for (k, row) in self.rows().enumerate() {
            // A row stays in its line of the user's file, which messages name.
            while line + 1 < row.line {
                out.push('\n');
                line += 1;
            }
            line += 1;
            let mut cells = numbers(row.q);
            if torques {
                cells.extend(row.tau.map_or_else(|| vec![String::new(); n], numbers));
            }
            cells.extend(numbers(
                self.points
                    .get(3 * self.numbered * k..3 * self.numbered * (k + 1))
                    .unwrap_or_default(),
            ));
            if point {
                cells.extend(numbers(&row.point.unwrap_or([f64::NAN; 3])));
            }
            if frame {
                cells.extend(numbers(
                    self.orientations.get(4 * k..4 * k + 4).unwrap_or(&[f64::NAN; 4]),
                ));
            }
            if sphere {
                cells.push(row.sphere.map_or_else(String::new, |s| s.to_string()));
            }
            if place {
                cells.push(cell(places.name(row.place)));
            }
            if set {
                cells.push(
                    row.set
                        .map_or("", |set| if set == Set::Validate { "validate" } else { "calibrate" })
                        .to_owned(),
                );
            }
            if label.is_some() {
                cells.push(row.label.map_or_else(String::new, |l| cell(self.labels.name(l))));
            }
            out += &cells.join(",");
            out.push('\n');
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::super::{TableFormat, read_csv};
    use super::*;
    use crate::Target;
    use crate::robots::frames::{compose, distance, from_rpy};

    // Fails if a measured body is not where its motion takes it, in position or orientation, if a row without an orientation
    // gets one, or if the table as CSV says otherwise.
    #[test]
    fn joints_are_exchanged_and_bodies_moved() {
        let format = TableFormat::new(2);
        let text = "q1,q2,x_m,y_m,z_m,qw,qx,qy,qz\n0.1,0.2,1,2,3,0.5,0.5,-0.5,0.5\n0.3,0.4,-1,0.5,2,,,,\n";
        let mut places = Labels::default();
        let mut table = read_csv("t.csv", text.as_bytes(), &format, &mut places).expect("a table");
        let before: Vec<Target> = table.rows().map(|row| row.target()).collect();
        let motion = |q: f64| Pose {
            rotation: from_rpy([q, -0.4, 2.0 * q]),
            position: Vector3::new(0.1, q, -0.2),
        };
        table.with_joints(|q| (vec![q[1]], motion(q[0])));
        let csv = table.to_csv(&places, None);
        let again = read_csv("t.csv", csv.as_bytes(), &TableFormat::new(1), &mut places).expect("a table");
        for table in [&table, &again] {
            let rows: Vec<_> = table.rows().collect();
            assert_eq!((rows[0].q, rows[1].q), (&[0.2][..], &[0.4][..]));
            let (Target::Frame(was), Target::Frame(is)) = (&before[0], &rows[0].target()) else {
                panic!("{before:?}")
            };
            assert!(distance(&compose(&motion(0.1), was), is) < 1e-14);
            let (Target::Point(was), Target::Point(is)) = (&before[1], &rows[1].target()) else {
                panic!("{before:?}")
            };
            assert!((motion(0.3).point(&Vector3::from(*was)) - Vector3::from(*is)).norm() < 1e-14);
        }
    }
}
