//! Where to try again when the nest did not seat.
//!
//! The same descent would end in the same way, because friction and the position of the sphere have
//! not changed. So a retry starts beside the waypoint. It uses what earlier contacts showed: the
//! offset of this sphere, or else of the others, from their waypoints. If nothing has seated yet,
//! the retries start around the waypoint. The first goes to the side where the sphere must be,
//! judged by the direction in which the nest was pushed.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::{Contact, Coupled, Fault, FaultReport, Phase};
use spherecal_shared::robot::{Robot, Tool};

use spherecal_model::chain::{Chain, TcpPose};
use spherecal_plan::Visit;

/// Radius of the circle on which retries start, in m.
const RING_M: f64 = 0.008;
/// Largest plausible correction of a waypoint, in m.
const FAR_M: f64 = 0.040;
/// Smallest motion of the nest that indicates a direction, in m.
const TOLD_M: f64 = 0.001;

/// How a coupling ended.
pub(super) enum CouplingEnd {
    /// The nest is seated, at its place.
    Seated,
    /// The nest is off the sphere: another coupling must confirm it or decide.
    Again,
    /// A fault; the arm holds.
    Fault(FaultReport),
}

/// What one descent left to learn from.
#[derive(Clone, Copy, Debug, Default)]
pub struct DescentEnd {
    /// Computed TCP where contact was declared, in m, if it was.
    pub contact_m: Option<[f64; 3]>,
    /// Computed TCP where the descent ended, in m, if it is known.
    pub end_m: Option<[f64; 3]>,
}

impl DescentEnd {
    /// From a descent's contact (`None` without one) and the last reported TCP (m).
    pub fn new(contact: Option<&Contact>, end_m: Option<[f32; 3]>) -> Self {
        Self {
            contact_m: contact.map(|c| c.tcp_m),
            end_m: end_m.map(|p| p.map(f64::from)),
        }
    }
}

/// Waypoints, corrected by earlier contacts.
#[derive(Clone, Debug, Default)]
pub struct Waypoints {
    chain: Option<Chain>,
    /// Placement of the plate in which the seats were found. A plate that was put down again has
    /// another offset.
    place: u32,
    /// Sphere, and the offset of its seat from its waypoint's line, in m.
    seats: Vec<(u32, Vector3<f64>)>,
}

impl Waypoints {
    /// For a robot with its tool. If the planner cannot compute with the robot, the waypoints stay
    /// as they are.
    pub fn new(robot: &Robot, tool: &Tool) -> Self {
        Self {
            chain: Chain::new(robot, tool).ok(),
            place: 0,
            seats: Vec::new(),
        }
    }

    /// The arm that the waypoints belong to, if the planner can compute with it.
    pub(super) fn chain(&self) -> Option<&Chain> {
        self.chain.as_ref()
    }

    /// Whether another place may help against a fault: the nest did not meet its sphere, or it bounced there until that passed for an
    /// oscillation.
    pub fn helps(report: &FaultReport) -> bool {
        match report.fault {
            Fault::NotSeated | Fault::NoContact => true,
            Fault::Unstable => report.phase == Phase::Coupling,
            _ => false,
        }
    }

    /// Takes the seat of a nest that coupled at a visit.
    pub fn seated(&mut self, visit: &Visit, coupled: &Coupled) {
        let Some(chain) = &self.chain else { return };
        let start = chain.pose(&visit.approach.joints).position;
        let found = across(&(Vector3::from(coupled.centre_m) - start), &visit.approach_direction);
        if visit.place != self.place {
            self.place = visit.place;
            self.seats.clear();
        }
        if found.norm() <= FAR_M {
            self.seats.retain(|(sphere, _)| *sphere != visit.sphere_id);
            self.seats.push((visit.sphere_id, found));
        }
    }

    /// Joint angles (rad) from which descent number `retry` (from 1) to a visit starts. `last` is
    /// the trace of the previous descent. Returns the stop's own angles if the shifted start cannot
    /// be reached.
    pub fn retry(&self, visit: &Visit, retry: u32, last: &DescentEnd) -> Vec<f64> {
        self.shifted(visit, retry, last)
            .unwrap_or_else(|| visit.approach.joints.clone())
    }

    fn shifted(&self, visit: &Visit, retry: u32, last: &DescentEnd) -> Option<Vec<f64>> {
        let chain = self.chain.as_ref()?;
        let pose = chain.pose(&visit.approach.joints);
        let direction = Vector3::from(visit.approach_direction);
        let known = self.known(visit);
        let turn = retry.saturating_sub(1 + u32::from(known.is_some()));
        let mut shift = known.unwrap_or_default();
        if known.is_none() || retry > 1 {
            let towards = told(&pose.position, visit, last).unwrap_or_else(|| {
                let side = across(&Vector3::x(), &visit.approach_direction);
                if side.norm() > 0.1 {
                    side
                } else {
                    across(&Vector3::y(), &visit.approach_direction)
                }
            });
            // The next of three places around it.
            let (sine, cosine) = libm::sincos(core::f64::consts::TAU / 3.0 * f64::from(turn));
            let towards = towards.normalize();
            shift += (towards * cosine + direction.cross(&towards) * sine) * RING_M;
        }
        let target = TcpPose {
            position: pose.position + shift,
            ..pose
        };
        let joints = chain.follow(&target, &visit.approach.joints)?;
        (chain.limit_margin(&joints) >= 0.0).then_some(joints)
    }

    /// Offset of a sphere from its waypoint's line, in m; else the mean offset of the others.
    fn known(&self, visit: &Visit) -> Option<Vector3<f64>> {
        if visit.place != self.place {
            return None;
        }
        if let Some((_, own)) = self.seats.iter().find(|(sphere, _)| *sphere == visit.sphere_id) {
            return Some(*own);
        }
        let sum: Vector3<f64> = self.seats.iter().map(|(_, seat)| seat).sum();
        (!self.seats.is_empty()).then(|| across(&(sum / self.seats.len() as f64), &visit.approach_direction))
    }
}

/// The part of a vector across a unit direction.
fn across(vector: &Vector3<f64>, direction: &[f64; 3]) -> Vector3<f64> {
    let direction = Vector3::from(*direction);
    vector - direction * direction.dot(vector)
}

/// Direction of the sphere from the descent that began at `start`, across the approach. A nest that
/// moved away after contact slid off on the far side of the sphere. A nest that was pushed aside
/// before contact was pushed towards it.
fn told(start: &Vector3<f64>, visit: &Visit, last: &DescentEnd) -> Option<Vector3<f64>> {
    let contact = Vector3::from(last.contact_m?);
    if let Some(end) = last.end_m {
        let slid = across(&(Vector3::from(end) - contact), &visit.approach_direction);
        if slid.norm() > TOLD_M {
            return Some(-slid);
        }
    }
    let pushed = across(&(contact - start), &visit.approach_direction);
    (pushed.norm() > TOLD_M).then_some(pushed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use spherecal_plan::Waypoint;
    use spherecal_shared::robot::{iiwa7, iiwa7_tool};

    fn visit(sphere: u32) -> Visit {
        Visit {
            sphere_id: sphere,
            place: 0,
            position_m: [0.5, 0.0, 0.3],
            over_home: true,
            approach: Waypoint {
                joints: vec![0.1, 0.6, -0.1, -1.5, 0.05, 1.0, 0.2],
                ..Waypoint::default()
            },
            approach_direction: [0.0, 0.0, -1.0],
            poses: Vec::new(),
        }
    }

    fn shift(waypoints: &Waypoints, visit: &Visit, retry: u32, last: &DescentEnd) -> Vector3<f64> {
        let chain = Chain::new(&iiwa7(), &iiwa7_tool()).expect("a chain");
        let (from, to) = (
            chain.pose(&visit.approach.joints),
            chain.pose(&waypoints.retry(visit, retry, last)),
        );
        assert!(
            (from.rotation.matrix() - to.rotation.matrix()).norm() < 1e-9,
            "the tool keeps its orientation"
        );
        to.position - from.position
    }

    // Fails if a retry starts where the first attempt did, if the three around a waypoint are not
    // on a circle about it, or if the first does not go against the slide.
    #[test]
    fn nothing_known_is_searched_around_the_waypoint() {
        let waypoints = Waypoints::new(&iiwa7(), &iiwa7_tool());
        let visit = visit(1);
        let slid = DescentEnd {
            contact_m: Some([0.5, 0.0, 0.3]),
            end_m: Some([0.5, 0.010, 0.29]),
        };
        let places = [1, 2, 3].map(|k| shift(&waypoints, &visit, k, &slid));
        assert!(
            (places[0] - Vector3::new(0.0, -RING_M, 0.0)).norm() < 1e-9,
            "{}",
            places[0]
        );
        assert!((places[0] + places[1] + places[2]).norm() < 1e-9);
        assert!(places.iter().all(|p| (p.norm() - RING_M).abs() < 1e-9));
        // Without any contact there is still another place.
        assert!((shift(&waypoints, &visit, 1, &DescentEnd::default()).norm() - RING_M).abs() < 1e-9);
    }

    // Fails if a nest that bounced beside its seat tries the same descent again, or an arm that swings in free space another one.
    #[test]
    fn a_nest_that_bounced_tries_another_place() {
        let report = |fault, phase| FaultReport {
            fault,
            phase,
            time_us: 0,
            tick: 0,
            joint: 6,
            value: 0.0,
            limit: 0.0,
        };
        assert!(Waypoints::helps(&report(Fault::Unstable, Phase::Coupling)));
        assert!(Waypoints::helps(&report(Fault::NoContact, Phase::Approaching)));
        assert!(!Waypoints::helps(&report(Fault::Unstable, Phase::Moving)));
        assert!(!Waypoints::helps(&report(Fault::Drive, Phase::Coupling)));
    }

    // Fails if a retry does not go to the offset found for this sphere, or else for the others, or
    // if the retry after it goes there again.
    #[test]
    fn what_is_known_comes_first() {
        let mut waypoints = Waypoints::new(&iiwa7(), &iiwa7_tool());
        let chain = Chain::new(&iiwa7(), &iiwa7_tool()).expect("a chain");
        let start = chain.pose(&visit(1).approach.joints).position;
        let coupled = |x: f64| Coupled {
            sphere: 1,
            time_us: 0,
            centre_m: (start + Vector3::new(x, 0.004, -0.04)).into(),
            shift_m: 0.0,
            test_m: 0.0,
        };
        let none = DescentEnd::default();
        waypoints.seated(&visit(1), &coupled(0.006));
        let wanted = Vector3::new(0.006, 0.004, 0.0);
        for sphere in [1, 2] {
            assert!((shift(&waypoints, &visit(sphere), 1, &none) - wanted).norm() < 1e-9);
            let next = shift(&waypoints, &visit(sphere), 2, &none) - wanted;
            assert!((next.norm() - RING_M).abs() < 1e-9);
        }
        // One that is absurd is not believed.
        waypoints.seated(&visit(3), &coupled(0.1));
        assert!((shift(&waypoints, &visit(3), 1, &none) - wanted).norm() < 1e-9);
    }
}
