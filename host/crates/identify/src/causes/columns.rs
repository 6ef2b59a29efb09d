//! The columns of every cause: how the residuals move with one unit of it.

use nalgebra::{DMatrix, DVector, Vector3};

use super::alternatives::Alternative;
use super::linear::{Linear, LinearRow};
use crate::course::Course;
use crate::parameters::Layout;

/// Instants that are tried for a jump, besides the ends of couplings.
const INSTANTS: usize = 24;
/// Regions of each joint's range.
const REGIONS: usize = 5;
/// Fewest rows of a seat: fewer are outliers, which robust weights take care of.
const SEATED: usize = 3;
/// Most spans of rows that are tried for a seat.
const SPANS: usize = 2500;

/// All alternatives that the data could show, with their whitened columns.
pub(crate) fn alternatives(linear: &Linear, layout: &Layout, course: &Course) -> Vec<(Alternative, DMatrix<f64>)> {
    let mut list: Vec<(Alternative, DMatrix<f64>)> = Vec::new();
    let time = |p: &LinearRow| course.time.get(p.index).copied().unwrap_or_default();
    let coupling = |p: &LinearRow| course.coupling.get(p.index).copied().unwrap_or_default();
    let matrix = |columns: Vec<DVector<f64>>| DMatrix::from_columns(&columns);
    // `y` is target minus model: a target stated e too far out adds Rᵀ e to it, a
    // target that moved by e, or an encoder that reads e too much, takes it away.
    let stated = |p: &LinearRow, axis: usize| p.rotation.row(axis).transpose();
    let shift = |p: &LinearRow, axis: usize| -p.rotation.row(axis).transpose();
    for (s, &sphere) in layout.spheres.iter().enumerate() {
        for axis in 0..3 {
            let column = linear.column(|p| {
                if p.sphere == Some(s) {
                    stated(p, axis)
                } else {
                    Vector3::zeros()
                }
            });
            list.push((Alternative::Certificate { sphere, axis }, matrix(vec![column])));
        }
    }
    let instants = instants(linear, course);
    for (r, &reference) in layout.references.iter().enumerate() {
        let here = |p: &LinearRow| p.reference == r;
        let own: Vec<&LinearRow> = linear.rows.iter().filter(|p| here(p)).collect();
        if own.len() < 6 {
            continue;
        }
        let middle = own.iter().map(|p| p.target).sum::<Vector3<f64>>() / own.len() as f64;
        // Turns by 1 rad about the middle, in m at the targets.
        let turn = |p: &LinearRow, axis: usize| {
            let e: Vector3<f64> = Vector3::ith(axis, 1.0);
            -p.rotation.tr_mul(&e.cross(&(p.target - middle)))
        };
        let of = |f: &dyn Fn(&LinearRow) -> f64, turned: bool| {
            let mut columns: Vec<DVector<f64>> = (0..3)
                .map(|axis| {
                    linear.column(|p| {
                        if here(p) {
                            shift(p, axis) * f(p)
                        } else {
                            Vector3::zeros()
                        }
                    })
                })
                .collect();
            if turned {
                columns.extend((0..3).map(|axis| {
                    linear.column(|p| {
                        if here(p) {
                            turn(p, axis) * f(p)
                        } else {
                            Vector3::zeros()
                        }
                    })
                }));
            }
            matrix(columns)
        };
        for &at in &instants {
            for turned in [false, true] {
                let after = |p: &LinearRow| f64::from(u8::from(time(p) > at));
                let alternative = Alternative::Slip {
                    reference,
                    time: at,
                    turned,
                };
                list.push((alternative, of(&after, turned)));
            }
        }
        // From the first to the last of this frame's own observations.
        let own = || linear.rows.iter().filter(|p| here(p)).map(time);
        let (first, last) = (own().fold(1.0, f64::min), own().fold(0.0, f64::max));
        if last > first {
            let along = |p: &LinearRow| (time(p) - first) / (last - first) - 0.5;
            list.push((Alternative::Drift { reference }, of(&along, false)));
        }
    }
    for (s, &sphere) in layout.spheres.iter().enumerate() {
        // Between each two couplings on this sphere that follow each other.
        let mut visits: Vec<(usize, f64, f64)> = Vec::new();
        for p in linear.rows.iter().filter(|p| p.sphere == Some(s)) {
            let t = time(p);
            match visits.iter_mut().find(|v| v.0 == coupling(p)) {
                Some(v) => (v.1, v.2) = (v.1.min(t), v.2.max(t)),
                None => visits.push((coupling(p), t, t)),
            }
        }
        visits.sort_by(|a, b| a.1.total_cmp(&b.1));
        for pair in visits.windows(2) {
            let at = 0.5 * (pair[0].2 + pair[1].1);
            let columns = (0..3).map(|axis| {
                linear.column(|p| {
                    if p.sphere == Some(s) && time(p) > at {
                        shift(p, axis)
                    } else {
                        Vector3::zeros()
                    }
                })
            });
            list.push((Alternative::SphereMoved { sphere, time: at }, matrix(columns.collect())));
        }
    }
    if linear.rows.iter().any(|p| p.sphere.is_some()) {
        for c in 0..course.couplings() {
            let columns = (0..3).map(|axis| {
                linear.column(|p| {
                    if coupling(p) == c {
                        shift(p, axis)
                    } else {
                        Vector3::zeros()
                    }
                })
            });
            list.push((Alternative::Seat { coupling: c }, matrix(columns.collect())));
        }
    }
    for span in spans(linear, course) {
        let columns = (0..3).map(|axis| {
            linear.column(|p| {
                if coupling(p) == span.coupling && (span.rows.0..=span.rows.1).contains(&p.index) {
                    p.posture.flange.column(axis).into()
                } else {
                    Vector3::zeros()
                }
            })
        });
        let alternative = Alternative::Reseat {
            coupling: span.coupling,
            rows: span.rows,
        };
        list.push((alternative, matrix(columns.collect())));
    }
    for joint in 0..layout.n {
        for &at in &instants {
            let column = linear.column(|p| {
                if time(p) > at {
                    -p.posture.joints[joint]
                } else {
                    Vector3::zeros()
                }
            });
            list.push((Alternative::EncoderStep { joint, time: at }, matrix(vec![column])));
        }
        let column = linear.column(|p| -p.posture.joints[joint] * time(p));
        list.push((Alternative::EncoderDrift { joint }, matrix(vec![column])));
        let mut angles: Vec<f64> = linear.rows.iter().map(|p| p.posture.q[joint]).collect();
        angles.sort_by(f64::total_cmp);
        for region in 0..REGIONS {
            let edge = |k: usize| angles[(k * (angles.len() - 1)) / REGIONS];
            let (from_rad, to_rad) = (edge(region), edge(region + 1));
            let column = linear.column(|p| {
                if (from_rad..to_rad).contains(&p.posture.q[joint]) {
                    -p.posture.joints[joint]
                } else {
                    Vector3::zeros()
                }
            });
            let alternative = Alternative::JointRegion {
                joint,
                from_rad,
                to_rad,
            };
            list.push((alternative, matrix(vec![column])));
        }
    }
    list
}

/// Rows of one coupling that follow each other.
struct Span {
    coupling: usize,
    /// First and last row.
    rows: (usize, usize),
}

/// The spans of rows in which the nest may have sat elsewhere: all that begin and end at some rows of a coupling,
/// which are as dense as [`SPANS`] allows.
fn spans(linear: &Linear, course: &Course) -> Vec<Span> {
    let mut couplings: Vec<Vec<usize>> = vec![Vec::new(); course.couplings()];
    for p in linear.rows.iter().filter(|p| p.sphere.is_some() && p.leads()) {
        let coupling = course.coupling.get(p.index).copied().unwrap_or_default();
        if let Some(own) = couplings.get_mut(coupling) {
            own.push(p.index);
        }
    }
    let at = |step: usize| {
        let mut found = Vec::new();
        for (coupling, own) in couplings.iter().enumerate() {
            let mut edges: Vec<usize> = (0..own.len()).step_by(step).collect();
            edges.push(own.len());
            for (k, &from) in edges.iter().enumerate() {
                for &to in edges.iter().skip(k + 1).filter(|to| **to >= from + SEATED) {
                    let rows = (own[from], own[to - 1]);
                    found.push(Span { coupling, rows });
                }
            }
        }
        found
    };
    let most = couplings.iter().map(Vec::len).max().unwrap_or_default().max(1);
    (1..=most)
        .map(at)
        .find(|found| found.len() <= SPANS)
        .unwrap_or_default()
}

/// Instants between observations: the ends of couplings and evenly spread ones.
fn instants(linear: &Linear, course: &Course) -> Vec<f64> {
    let mut times: Vec<(f64, usize)> = linear
        .rows
        .iter()
        .map(|p| {
            let at = |v: &[f64]| v.get(p.index).copied().unwrap_or_default();
            (
                at(&course.time),
                course.coupling.get(p.index).copied().unwrap_or_default(),
            )
        })
        .collect();
    times.sort_by(|a, b| a.0.total_cmp(&b.0));
    let count = times.len();
    let step = count.div_ceil(INSTANTS + 1).max(1);
    let mut out = Vec::new();
    for (k, pair) in times.windows(2).enumerate() {
        let ends = pair[0].1 != pair[1].1;
        // A jump that only a few observations saw is theirs.
        let inside = k + 1 >= 3 && k + 4 <= count;
        if pair[1].0 > pair[0].0 && inside && (ends || (k + 1) % step == 0) {
            out.push(0.5 * (pair[0].0 + pair[1].0));
        }
    }
    out
}
