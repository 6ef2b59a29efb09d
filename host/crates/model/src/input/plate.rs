//! The plate's certificate as TOML: `[[sphere]]` tables with `id`, `x_mm`,
//! `y_mm`, `z_mm` and `sigma_mm` (standard uncertainty of each coordinate).

use std::path::Path;

use serde::Deserialize;

use super::error::InputError;
use crate::Sphere;

/// Standard uncertainty (mm) of a sphere whose table does not say: the paper's
/// 2.7 µm at 95 %.
const DEFAULT_SIGMA_MM: f64 = 2.7e-3 / 1.96;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    sphere: Vec<SphereTable>,
    /// What the plate is called; for people.
    #[serde(default)]
    #[allow(dead_code, reason = "accepted so that a certificate may carry its name")]
    name: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SphereTable {
    id: u32,
    x_mm: f64,
    y_mm: f64,
    z_mm: f64,
    sigma_mm: Option<f64>,
}

/// Reads a plate file.
///
/// # Errors
/// What the system or [`read_plate`] refuses.
pub fn read_plate_file(path: &Path) -> Result<Vec<Sphere>, InputError> {
    let file = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|source| InputError::Read {
        file: file.clone(),
        source,
    })?;
    read_plate(&file, &text)
}

/// Reads a plate from TOML text; `file` is for messages.
///
/// # Errors
/// Text that is not TOML, unknown fields, no spheres, doubled ids, numbers
/// that are not finite or not possible.
pub fn read_plate(file: &str, text: &str) -> Result<Vec<Sphere>, InputError> {
    let parsed: File = toml::from_str(text).map_err(|e| InputError::Syntax {
        file: file.to_owned(),
        message: format!("{e}(a plate lists [[sphere]] tables with id, x_mm, y_mm, z_mm and sigma_mm)"),
    })?;
    let refuse = |field: String, value: String, remedy: &str| InputError::Field {
        file: file.to_owned(),
        field,
        value,
        remedy: remedy.to_owned(),
    };
    if parsed.sphere.is_empty() {
        return Err(refuse(
            "[[sphere]]".to_owned(),
            "missing".to_owned(),
            "list at least one sphere with id, x_mm, y_mm, z_mm and sigma_mm",
        ));
    }
    let mut spheres: Vec<Sphere> = Vec::with_capacity(parsed.sphere.len());
    for s in &parsed.sphere {
        if spheres.iter().any(|other| other.id == s.id) {
            return Err(refuse(
                "sphere id".to_owned(),
                s.id.to_string(),
                "stands twice; give each sphere an id of its own",
            ));
        }
        for (name, value) in [("x_mm", s.x_mm), ("y_mm", s.y_mm), ("z_mm", s.z_mm)] {
            if !value.is_finite() || value.abs() > 20_000.0 {
                return Err(refuse(
                    format!("sphere {}: {name}", s.id),
                    value.to_string(),
                    "give a finite coordinate in mm, within 20 m",
                ));
            }
        }
        let sigma_mm = s.sigma_mm.unwrap_or(DEFAULT_SIGMA_MM);
        if !(0.0..=100.0).contains(&sigma_mm) {
            return Err(refuse(
                format!("sphere {}: sigma_mm", s.id),
                sigma_mm.to_string(),
                "give the standard uncertainty (1 sigma) in mm, from 0 to 100",
            ));
        }
        spheres.push(Sphere {
            id: s.id,
            position_m: [s.x_mm / 1e3, s.y_mm / 1e3, s.z_mm / 1e3],
            sigma_m: sigma_mm / 1e3,
        });
    }
    Ok(spheres)
}
