//! The cell: nominal robot, tool, plate and spheres.

use core::f64::consts::PI;

use nalgebra::{Matrix3, Rotation3, UnitVector3, Vector3};
use serde::{Deserialize, Serialize};
use spherecal_shared::procedure::Procedure;
use spherecal_shared::robot::{Robot, Tool, iiwa7, iiwa7_tool};

use super::contact_mass::Contact;
use super::error::PlanError;
use spherecal_identify::{Sphere, paper_plate};
use spherecal_model::chain::{Chain, TcpPose, rotation_of};

/// Nominal pose of the plate in F0, for one placement.
///
/// `centre_m` is the centroid of the sphere centres (`docs/design/plant.md` calls it the plate origin
/// centre). `orientation` turns the plate's frame into F0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlatePose {
    /// Centroid of the sphere centres in F0, in m.
    pub centre_m: [f64; 3],
    /// Rotation of the plate's frame in F0 as a unit quaternion w, x, y, z.
    pub orientation: [f64; 4],
}

impl PlatePose {
    /// A level plate turned by `yaw_rad` about the vertical.
    pub fn level(centre_m: [f64; 3], yaw_rad: f64) -> Self {
        let (s, c) = (0.5 * yaw_rad).sin_cos();
        Self {
            centre_m,
            orientation: [c, 0.0, 0.0, s],
        }
    }

    /// Rotation of the plate's frame in F0.
    pub fn rotation(&self) -> Rotation3<f64> {
        rotation_of(&self.orientation)
    }

    /// The plate's normal in F0, out of the side that carries the spheres.
    pub fn normal(&self) -> UnitVector3<f64> {
        UnitVector3::new_normalize(self.rotation() * Vector3::z())
    }
}

/// The parts of a cell that stand in the arm's way, as its drawing gives them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Obstacles {
    /// Radius of the spheres, in m.
    pub sphere_radius_m: f64,
    /// Depth of the plate's surface below the sphere centres, in m.
    pub surface_below_m: f64,
}

impl Default for Obstacles {
    fn default() -> Self {
        Self {
            sphere_radius_m: 0.0254,
            surface_below_m: 0.060,
        }
    }
}

/// Robot, tool, plate and spheres, as planned (nothing measured).
#[derive(Clone, Debug, PartialEq)]
pub struct Cell {
    /// Nominal robot.
    pub robot: Robot,
    /// Nominal tool.
    pub tool: Tool,
    /// The plate's certificate.
    pub spheres: Vec<Sphere>,
    /// Placements of the plate; the index is [`Observation`](spherecal_identify::Observation)'s place.
    pub plates: Vec<PlatePose>,
    /// Yaw of the tool about the plate's normal at the neutral orientation, in rad: at 0, x of FT
    /// points along x of F0. `None` chooses the yaw with the largest distance to the joint limits.
    pub tool_yaw_rad: Option<f64>,
    /// Height of the approach frame above the sphere's centre, in m.
    pub approach_height_m: f64,
    /// Height of home over the plate's centre, in m.
    pub home_height_m: f64,
    /// The shapes of spheres and plate that the arm keeps clear of.
    pub obstacles: Obstacles,
    /// Postures of the work region (rad), over which an optimal plan makes the error small; the space in front of the arm
    /// without it.
    pub work: Option<Vec<Vec<f64>>>,
    /// What the arm may do to a sphere as it meets it.
    pub contact: Contact,
}

impl Cell {
    /// The nominal cell of the iiwa 7: Table 1's spheres, centred at
    /// (470, 0, 320) mm, yaw 150 degrees, tool (50, 0, 100) mm.
    pub fn iiwa7() -> Self {
        Self {
            robot: iiwa7(),
            tool: iiwa7_tool(),
            spheres: paper_plate(),
            plates: vec![PlatePose::level([0.470, 0.0, 0.320], 150f64.to_radians())],
            tool_yaw_rad: Some(PI),
            approach_height_m: 0.050,
            home_height_m: 0.200,
            obstacles: Obstacles::default(),
            work: None,
            contact: Contact::from(&Procedure::default()),
        }
    }

    /// Checks that a plan can be made from this cell.
    ///
    /// # Errors
    /// No spheres, no placement, or a number that is not finite or not possible.
    pub fn check(&self) -> Result<(), PlanError> {
        if self.spheres.is_empty() {
            return Err(PlanError::NoSpheres);
        }
        if self.plates.is_empty() {
            return Err(PlanError::NoPlate);
        }
        let numbers = self
            .spheres
            .iter()
            .flat_map(|s| s.position_m)
            .chain(self.plates.iter().flat_map(|p| p.centre_m));
        for value in numbers {
            if value.is_nan() || value.abs() > 10.0 {
                return Err(PlanError::OutOfRange {
                    field: "sphere position or plate centre (m)",
                    value,
                    remedy: "give a finite place within 10 m",
                });
            }
        }
        for plate in &self.plates {
            let norm = plate.orientation.iter().map(|v| v * v).sum::<f64>().sqrt();
            if norm.is_nan() || (norm - 1.0).abs() >= 1e-6 {
                return Err(PlanError::OutOfRange {
                    field: "norm of the plate's orientation",
                    value: norm,
                    remedy: "give a unit quaternion w, x, y, z",
                });
            }
        }
        for (field, value) in [
            ("approach_height_m", self.approach_height_m),
            ("home_height_m", self.home_height_m),
        ] {
            if !(0.005..=1.0).contains(&value) {
                return Err(PlanError::OutOfRange {
                    field,
                    value,
                    remedy: "give a height between 5 mm and 1 m",
                });
            }
        }
        Ok(())
    }

    /// Nominal centre of a sphere in F0, in m.
    pub fn sphere_in_base(&self, plate: &PlatePose, sphere: &Sphere) -> Vector3<f64> {
        let sum: Vector3<f64> = self.spheres.iter().map(|s| Vector3::from(s.position_m)).sum();
        let centroid = sum / self.spheres.len() as f64;
        Vector3::from(plate.centre_m) + plate.rotation() * (Vector3::from(sphere.position_m) - centroid)
    }

    /// Direction of the descent in F0: against the plate's normal.
    pub fn approach_direction(&self, plate: &PlatePose) -> Vector3<f64> {
        -plate.normal().into_inner()
    }

    /// Neutral orientation of FT in F0: xy-plane parallel to the plate, z into
    /// it (Section 2.2 of the paper), turned by `yaw` about the normal.
    pub fn neutral(&self, plate: &PlatePose, yaw: f64) -> Rotation3<f64> {
        let z = self.approach_direction(plate);
        // x of F0 along the plate; y of F0 for a plate that stands upright across x.
        let along = |axis: Vector3<f64>| (axis - z * z.dot(&axis)).try_normalize(0.2);
        let x = along(Vector3::x())
            .or_else(|| along(Vector3::y()))
            .unwrap_or_else(Vector3::x);
        let frame = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
        Rotation3::from_axis_angle(&plate.normal(), yaw) * frame
    }

    /// The neutral pose at a sphere, elbow at 0 on arms that have one.
    pub fn neutral_pose(&self, chain: &Chain, plate: &PlatePose, sphere: &Sphere, yaw: f64) -> TcpPose {
        TcpPose {
            position: self.sphere_in_base(plate, sphere),
            rotation: self.neutral(plate, yaw),
            elbow: chain.has_elbow().then_some(0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if the plate's centre is not the spheres' centroid: the reference worlds have sphere 1
    // at (643.2624, 0.0606, 320) mm.
    #[test]
    fn spheres_lie_where_the_reference_worlds_have_them() {
        let cell = Cell::iiwa7();
        let first = cell.sphere_in_base(&cell.plates[0], &cell.spheres[0]);
        let reference = Vector3::new(0.6432623870588056, 0.06059075984904305e-3, 0.320);
        assert!((first - reference).norm() < 1e-9, "{first}");
    }

    #[test]
    fn neutral_points_down() {
        let cell = Cell::iiwa7();
        let neutral = cell.neutral(&cell.plates[0], PI);
        let wanted = Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, -1.0));
        assert!((neutral.matrix() - wanted).amax() < 1e-12);
    }

    #[test]
    fn senseless_cells_are_refused() {
        let mut cell = Cell::iiwa7();
        cell.spheres[1].position_m[2] = f64::NAN;
        assert!(matches!(cell.check(), Err(PlanError::OutOfRange { .. })));
        cell.spheres.clear();
        assert_eq!(cell.check(), Err(PlanError::NoSpheres));
    }
}
