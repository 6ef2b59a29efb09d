//! Checks whether the spheres are still where they were.
//!
//! Every coupling gives the centre of its sphere by the nominal model. That centre is some
//! millimetres off, and the error changes with the arm's posture: most where a joint has an offset.
//! The plate or a sphere was moved if the centre is farther than that from its earlier position, or if
//! its distance to the other spheres contradicts the plate's certificate. Recordings from before and after the move would not
//! fit together.

use nalgebra::Vector3;

use spherecal_shared::protocol::host::Coupled;
use spherecal_shared::robot::Pose;

use super::CampaignError;
use spherecal_model::chain::Chain;
use spherecal_plan::{Plan, Visit};

/// Largest distance between two couplings of a sphere, in m, with joints that have no offsets. Model
/// errors reach 3 mm (Table 5) in either direction; the rest is margin.
const MOVED_M: f64 = 0.012;
/// Joint offset that is taken for a model error, in rad: on six real Franka arms offsets of up to
/// 21 mrad were measured. Those of several joints seldom add up, so they count as root of squares.
const OFFSET_RAD: f64 = 0.025;

struct Place {
    sphere: u32,
    placement: u32,
    nominal: Vector3<f64>,
    measured: Vector3<f64>,
    /// How the computed TCP moves with each joint, in m/rad.
    columns: Vec<Vector3<f64>>,
}

/// Where the spheres were found in this run.
#[derive(Default)]
pub(super) struct Places {
    chain: Option<Chain>,
    known: Vec<Place>,
}

impl Places {
    /// Recalls what earlier sessions of the run found, in that order. A sphere that was found
    /// displaced stopped its session and is not used as a reference. `chain` is the nominal arm.
    pub(super) fn recall(plan: &Plan, seated: &[Coupled], chain: Option<&Chain>) -> Self {
        let mut places = Self {
            chain: chain.cloned(),
            ..Self::default()
        };
        for coupled in seated {
            if let Some(visit) = first_visit(plan, coupled) {
                let _ = places.check(visit, &coupled.centre_m);
            }
        }
        places
    }

    /// The spheres that were found with the plate in `placement`, and their centres in F0, in m.
    pub(super) fn found(&self, placement: u32) -> Vec<(u32, Vector3<f64>)> {
        let here = self.known.iter().filter(|place| place.placement == placement);
        here.map(|place| (place.sphere, place.measured)).collect()
    }

    /// Compares a coupling at `centre_m` (F0) with earlier ones.
    pub(super) fn check(&mut self, visit: &Visit, centre_m: &[f64; 3]) -> Result<(), CampaignError> {
        let (nominal, measured) = (Vector3::from(visit.position_m), Vector3::from(*centre_m));
        let columns = self.columns(&visit.approach.joints);
        let mut known = false;
        for other in self.known.iter().filter(|p| p.placement == visit.place) {
            known |= other.sphere == visit.sphere_id;
            let apart_m = (measured - other.measured).norm() - (nominal - other.nominal).norm();
            let differ = columns.iter().zip(&other.columns).map(|(a, b)| (a - b).norm_squared());
            let most = MOVED_M + OFFSET_RAD * differ.sum::<f64>().sqrt();
            if !(apart_m.abs() < most) {
                return Err(CampaignError::Moved {
                    sphere: visit.sphere_id,
                    other: other.sphere,
                    by_mm: apart_m.abs() * 1e3,
                });
            }
        }
        if !known {
            self.known.push(Place {
                sphere: visit.sphere_id,
                placement: visit.place,
                nominal,
                measured,
                columns,
            });
        }
        Ok(())
    }

    /// How the computed TCP moves with each joint at `joints` (rad), in m/rad. Empty without an arm.
    fn columns(&self, joints: &[f64]) -> Vec<Vector3<f64>> {
        let Some(chain) = self.chain.as_ref().filter(|chain| chain.dof() == joints.len()) else {
            return Vec::new();
        };
        let frames = chain.frames(joints);
        let tcp = chain.tcp_of(&frames);
        let moves = |frame: &Pose<f64>| frame.z().cross(&(tcp - frame.position));
        frames.iter().take(joints.len()).map(moves).collect()
    }
}

/// The first visit of the plan at the sphere of a coupling and in its placement: the plate may have
/// several, which are far from each other.
pub(super) fn first_visit<'p>(plan: &'p Plan, coupled: &Coupled) -> Option<&'p Visit> {
    let away = |visit: &&Visit| (Vector3::from(visit.position_m) - Vector3::from(coupled.centre_m)).norm();
    let of_sphere = plan.spheres.iter().filter(|visit| visit.sphere_id == coupled.sphere);
    of_sphere.min_by(|a, b| away(a).total_cmp(&away(b)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use spherecal_plan::Waypoint;

    fn visit(sphere: u32, x: f64) -> Visit {
        Visit {
            sphere_id: sphere,
            place: 0,
            position_m: [x, 0.0, 0.3],
            over_home: true,
            approach: Waypoint {
                joints: Vec::new(),
                ..Waypoint::default()
            },
            approach_direction: [0.0, 0.0, -1.0],
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
        let plan = Plan {
            spheres: vec![visit(1, 0.4), visit(2, 0.5)],
            ..Plan::default()
        };
        let earlier = [found(1, 0.43, 0.02), found(2, 0.53, 0.04 + MOVED_M * 4.0)];
        let mut places = Places::recall(&plan, &earlier, None);
        assert!(
            places.check(&plan.spheres[0], &[0.43, 0.04, 0.31]).is_err(),
            "moved since"
        );
        places
            .check(&plan.spheres[1], &[0.533, 0.018, 0.312])
            .expect("put right since");
    }

    // Fails if model errors or another placement of the plate are taken for a moved sphere, or if a
    // sphere moved by 20 mm is not noticed.
    #[test]
    fn a_sphere_that_was_moved_is_noticed() {
        let mut places = Places::default();
        places.check(&visit(1, 0.4), &[0.430, 0.02, 0.31]).expect("the first");
        places
            .check(&visit(2, 0.5), &[0.533, 0.018, 0.312])
            .expect("as far as it should");
        places
            .check(&visit(1, 0.4), &[0.425, 0.022, 0.311])
            .expect("model error");
        let error = places.check(&visit(1, 0.4), &[0.430, 0.04, 0.31]).expect_err("moved");
        assert!(error.to_string().contains("sphere 1 is 20 mm"), "{error}");
        let error = places.check(&visit(3, 0.6), &[0.650, 0.02, 0.31]).expect_err("too far");
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
        assert!(places.check(&visit(2, 0.5), &[f64::NAN, 0.0, 0.0]).is_err());
    }

    // Fails if the error that joint offsets of 20 mrad make between two postures counts as a moved
    // sphere, or if a sphere that moved as far is not noticed in one posture.
    #[test]
    fn joint_offsets_are_no_moved_sphere() {
        let (robot, tool) = (spherecal_shared::robot::iiwa7(), spherecal_shared::robot::iiwa7_tool());
        let chain = Chain::new(&robot, &tool).expect("a chain");
        let mut places = Places::recall(&Plan::default(), &[], Some(&chain));
        let at = |joints: [f64; 7]| {
            let mut visit = visit(1, 0.4);
            visit.approach.joints = joints.to_vec();
            visit
        };
        let (one, other) = (
            at([0.3, 0.4, -0.3, -1.7, 0.1, 1.0, 0.0]),
            at([-0.9, 0.6, 1.2, -1.7, 0.9, 1.2, -1.4]),
        );
        places.check(&one, &[0.4, 0.0, 0.3]).expect("the first");
        places.check(&other, &[0.418, 0.0, 0.3]).expect("offsets");
        places.check(&one, &[0.418, 0.0, 0.3]).expect_err("moved");
    }
}
