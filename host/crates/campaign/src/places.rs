//! Checks whether the spheres are still where they were.
//!
//! Every coupling gives the centre of its sphere by the nominal model. That centre is some
//! millimetres off, and the error changes with the arm's posture. The plate or a sphere was moved
//! if the centre is farther than that from its earlier position, or if its distance to the other
//! spheres contradicts the plate's certificate. Recordings from before and after the move would not
//! fit together.

use nalgebra::Vector3;

use spherecal_shared::protocol::host::Coupled;

use super::{CampaignError, Stop, Tour};

/// Largest distance between two couplings of a sphere, in m. Model errors reach 3 mm (Table 5) in
/// either direction; the rest is margin.
const MOVED_M: f64 = 0.012;

struct Place {
    sphere: u32,
    placement: u32,
    nominal: Vector3<f64>,
    measured: Vector3<f64>,
}

/// Where the spheres were found in this run.
#[derive(Default)]
pub(super) struct Places(Vec<Place>);

impl Places {
    /// Recalls what earlier sessions of the run found, in that order. A sphere that was found
    /// displaced stopped its session and is not used as a reference.
    pub(super) fn recall(tour: &Tour, seated: &[Coupled]) -> Self {
        let mut places = Self::default();
        for coupled in seated {
            let away = |stop: &&Stop| (Vector3::from(stop.centre_m) - Vector3::from(coupled.centre_m)).norm();
            let of_sphere = tour.stops.iter().filter(|stop| stop.sphere == coupled.sphere);
            // The plate may have had several placements; they are far from each other.
            if let Some(stop) = of_sphere.min_by(|a, b| away(a).total_cmp(&away(b))) {
                let _ = places.check(stop, &coupled.centre_m);
            }
        }
        places
    }

    /// Compares a coupling at `centre_m` (F0) with earlier ones.
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

    // Fails if a sphere found by an earlier session is forgotten, or if a displaced sphere that
    // stopped its session is used as a reference for the next.
    #[test]
    fn what_earlier_sessions_found_counts() {
        let found = |sphere, x, y| Coupled {
            sphere,
            time_us: 0,
            centre_m: [x, y, 0.31],
            shift_m: 0.0,
            test_m: 0.0,
        };
        let tour = Tour {
            home: Vec::new(),
            stops: vec![stop(1, 0.4), stop(2, 0.5)],
        };
        let earlier = [found(1, 0.43, 0.02), found(2, 0.53, 0.04 + MOVED_M * 4.0)];
        let mut places = Places::recall(&tour, &earlier);
        assert!(
            places.check(&tour.stops[0], &[0.43, 0.04, 0.31]).is_err(),
            "moved since"
        );
        places
            .check(&tour.stops[1], &[0.533, 0.018, 0.312])
            .expect("put right since");
    }

    // Fails if model errors or another placement of the plate are taken for a moved sphere, or if a
    // sphere moved by 20 mm is not noticed.
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
