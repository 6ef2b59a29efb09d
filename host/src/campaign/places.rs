//! Whether the spheres are still where they were.
//!
//! Every coupling tells the centre of its sphere, by the nominal model: some
//! millimetres off, and by other millimetres with the arm bent otherwise. A
//! sphere that is found farther away than that from where it was, or at another
//! distance from the others than the plate's certificate says, was displaced,
//! and recordings on both sides of that would not fit together.

use nalgebra::Vector3;

use super::{CampaignError, Stop};

/// Farthest that two couplings of a sphere may lie apart, in m: model errors
/// reach 3 mm (Table 5), either way, with room.
const MOVED_M: f64 = 0.012;

struct Place {
    sphere: u32,
    placement: u32,
    nominal: Vector3<f64>,
    measured: Vector3<f64>,
}

/// Where the spheres were found in this session.
#[derive(Default)]
pub(super) struct Places(Vec<Place>);

impl Places {
    /// Holds a coupling at `centre_m` (F0) against those before.
    pub(super) fn check(&mut self, stop: &Stop, centre_m: &[f64; 3]) -> Result<(), CampaignError> {
        let (nominal, measured) = (Vector3::from(stop.centre_m), Vector3::from(*centre_m));
        let mut known = false;
        for other in self.0.iter().filter(|p| p.placement == stop.place) {
            known |= other.sphere == stop.sphere;
            let apart_m = (measured - other.measured).norm() - (nominal - other.nominal).norm();
            if !(apart_m.abs() < MOVED_M) {
                return Err(CampaignError::Moved {
                    sphere: stop.sphere,
                    other: other.sphere,
                    by_mm: apart_m.abs() * 1e3,
                });
            }
        }
        if !known {
            self.0.push(Place {
                sphere: stop.sphere,
                placement: stop.place,
                nominal,
                measured,
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stop(sphere: u32, x: f64) -> Stop {
        Stop {
            sphere,
            place: 0,
            centre_m: [x, 0.0, 0.3],
            over_home: true,
            approach: Vec::new(),
            direction: [0.0, 0.0, -1.0],
            poses: Vec::new(),
        }
    }

    // Fails if model errors or a plate that stands elsewhere are taken for a
    // sphere that was moved, or a sphere moved by 20 mm is not noticed.
    #[test]
    fn a_sphere_that_was_moved_is_noticed() {
        let mut places = Places::default();
        places.check(&stop(1, 0.4), &[0.430, 0.02, 0.31]).expect("the first");
        places
            .check(&stop(2, 0.5), &[0.533, 0.018, 0.312])
            .expect("as far as it should");
        places
            .check(&stop(1, 0.4), &[0.425, 0.022, 0.311])
            .expect("model error");
        let error = places.check(&stop(1, 0.4), &[0.430, 0.04, 0.31]).expect_err("moved");
        assert!(error.to_string().contains("sphere 1 is 20 mm"), "{error}");
        let error = places.check(&stop(3, 0.6), &[0.650, 0.02, 0.31]).expect_err("too far");
        assert!(
            matches!(
                error,
                CampaignError::Moved {
                    sphere: 3,
                    other: 1,
                    ..
                }
            ),
            "{error}"
        );
        assert!(places.check(&stop(2, 0.5), &[f64::NAN, 0.0, 0.0]).is_err());
    }
}
