//! From the approach frame to contact: the tare at rest, then the descent at
//! 25 mm/s with 50/50/100 N/m until the force has been 7.5 N for the dwell time.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::{Contact, Fault};

use super::{Activity, CartesianState, Coupling, Env, Next};
use crate::Report;
use crate::contact::{ContactTrigger, Tare};
use crate::law::Stiffness;
use crate::motion::LineMove;
use crate::safety::workspace_clearance;

/// Time that the observer gets to settle before the tare, in s.
const SETTLE_S: f64 = 0.3;

/// Estimated contact force above which the arm no longer corrects its line, in N.
const CONTACT_FELT_N: f64 = 2.0;
/// Largest force that keeps the arm on its line, in N. Friction of 2 N m at the
/// wrist can hold as much against it.
const LINE_N: f64 = 10.0;

/// Averages the observer's wrench at rest.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Taring {
    tare: Tare,
}

impl Taring {
    /// One tick.
    pub(crate) fn step<const N: usize>(&mut self, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Next<N> {
        let approach = &env.procedure.approach;
        if env.elapsed_s < SETTLE_S {
            return Next::Stay;
        }
        self.tare.push(&env.wrench);
        if env.elapsed_s < SETTLE_S + approach.tare_s {
            return Next::Stay;
        }
        let tare = self.tare.mean();
        let size = tare.force.norm();
        // A mean that is not a number is no tare. One that is refused is a push, not model error: the arm
        // must not compensate it on its way off.
        if !(size <= approach.tare_limit_n) {
            return Next::fail(Fault::Tare, size, approach.tare_limit_n);
        }
        cartesian.tare = tare;
        let stiffness = Stiffness::about(
            approach.stiffness_n_m,
            &cartesian.direction,
            env.procedure.law.rotation_nm_rad,
        );
        cartesian.engage(env.snapshot, stiffness);
        Next::Enter(Activity::Approaching(Approaching::new(env, cartesian)), None)
    }
}

/// Descends until contact.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Approaching {
    start: Vector3<f64>,
    line: LineMove,
    trigger: ContactTrigger,
    /// Force that keeps the arm on its line, F0, in N.
    line_force: Vector3<f64>,
}

impl Approaching {
    /// Starts at the present setpoint, along the direction of the approach.
    pub(crate) fn new<const N: usize>(env: &Env<'_, N>, cartesian: &CartesianState<N>) -> Self {
        let approach = &env.procedure.approach;
        let line = LineMove::new(
            cartesian.direction,
            approach.speed_m_s,
            approach.acceleration_m_s2,
            f64::INFINITY,
        );
        Self {
            start: cartesian.setpoint.position,
            line,
            trigger: ContactTrigger::default(),
            line_force: Vector3::zeros(),
        }
    }

    /// Increases the force that brings the arm back to its line. Once a contact
    /// force is felt, the force stays as it is, so that the sphere can push the
    /// nest sideways.
    fn keep_line<const N: usize>(&mut self, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) {
        if (env.wrench.force - cartesian.tare.force).norm() > CONTACT_FELT_N {
            return;
        }
        let error = cartesian.setpoint.position - env.snapshot.tcp.position;
        let across = error - cartesian.direction * error.dot(&cartesian.direction);
        self.line_force += across * (env.procedure.approach.line_n_m_s * env.period_s);
        let size = self.line_force.norm();
        if size > LINE_N {
            self.line_force *= LINE_N / size;
        }
        cartesian.setpoint.feed_forward = cartesian.compensation(self.line_force);
    }

    /// One tick.
    pub(crate) fn step<const N: usize>(&mut self, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Next<N> {
        let approach = &env.procedure.approach;
        let (displacement, velocity) = self.line.step(env.period_s);
        cartesian.setpoint.position = self.start + displacement;
        cartesian.setpoint.velocity.fixed_rows_mut::<3>(0).copy_from(&velocity);
        self.keep_line(env, cartesian);

        let tcp = env.snapshot.tcp.position;
        let travel = (tcp - self.start).dot(&cartesian.direction);
        let force = cartesian.contact_force(env);
        if self
            .trigger
            .push(force, env.snapshot.tcp_speed(), approach, env.period_s)
        {
            cartesian.contact = tcp;
            let contact = Contact {
                sphere: cartesian.sphere,
                time_us: env.time_us,
                force_n: force,
                peak_n: self.trigger.peak_n(),
                tare_n: cartesian.tare.force.into(),
                tcp_m: tcp.into(),
                travel_m: travel,
                latency_ticks: self.trigger.latency_ticks(),
                early_crossings: self.trigger.early_crossings(),
            };
            return Next::Enter(
                Activity::Coupling(Coupling::new(env, cartesian)),
                Some(Report::Contact(contact)),
            );
        }
        if travel > approach.travel_m {
            return Next::fail(Fault::NoContact, travel, approach.travel_m);
        }
        // The TCP is closer to the plate than any sphere: there is no sphere.
        let (left, _) = workspace_clearance(&tcp, &env.procedure.limits);
        if left < 0.0 {
            return Next::fail(Fault::NoContact, travel, travel + left);
        }
        let lag = (cartesian.setpoint.position - tcp).norm();
        if lag > env.procedure.limits.path_m {
            return Next::fail(Fault::PathDeviation, lag, env.procedure.limits.path_m);
        }
        Next::Stay
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phases::scene::Scene;

    const ALONG: Vector3<f64> = Vector3::new(0.48, -0.6, -0.64);
    const ACROSS: Vector3<f64> = Vector3::new(0.8, 0.0, 0.6);

    /// The force that keeps the line after each of `ticks` ticks, with the TCP `aside` (m) of it.
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
    // along it, or exceeds 10 N: 1 cm and 100 N/(m s) are 1 N after 1 s.
    #[test]
    fn the_force_that_keeps_the_line_is_an_integral() {
        let mut scene = Scene::new();
        scene.wrench.force = Vector3::new(1.0, -2.0, 3.0);
        for (k, force) in line_force(&scene, 0.01, 1_000).iter().enumerate() {
            let expected = ACROSS * (1e-3 * (k + 1) as f64);
            assert!((force - expected).norm() < 1e-12, "{force} after {k} ticks");
        }
        let most = line_force(&scene, 0.1, 1_400);
        assert!((most[980] - ACROSS * 9.81).norm() < 1e-9);
        assert!((most[1_399] - ACROSS * 10.0).norm() < 1e-9, "{}", most[1_399]);
    }

    // Fails if that force grows on while a contact is felt, or stands still without one: a contact
    // is 2 N beyond the tare.
    #[test]
    fn a_contact_may_push_the_nest_off_its_line() {
        let mut scene = Scene::new();
        for (newton, felt) in [(1.99, false), (2.01, true)] {
            scene.wrench.force = Vector3::new(1.0, -2.0, 3.0) + ACROSS * newton;
            let force = line_force(&scene, 0.01, 100)[99];
            let expected = if felt { 0.0 } else { 0.1 };
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
            scene.snapshot.tcp.position.x += metres;
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
                scene.wrench.force = Vector3::new(newton, 0.0, 0.0);
                match phase.step(&scene.env(), &mut cartesian) {
                    Next::Stay => assert!(k < 800, "0.3 s to settle and 0.5 s for the tare"),
                    Next::Enter(Activity::Approaching(_), None) => {
                        assert_eq!(k, 800);
                        let stiffness = cartesian.impedance.stiffness().translation;
                        let expected = nalgebra::Matrix3::from_diagonal(&Vector3::new(50.0, 50.0, 100.0));
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
        assert!((tare(50.0, 11.9).expect("a tare") - 11.9).abs() < 1e-9);
        assert!((tare(0.0, 12.1).expect_err("too large") - 12.1).abs() < 1e-9);
    }
}
