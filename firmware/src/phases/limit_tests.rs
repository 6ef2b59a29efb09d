//! What equals a limit of a phase is allowed, and the next number beyond it is not.
//!
//! The numbers are binary fractions where sums must be exact, and each distance lies along one axis,
//! so that its norm is exact.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::Fault;

use super::approach::{Approaching, Taring};
use super::couple::{Coupling, Verifying};
use super::pull::Pull;
use super::scene::Scene;
use super::{Activity, CartesianState, Decoupling, Moving, Next, RecordingPose};
use crate::law::JointSetpoint;
use crate::safety::Ends;
use crate::testing::HOME;

fn next(limit: f64) -> f64 {
    limit * (1.0 + f64::EPSILON)
}

fn fault(next: &Next<7>) -> Option<Fault> {
    match next {
        Next::Fail(found) => Some(found.fault),
        _ => None,
    }
}

/// A scene with the TCP at the origin, and its Cartesian state.
fn origin() -> (Scene, CartesianState<7>) {
    let mut scene = Scene::new();
    scene.snapshot.tcp.position = Vector3::zeros();
    scene.period_s = 1.0 / 1024.0;
    let cartesian = scene.engaged(-Vector3::z());
    (scene, cartesian)
}

// Fails if the tare is a fault at its limit, or begins or ends another tick than the first at its time.
#[test]
fn of_the_tare() {
    let tare = |limit: fn(f64) -> f64| {
        let (mut scene, mut cartesian) = origin();
        scene.external[1] = 5.0;
        let size = scene.snapshot.point_force(&scene.external).norm();
        scene.procedure.approach.tare_limit_n = limit(size);
        scene.procedure.approach.tare_s = 0.5;
        let mut phase = Taring::default();
        scene.elapsed_s = 0.3;
        assert!(matches!(phase.step(&scene.env(), &mut cartesian), Next::Stay));
        scene.elapsed_s = 0.8;
        let end = phase.step(&scene.env(), &mut cartesian);
        (
            cartesian.tare.force.norm() == size,
            fault(&end),
            matches!(end, Next::Enter(Activity::Approaching(_), None)),
        )
    };
    assert_eq!(tare(|size| size), (true, None, true));
    // What is refused is not compensated.
    let below = |size: f64| size * (1.0 - f64::EPSILON);
    assert_eq!(tare(below), (false, Some(Fault::Tare), false));
}

// Fails if travel, plate or lag of an approach are a fault at their limits; or if a force of exactly
// 2 N counts as a contact.
#[test]
fn of_an_approach() {
    let step = |down: f64, up: f64, plate: f64| {
        let (mut scene, mut cartesian) = origin();
        scene.procedure.approach.travel_m = 0.25;
        scene.procedure.approach.speed_m_s = 1e-30;
        scene.procedure.limits.path_m = 0.5;
        scene.procedure.limits.plate_offset_m = -plate;
        let mut phase = Approaching::new(&scene.env(), &cartesian);
        scene.snapshot.tcp.position = Vector3::new(0.0, 0.0, up - down);
        fault(&phase.step(&scene.env(), &mut cartesian))
    };
    assert_eq!(
        (step(0.25, 0.0, 1.0), step(next(0.25), 0.0, 1.0)),
        (None, Some(Fault::NoContact))
    );
    assert_eq!(
        (step(0.125, 0.0, 0.125), step(next(0.125), 0.0, 0.125)),
        (None, Some(Fault::NoContact))
    );
    assert_eq!(
        (step(0.0, 0.5, 1.0), step(0.0, next(0.5), 1.0)),
        (None, Some(Fault::PathDeviation))
    );
    let kept = |newton: f64| {
        let (mut scene, mut cartesian) = origin();
        scene.wrench.force.y = newton;
        cartesian.setpoint.position.x = 0.5;
        let mut phase = Approaching::new(&scene.env(), &cartesian);
        phase.step(&scene.env(), &mut cartesian);
        cartesian.setpoint.feed_forward[0] > 0.0
    };
    assert!(kept(2.0) && !kept(next(2.0)));
}

// Fails if a nest counts as lost at the limit of its way, or if a hold or a pull lasts a tick more or
// less than its time.
#[test]
fn of_the_coupling() {
    for (searches, most) in [(0, 0.015), (1, 0.035)] {
        let step = |moved: f64| {
            let (mut scene, mut cartesian) = origin();
            scene.snapshot.tcp.position.y = moved;
            fault(&Coupling::after(searches).step(&scene.env(), &mut cartesian))
        };
        assert_eq!((step(most), step(next(most))), (None, Some(Fault::NotSeated)));
    }
    let verify = |moved: f64, elapsed_s: f64| {
        let (mut scene, mut cartesian) = origin();
        scene.procedure.couple.searches = 0;
        let mut phase = Verifying::after(0, Pull::new(Vector3::zeros()));
        scene.snapshot.tcp.position.y = moved;
        scene.elapsed_s = elapsed_s;
        phase.step(&scene.env(), &mut cartesian)
    };
    assert!(matches!(verify(0.0015, 0.5), Next::Stay));
    assert_eq!(fault(&verify(next(0.0015), 0.5)), Some(Fault::NotSeated));
    assert!(matches!(verify(0.0, 0.6), Next::Enter(Activity::Coupled, Some(_))));
}

// Fails if a recording is lost at the limit of its place or of its pull, starts anew at three times the
// speed of a still arm, or has another number of samples than the procedure says.
#[test]
fn of_a_recording() {
    let record = |moved: f64, pulled: f64, speed: f64| {
        let (mut scene, mut cartesian) = origin();
        scene.procedure.record.samples = 4;
        scene.procedure.seating.check_s = 0.5;
        scene.procedure.seating.check_m = 0.25;
        scene.procedure.turn.still_rad_s = 0.0625;
        let mut phase = RecordingPose::new(1, &scene.env(), &mut cartesian);
        let still = crate::law::Impedance::new(crate::law::Stiffness::isotropic(5.0, 200.0));
        cartesian.impedance = still;
        scene.joint_speed = 0.0625;
        // Still for 20 ms: at the 21st tick.
        for tick in 1..=21 {
            assert_eq!(phase.count(), 0, "tick {tick}");
            phase.step(&scene.env(), &mut cartesian);
        }
        assert_eq!(phase.count(), 1);
        scene.joint_speed = speed;
        scene.snapshot.tcp.position.y = moved;
        for _ in 2..=4 {
            if let Some(fault) = fault(&phase.step(&scene.env(), &mut cartesian)) {
                return (phase.count(), Some(fault), false);
            }
        }
        let count = phase.count();
        scene.snapshot.tcp.position.y = moved + pulled;
        scene.elapsed_s = 0.25;
        if let Some(fault) = fault(&phase.step(&scene.env(), &mut cartesian)) {
            return (count, Some(fault), false);
        }
        scene.elapsed_s = 0.5;
        let end = phase.step(&scene.env(), &mut cartesian);
        (
            count,
            fault(&end),
            matches!(end, Next::Enter(Activity::Coupled, Some(_))),
        )
    };
    assert_eq!(record(2e-4, 0.0, 0.1875), (4, None, true));
    assert_eq!(record(next(2e-4), 0.0, 0.0), (1, Some(Fault::ContactLost), false));
    assert_eq!(record(0.0, 0.1875, 0.0), (4, None, true));
    assert_eq!(record(0.0, next(0.1875), 0.0), (4, None, false), "it must come back");
    assert_eq!(record(0.0, 0.75, 0.0), (4, None, false));
    assert_eq!(record(0.0, next(0.75), 0.0), (4, Some(Fault::ContactLost), false));
    assert_eq!(record(0.0, 0.0, next(0.1875)).0, 0, "it starts anew");
}

/// A recording that waits for rest does so until `last_s`, and no longer.
fn waits_until(last_s: f64, phase: &mut RecordingPose<7>, scene: &mut Scene, cartesian: &mut CartesianState<7>) {
    for (elapsed_s, late) in [(last_s, false), (next(last_s), true)] {
        scene.elapsed_s = elapsed_s;
        let found = fault(&phase.step(&scene.env(), cartesian));
        assert_eq!(found, late.then_some(Fault::MotionTimeout));
    }
}

// Fails if recordings that begin anew may go on for longer, or not for as long, as a turn may settle and
// two recordings take; or if the first one may wait longer than a turn may settle.
#[test]
fn of_recordings_that_begin_anew() {
    let (mut scene, mut cartesian) = origin();
    scene.procedure.record.samples = 512;
    scene.procedure.turn.settle_s = 2.5;
    let begun = |scene: &mut Scene, cartesian: &mut CartesianState<7>| {
        let mut phase = RecordingPose::new(1, &scene.env(), cartesian);
        cartesian.impedance = crate::law::Impedance::new(crate::law::Stiffness::isotropic(5.0, 200.0));
        (scene.joint_speed, scene.elapsed_s) = (0.0, 0.0);
        for _ in 0..30 {
            phase.step(&scene.env(), cartesian);
        }
        assert!(phase.count() > 0);
        scene.joint_speed = 1.0;
        phase
    };
    // Two recordings take a second.
    for (elapsed_s, late) in [(3.5, false), (next(3.5), true)] {
        let mut phase = begun(&mut scene, &mut cartesian);
        scene.elapsed_s = elapsed_s;
        let next = phase.step(&scene.env(), &mut cartesian);
        assert_eq!((fault(&next), phase.count()), (late.then_some(Fault::MotionTimeout), 0));
        if let Next::Fail(found) = next {
            let limit = 3.0 * scene.procedure.turn.still_rad_s;
            assert_eq!((found.value, found.limit), (1.0, limit));
        }
    }
    let mut phase = RecordingPose::new(1, &scene.env(), &mut cartesian);
    waits_until(2.5, &mut phase, &mut scene, &mut cartesian);
}

// Fails if a recording that begins anew may wait for rest for another time than a turn may settle, from where the last
// one began.
#[test]
fn of_the_wait_for_a_further_recording() {
    let (mut scene, mut cartesian) = origin();
    scene.procedure.record.samples = 512;
    scene.procedure.turn.settle_s = 2.5;
    let mut phase = RecordingPose::new(1, &scene.env(), &mut cartesian);
    cartesian.impedance = crate::law::Impedance::new(crate::law::Stiffness::isotropic(5.0, 200.0));
    (scene.joint_speed, scene.elapsed_s) = (0.0, 1.0);
    for _ in 0..30 {
        phase.step(&scene.env(), &mut cartesian);
    }
    assert!(phase.count() > 0);
    scene.joint_speed = 1.0;
    phase.step(&scene.env(), &mut cartesian);
    assert_eq!(phase.count(), 0);
    waits_until(3.5, &mut phase, &mut scene, &mut cartesian);
}

// Fails if a phase on a sphere may leave a joint's range, or if one in free space or on its way off may not come back.
#[test]
fn of_the_ends_of_ranges() {
    let (scene, mut cartesian) = origin();
    let leaving = Activity::<7>::Decoupling(Decoupling::new(&scene.env(), &mut cartesian));
    assert_eq!(leaving.ends(), Ends::Leave);
    assert_eq!(Activity::<7>::Idle.ends(), Ends::Return);
    assert_eq!(Activity::<7>::Coupled.ends(), Ends::Keep);
}

// Fails if a motion is off its path at the limit, or if the time to settle of a motion or of the way
// off a sphere is another one: half a second is 512 periods, and the next one is too late.
#[test]
fn of_motions() {
    let path = |off: f64| {
        let mut scene = Scene::new();
        let mut hold = JointSetpoint { q: HOME, dq: [0.0; 7] };
        let mut phase = Moving::new(HOME, HOME, &scene.env());
        scene.snapshot.q[2] = off;
        fault(&phase.step(&scene.env(), &mut hold))
    };
    assert_eq!((path(-0.1), path(next(-0.1))), (None, Some(Fault::PathDeviation)));
    let mut scene = Scene::new();
    scene.period_s = 1.0 / 1024.0;
    scene.procedure.motion.settle_s = 0.5;
    let mut hold = JointSetpoint { q: HOME, dq: [0.0; 7] };
    let mut phase = Moving::new(HOME, HOME, &scene.env());
    scene.snapshot.q[2] = 0.05;
    let late = (1..2_000).find(|_| fault(&phase.step(&scene.env(), &mut hold)) == Some(Fault::MotionTimeout));
    assert_eq!(late, Some(513));
    let (mut scene, mut cartesian) = origin();
    scene.procedure.decouple.settle_s = 0.5;
    scene.procedure.decouple.retreat_m = 1e-6;
    let mut phase = Decoupling::new(&scene.env(), &mut cartesian);
    let late = (1..2_000).find(|_| fault(&phase.step(&scene.env(), &mut cartesian)) == Some(Fault::StillCoupled));
    assert_eq!(late, Some(513));
}
