//! The known data of a real cell before anything is measured: the plate, its certificate, and its
//! nominal pose.
//!
//! The configuration's section `[cell]` consists of these types. The planner takes nominal
//! positions from them; the simulator draws its errors around them.

use serde::{Deserialize, Serialize};

/// Most spheres of a plate.
pub const MAX_SPHERES: usize = 8;

/// Most placements of the plate in one run.
const MAX_PLACEMENTS: usize = 32;

/// A sphere of the plate as its certificate states it, in the plate's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sphere {
    /// Id that observations refer to.
    pub id: u32,
    /// Centre, in m.
    pub position_m: [f64; 3],
    /// Standard uncertainty of each coordinate (1 sigma), in m.
    pub sigma_m: f64,
}

/// Calibration plate, by its certificate and its drawing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct CalibrationPlate {
    /// Certified sphere centres in the plate's frame, in m; sphere 1 comes first. Default: Table 1 of the paper.
    pub spheres_m: Vec<[f64; 3]>,
    /// Standard uncertainty of each certified coordinate, in m. Default: ±2.7 µm at 95 % (Section 2.2 of the paper).
    pub certificate_sigma_m: f64,
    /// Sphere radius, in m. Default: spheres of 50.8 mm diameter (Section 2.2).
    pub sphere_radius_m: f64,
    /// Depth of the plate's surface below the sphere centres, in m (the spheres stand on posts).
    /// Default 60 mm: from the photographs of the plate (Figure 2); no drawing is published.
    pub surface_below_m: f64,
}

impl Default for CalibrationPlate {
    fn default() -> Self {
        Self {
            spheres_m: vec![[0.0, 0.0, 0.0], [0.300_009, 0.0, 0.0], [0.150_049, 0.260_051, 0.0]],
            certificate_sigma_m: 2.7e-6 / 1.96,
            sphere_radius_m: 0.0254,
            surface_below_m: 0.060,
        }
    }
}

impl CalibrationPlate {
    /// The spheres as the certificate states them, numbered from 1.
    pub fn certificate(&self) -> Vec<Sphere> {
        let sphere = |(position_m, id): (&[f64; 3], u32)| Sphere {
            id,
            position_m: *position_m,
            sigma_m: self.certificate_sigma_m,
        };
        self.spheres_m.iter().zip(1..).map(sphere).collect()
    }
}

/// Nominal pose of the plate in one placement.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Placement {
    /// Position of sphere 1 in F0, in m.
    pub origin_m: [f64; 3],
    /// Roll, pitch and yaw of the plate in F0 (about x, then y, then z, fixed axes), in rad.
    pub rpy_rad: [f64; 3],
}

impl Default for Placement {
    /// The centroid of the default plate's spheres at (470, 0, 320) mm, yaw 150 degrees (reach study of
    /// `docs/design/plant.md`).
    fn default() -> Self {
        let yaw = 150.0_f64.to_radians();
        let (cx, cy) = ((0.300_009 + 0.150_049) / 3.0, 0.260_051 / 3.0);
        let (s, c) = (libm::sin(yaw), libm::cos(yaw));
        Self {
            origin_m: [0.470 - (c * cx - s * cy), -(s * cx + c * cy), 0.320],
            rpy_rad: [0.0, 0.0, yaw],
        }
    }
}

/// The plate and its placements, in the order in which the run uses them.
#[derive(Clone, Debug, PartialEq)]
pub struct NominalCell {
    /// The plate.
    pub plate: CalibrationPlate,
    /// Nominal poses of the plate, one placement after the other.
    pub placements: Vec<Placement>,
}

impl Default for NominalCell {
    fn default() -> Self {
        Self {
            plate: CalibrationPlate::default(),
            placements: vec![Placement::default()],
        }
    }
}

/// A number of the cell that is not possible.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("cell.{field} is {value}: {remedy}")]
pub struct CellError {
    /// Field, as it stands in the file below `[cell]`.
    pub field: &'static str,
    /// Its value.
    pub value: f64,
    /// What to write instead.
    pub remedy: &'static str,
}

impl NominalCell {
    /// The first placement; the default one if there is none.
    pub fn first(&self) -> Placement {
        self.placements.first().copied().unwrap_or_default()
    }

    /// Checks every number.
    ///
    /// # Errors
    /// The first field that is not finite or not possible, with value and remedy.
    pub fn check(&self) -> Result<(), CellError> {
        let plate = &self.plate;
        let spheres = plate.spheres_m.len();
        require(
            "plate.spheres_m",
            spheres as f64,
            (1..=MAX_SPHERES).contains(&spheres),
            "give one to eight spheres",
        )?;
        for value in plate.spheres_m.iter().flatten() {
            require("plate.spheres_m", *value, value.abs() <= 5.0, "give metres, within 5 m")?;
        }
        require(
            "plate.certificate_sigma_m",
            plate.certificate_sigma_m,
            (0.0..=0.01).contains(&plate.certificate_sigma_m),
            "give metres, from 0 to 0.01",
        )?;
        require(
            "plate.sphere_radius_m",
            plate.sphere_radius_m,
            (1e-3..=0.1).contains(&plate.sphere_radius_m),
            "give metres, from 0.001 to 0.1",
        )?;
        require(
            "plate.surface_below_m",
            plate.surface_below_m,
            (plate.sphere_radius_m..=5.0).contains(&plate.surface_below_m),
            "give metres, at least the sphere's radius and at most 5",
        )?;
        let placements = self.placements.len();
        require(
            "placements",
            placements as f64,
            (1..=MAX_PLACEMENTS).contains(&placements),
            "give 1 to 32 placements, each as [[cell.placements]] with origin_m and rpy_rad",
        )?;
        for placement in &self.placements {
            for value in placement.origin_m {
                require(
                    "placements.origin_m",
                    value,
                    value.abs() <= 5.0,
                    "give metres, within 5 m",
                )?;
            }
            for value in placement.rpy_rad {
                require(
                    "placements.rpy_rad",
                    value,
                    value.abs() <= 7.0,
                    "give angles in rad, within 7",
                )?;
            }
        }
        Ok(())
    }
}

/// Refuses a value that is not finite or for which `good` is false.
fn require(field: &'static str, value: f64, good: bool, remedy: &'static str) -> Result<(), CellError> {
    if value.is_finite() && good {
        Ok(())
    } else {
        Err(CellError { field, value, remedy })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if an impossible number is accepted, or if the error does not name its field.
    #[test]
    fn impossible_cells_are_refused_by_field() {
        assert_eq!(NominalCell::default().check(), Ok(()));
        let cases: [(&str, fn(&mut NominalCell)); 9] = [
            ("cell.plate.spheres_m is 0", |c| c.plate.spheres_m.clear()),
            ("cell.plate.spheres_m is 9", |c| c.plate.spheres_m = vec![[0.0; 3]; 9]),
            ("cell.plate.spheres_m is NaN", |c| c.plate.spheres_m[1][2] = f64::NAN),
            ("cell.plate.certificate_sigma_m is -1", |c| {
                c.plate.certificate_sigma_m = -1.0;
            }),
            ("cell.plate.sphere_radius_m is 25.4", |c| c.plate.sphere_radius_m = 25.4),
            ("cell.plate.surface_below_m is 0.02", |c| c.plate.surface_below_m = 0.02),
            ("cell.placements is 0", |c| c.placements.clear()),
            ("cell.placements.origin_m is 470", |c| {
                c.placements[0].origin_m[0] = 470.0;
            }),
            ("cell.placements.rpy_rad is 150", |c| c.placements[0].rpy_rad[2] = 150.0),
        ];
        for (words, change) in cases {
            let mut cell = NominalCell::default();
            change(&mut cell);
            let refusal = cell.check().expect_err(words).to_string();
            assert!(refusal.starts_with(words), "{refusal}");
        }
    }
}
