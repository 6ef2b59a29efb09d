//! What tare and descent do, tick by tick.

use super::*;
use crate::phases::Departed;
use crate::phases::scene::Scene;
use crate::testing::HOME;

const ALONG: Vector3<f64> = Vector3::new(0.48, -0.6, -0.64);
const ACROSS: Vector3<f64> = Vector3::new(0.8, 0.0, 0.6);

/// The force that keeps the line after each of `ticks` ticks, with the TCP `aside` (m) of it. The TCP stands, so that
/// a force that is felt is a contact.
fn line_force(scene: &Scene, aside: f64, ticks: u32) -> std::vec::Vec<Vector3<f64>> {
    let mut cartesian = scene.engaged(ALONG);
    cartesian.tare.force = Vector3::new(1.0, -2.0, 3.0);
    cartesian.setpoint.feed_forward = cartesian.compensation(Vector3::zeros());
    cartesian.setpoint.position += ACROSS * aside;
    let mut phase = Approaching::new(&scene.env(), &cartesian);
    (0..ticks)
        .map(|_| {
            assert!(matches!(phase.step(&scene.env(), &mut cartesian), Next::Stay));
            let force = cartesian.setpoint.feed_forward;
            Vector3::new(force[0], force[1], force[2]) + cartesian.tare.force
        })
        .collect()
}

// Fails if the force that keeps the line is not the integral of the error across it, has a part
// along it, or exceeds 10 N: 1 cm and 8 times 100 N/(m s) are 1 N after 0.125 s.
#[test]
fn the_force_that_keeps_the_line_is_an_integral() {
    let mut scene = Scene::new();
    scene.wrench.force = Vector3::new(1.0, -2.0, 3.0);
    for (k, force) in line_force(&scene, 0.01, 1_000).iter().enumerate() {
        let expected = ACROSS * (8e-3 * (k + 1) as f64);
        assert!((force - expected).norm() < 1e-12, "{force} after {k} ticks");
    }
    let most = line_force(&scene, 0.1, 200);
    assert!((most[123] - ACROSS * 9.92).norm() < 1e-9);
    assert!((most[199] - ACROSS * 10.0).norm() < 1e-9, "{}", most[199]);
}

// Fails if that force grows on while a contact is felt, or stands still without one: a contact
// is 2 N beyond the tare.
#[test]
fn a_contact_may_push_the_nest_off_its_line() {
    let mut scene = Scene::new();
    for (newton, felt) in [(1.99, false), (2.01, true)] {
        scene.wrench.force = Vector3::new(1.0, -2.0, 3.0) + ACROSS * newton;
        let force = line_force(&scene, 0.01, 100)[99];
        let expected = if felt { 0.0 } else { 0.8 };
        assert!((force.norm() - expected).abs() < 1e-12, "{newton} N: {force}");
    }
}

// Fails if the fault without a sphere reports another travel than that from the start, or
// another limit than the way to the plate or the longest way, whichever ends first.
#[test]
fn the_limit_of_the_travel_is_where_the_plate_is() {
    let fault = |travelled: f64, plate: f64| {
        let mut scene = Scene::new();
        scene.procedure.approach.travel_m = 0.08;
        scene.procedure.limits.path_m = 1.0;
        let mut cartesian = scene.engaged(-Vector3::z());
        let mut phase = Approaching::new(&scene.env(), &cartesian);
        scene.procedure.limits.plate_offset_m = cartesian.setpoint.position.z - plate;
        scene.snapshot.tcp.position.z -= travelled;
        match phase.step(&scene.env(), &mut cartesian) {
            Next::Fail(found) => {
                assert_eq!((found.fault, found.joint), (Fault::NoContact, 0));
                assert!((found.value - travelled).abs() < 1e-12);
                Some(found.limit)
            }
            _ => None,
        }
    };
    assert!((fault(0.05, 0.03).expect("beyond the plate") - 0.03).abs() < 1e-12);
    assert!((fault(0.081, 0.2).expect("too far") - 0.08).abs() < 1e-12);
    assert_eq!(fault(0.05, 0.06), None);
}

// Fails if the deviation from the path is not the distance of TCP and setpoint.
#[test]
fn a_nest_that_does_not_follow_is_noticed() {
    for (metres, fails) in [(0.0299, false), (0.0301, true)] {
        let mut scene = Scene::new();
        scene.procedure.limits.path_m = 0.03;
        let mut cartesian = scene.engaged(-Vector3::z());
        let mut phase = Approaching::new(&scene.env(), &cartesian);
        scene.snapshot.tcp.position.z += metres;
        let next = phase.step(&scene.env(), &mut cartesian);
        assert_eq!(
            matches!(&next, Next::Fail(v) if v.fault == Fault::PathDeviation && v.limit == 0.03),
            fails
        );
    }
}

// Fails if the tare is taken before the observer has settled, is not the mean of its time, or
// is refused at another size than the limit.
#[test]
fn the_tare_is_the_mean_after_the_observer_has_settled() {
    let tare = |before: f64, during: f64| {
        let mut scene = Scene::new();
        let mut cartesian = scene.engaged(-Vector3::z());
        let mut phase = Taring::default();
        for k in 0..=800 {
            scene.elapsed_s = f64::from(k) * 1e-3;
            let newton = if k < 300 { before } else { during };
            scene.external = of_force(&scene, Vector3::new(newton, 0.0, 0.0));
            match phase.step(&scene.env(), &mut cartesian) {
                Next::Stay => assert!(k < 800, "0.3 s to settle and 0.5 s for the tare"),
                Next::Enter(Activity::Approaching(_), None) => {
                    assert_eq!(k, 800);
                    let stiffness = cartesian.impedance.stiffness().translation;
                    let expected = nalgebra::Matrix3::from_diagonal(&Vector3::new(400.0, 400.0, 200.0));
                    assert!((stiffness - expected).norm() < 1e-9);
                    return Ok(cartesian.tare.force.x);
                }
                Next::Fail(found) => {
                    assert_eq!((found.fault, found.limit), (Fault::Tare, 12.0));
                    return Err(found.value);
                }
                Next::Enter(..) => panic!("another phase"),
            }
        }
        panic!("no tare");
    };
    // A force that joint torques show is damped by a few percent.
    let found = tare(50.0, 11.9).expect("a tare");
    assert!((11.0..11.9).contains(&found), "{found}");
    let found = tare(0.0, 13.1).expect_err("too large");
    assert!((12.0..13.1).contains(&found), "{found}");
}

/// External joint torque of a force at the TCP (F0, in N), in N m.
fn of_force(scene: &Scene, force: Vector3<f64>) -> SVector<f64, 7> {
    scene.snapshot.jacobian.fixed_rows::<3>(0).transpose() * force
}

/// Another posture than home.
fn elsewhere() -> Scene {
    let mut q = HOME;
    q[1] -= 0.4;
    q[3] -= 0.3;
    Scene::at(&q, &[0.0; 7])
}

/// The tare (N) and what is taken out as known (N m) of an arm that feels `external` (N m) here and felt `before`
/// elsewhere, where its last motion began; or the size that is refused.
fn tared(external: SVector<f64, 7>, before: SVector<f64, 7>) -> Result<(f64, SVector<f64, 7>), f64> {
    let mut scene = Scene::new();
    scene.departed = Some(Departed {
        external: before,
        force: elsewhere().snapshot.point_force(&before),
    });
    scene.external = external;
    scene.elapsed_s = 1.0;
    let mut cartesian = scene.engaged(-Vector3::z());
    match Taring::default().step(&scene.env(), &mut cartesian) {
        Next::Enter(Activity::Approaching(_), None) => Ok((cartesian.tare.force.norm(), cartesian.explained)),
        Next::Fail(found) if found.fault == Fault::Tare => Err(found.value),
        other => panic!("{other:?}"),
    }
}

// Fails if a bias of a torque sensor is refused as a push, or a push or a wrong mass passes as a bias: a bias is the
// same joint torque in another posture, a mass is the same force.
#[test]
fn a_bias_is_no_push() {
    let mut bias = SVector::zeros();
    bias[1] = 12.0;
    let (force, known) = tared(bias, bias).expect("a bias");
    assert_eq!((force, known), (0.0, bias));
    let newton = tared(bias, SVector::zeros()).expect_err("it was not there before");
    assert!(newton > 12.0, "{newton} N");
    let weight = Vector3::new(0.0, 0.0, -15.0);
    let found = tared(of_force(&Scene::new(), weight), of_force(&elsewhere(), weight)).expect_err("a mass");
    assert!((found - 15.0).abs() < 1.0, "{found} N");
}

// Fails if a part of the external torque at rest is neither tare nor known, or in both.
#[test]
fn all_that_is_felt_at_rest_is_tare_or_known() {
    let scene = Scene::new();
    let cable = SVector::from([0.0, 0.0, 0.0, 0.0, 0.0, 1.5, -1.5]);
    let external = cable + of_force(&scene, Vector3::new(0.0, 0.0, -5.0));
    let (force, known) = tared(external, SVector::zeros()).expect("a tare");
    assert!((known[6] + 1.5).abs() < 0.2, "{known}");
    let rest = scene.snapshot.point_force(&(external - known)).norm();
    assert!((rest - force).abs() < 0.1 * force, "{rest} N, {force} N");
}

// Fails if a TCP that moves freely has the soft spring of a contact, if one that something stops keeps the stiff one,
// or if a force that was there in free motion counts as a contact.
#[test]
fn what_stops_the_tcp_makes_the_spring_soft() {
    let mut scene = Scene::new();
    scene.procedure.limits.path_m = 1.0;
    let mut cartesian = scene.engaged(-Vector3::z());
    let mut phase = Approaching::new(&scene.env(), &cartesian);
    let mut across = |scene: &Scene, ticks: u32| {
        for _ in 0..ticks {
            assert!(matches!(phase.step(&scene.env(), &mut cartesian), Next::Stay));
            cartesian.impedance.force(&scene.snapshot, &cartesian.setpoint, 0.7);
        }
        cartesian.impedance.stiffness().translation[(0, 0)]
    };
    scene.snapshot.velocity[2] = -0.025;
    scene.wrench.force.z = 5.0;
    across(&scene, 2_000);
    scene.wrench.force.z = 8.0;
    scene.snapshot.velocity[2] = 0.0;
    assert_eq!(across(&scene, 150), 50.0);
    scene.wrench.force.z = 5.0;
    assert_eq!(across(&scene, 150), 400.0, "the error of a sensor");
}
