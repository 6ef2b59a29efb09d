//! The plate's certificate as TOML: `[[sphere]]` tables.
//!
//! | field | meaning |
//! |---|---|
//! | `id` | integer id that the table of poses refers to |
//! | `x_mm, y_mm, z_mm` or `x_m, y_m, z_m` | centre in the plate's frame |
//! | `sigma_mm` or `sigma_um`, optional | standard uncertainty (1 sigma, not the certificate's U) of each coordinate |
//!
//! A plate with coincident spheres, without uncertainty or in the wrong unit would
//! give a result with a wrong scale; it is refused. What only weakens the result
//! (all spheres on one line) becomes a note.

use std::collections::HashMap;
use std::path::Path;

use nalgebra::Vector3;
use serde::Deserialize;

use super::error::InputError;
use crate::{Sphere, read_text, read_toml};

/// Standard uncertainty (m) of a sphere whose table does not say: the paper's
/// 2.7 µm at 95 %.
const DEFAULT_SIGMA_M: f64 = 2.7e-6 / 1.96;
/// Largest plate file, in bytes.
const MOST_BYTES: u64 = 1 << 20;
/// Most spheres of a plate: their positions are estimated together.
const MOST_SPHERES: usize = 100;
/// Largest coordinate, in m: no plate is as large as a robot's cell.
const LARGEST_M: f64 = 20.0;
/// Largest standard uncertainty, in m.
const LARGEST_SIGMA_M: f64 = 0.1;
/// Centres closer than this (m) belong to one sphere: the smallest nests hold spheres of some millimetres.
const COINCIDENT_M: f64 = 1e-3;
/// Height (m) of a triangle of spheres below which they count as on one line.
const FLAT_M: f64 = 5e-3;

/// A plate as its certificate states it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plate {
    /// What the certificate calls it; may be empty.
    pub name: String,
    /// Its spheres, in the file's order.
    pub spheres: Vec<Sphere>,
    /// What the user should know about it, in words.
    pub notes: Vec<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PlateFile {
    #[serde(default)]
    sphere: Vec<SphereTable>,
    #[serde(default)]
    name: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SphereTable {
    id: u32,
    x_mm: Option<f64>,
    y_mm: Option<f64>,
    z_mm: Option<f64>,
    x_m: Option<f64>,
    y_m: Option<f64>,
    z_m: Option<f64>,
    sigma_mm: Option<f64>,
    sigma_um: Option<f64>,
}

/// Reads a plate file.
///
/// # Errors
/// Files that are not regular or too large, and what [`read_plate`] refuses.
pub fn read_plate_file(path: &Path) -> Result<Plate, InputError> {
    let text = read_text(path, MOST_BYTES, "a plate lists some [[sphere]] tables")?;
    read_plate(&path.display().to_string(), &text)
}

struct RefusalPlace<'a> {
    file: &'a str,
    sphere: u32,
}

impl RefusalPlace<'_> {
    fn refuse(&self, field: &str, value: impl std::fmt::Display, remedy: &str) -> InputError {
        InputError::Field {
            file: self.file.to_owned(),
            field: format!("sphere {}: {field}", self.sphere),
            value: value.to_string(),
            remedy: remedy.to_owned(),
        }
    }

    /// One coordinate, in m.
    fn coordinate(&self, axis: &str, mm: Option<f64>, m: Option<f64>) -> Result<f64, InputError> {
        let (field, value, metres) = match (mm, m) {
            (Some(mm), None) => (format!("{axis}_mm"), mm, mm / 1e3),
            (None, Some(m)) => (format!("{axis}_m"), m, m),
            (None, None) => {
                return Err(self.refuse(&format!("{axis}_mm"), "missing", "give the centre: x_mm, y_mm and z_mm"));
            }
            (Some(_), Some(m)) => {
                return Err(self.refuse(&format!("{axis}_m"), m, "is given twice, in mm and in m: keep one"));
            }
        };
        if metres.is_nan() || metres.abs() > LARGEST_M {
            return Err(self.refuse(
                &field,
                value,
                "give a finite coordinate within 20 m; the name says the unit",
            ));
        }
        Ok(metres)
    }

    /// The standard uncertainty, in m.
    fn sigma(&self, mm: Option<f64>, um: Option<f64>) -> Result<f64, InputError> {
        let (field, value, metres) = match (mm, um) {
            (None, None) => return Ok(DEFAULT_SIGMA_M),
            (Some(mm), None) => ("sigma_mm", mm, mm / 1e3),
            (None, Some(um)) => ("sigma_um", um, um / 1e6),
            (Some(_), Some(um)) => {
                return Err(self.refuse("sigma_um", um, "is given twice, in mm and in µm: keep one"));
            }
        };
        if metres > 0.0 && metres <= LARGEST_SIGMA_M {
            return Ok(metres);
        }
        Err(self.refuse(
            field,
            value,
            "give the standard uncertainty (1 sigma: half of the certificate's U at k = 2), above 0 and at most 100 mm",
        ))
    }
}

/// Reads a plate from TOML text; `file` is for messages.
///
/// # Errors
/// Text that is not TOML, unknown fields, no or too many spheres, doubled ids,
/// numbers that are not finite or not possible, spheres in the same place.
pub fn read_plate(file: &str, text: &str) -> Result<Plate, InputError> {
    let parsed: PlateFile = read_toml(text).map_err(|source| InputError::Toml {
        file: file.to_owned(),
        source,
        expected: "a plate lists [[sphere]] tables with id, x_mm, y_mm, z_mm and sigma_mm",
    })?;
    let count = parsed.sphere.len();
    if count == 0 || count > MOST_SPHERES {
        return Err(InputError::Count {
            file: file.to_owned(),
            found: format!("{count} spheres"),
            remedy: format!(
                "list between 1 and {MOST_SPHERES} [[sphere]] tables with id, x_mm, y_mm, z_mm and sigma_mm"
            ),
        });
    }
    let mut spheres: Vec<Sphere> = Vec::with_capacity(count);
    for s in &parsed.sphere {
        let place = RefusalPlace { file, sphere: s.id };
        if spheres.iter().any(|other| other.id == s.id) {
            return Err(InputError::Field {
                file: file.to_owned(),
                field: "sphere id".to_owned(),
                value: s.id.to_string(),
                remedy: "stands twice; give each sphere an id of its own".to_owned(),
            });
        }
        spheres.push(Sphere {
            id: s.id,
            position_m: [
                place.coordinate("x", s.x_mm, s.x_m)?,
                place.coordinate("y", s.y_mm, s.y_m)?,
                place.coordinate("z", s.z_mm, s.z_m)?,
            ],
            sigma_m: place.sigma(s.sigma_mm, s.sigma_um)?,
        });
    }
    separate(file, &spheres, parsed.sphere.iter().any(|s| s.x_mm.is_some()))?;
    let mut plate = Plate {
        name: parsed.name,
        spheres,
        notes: Vec::new(),
    };
    if let Some(note) = on_a_line(&plate.spheres) {
        plate.notes.push(note);
    }
    Ok(plate)
}

fn centre(sphere: &Sphere) -> Vector3<f64> {
    Vector3::from(sphere.position_m)
}

/// Refuses spheres in the same place, and a whole plate in the wrong unit.
fn separate(file: &str, spheres: &[Sphere], millimetres: bool) -> Result<(), InputError> {
    let mut closest: HashMap<usize, (usize, f64)> = HashMap::new();
    let largest = spheres.iter().map(|s| centre(s).amax()).fold(0.0, f64::max);
    for (i, a) in spheres.iter().enumerate() {
        for (j, b) in spheres.iter().enumerate().take(i) {
            let distance = (centre(a) - centre(b)).norm();
            if distance < COINCIDENT_M {
                closest.insert(i, (j, distance));
            }
        }
    }
    let Some((&i, &(j, distance))) = closest.iter().min_by_key(|found| found.0) else {
        return Ok(());
    };
    // A whole plate within some millimetres: its coordinates are in metres.
    let metres = millimetres && largest < 5.0 * COINCIDENT_M;
    Err(InputError::Field {
        file: file.to_owned(),
        field: format!("the distance of spheres {} and {}", spheres[j].id, spheres[i].id),
        value: format!("{:.4} mm", distance * 1e3),
        remedy: if metres {
            "name the coordinates x_m, y_m, z_m if they are in metres".to_owned()
        } else {
            "two spheres cannot be in the same place: correct the coordinates".to_owned()
        },
    })
}

/// What to say of three or more spheres on one line.
fn on_a_line(spheres: &[Sphere]) -> Option<String> {
    if spheres.len() < 3 {
        return None;
    }
    let first = centre(spheres.first()?);
    let far = spheres
        .iter()
        .map(|s| centre(s) - first)
        .max_by(|a, b| a.norm().total_cmp(&b.norm()))?;
    let along = far.try_normalize(0.0)?;
    let height = spheres
        .iter()
        .map(|s| {
            let from = centre(s) - first;
            (from - along * from.dot(&along)).norm()
        })
        .fold(0.0, f64::max);
    (height < FLAT_M).then(|| {
        format!(
            "the plate's {} spheres lie on one line (within {:.1} mm): the plate's turn about it stays open; a sphere \
             beside the line would fix it",
            spheres.len(),
            height * 1e3
        )
    })
}
