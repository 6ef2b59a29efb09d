//! The same task on every kind of drive that a handshake may announce.

use spherecal_shared::protocol::drive::{DriveHello, TorqueSign};
use spherecal_shared::protocol::host::{Command, Phase};

use super::Scenario;
use super::starts::{approach, fresh, procedure, with_errors};
use crate::testing::{Bench, HOME, hello};

/// Inertia of visible motors, in kg m².
const MOTORS: [f64; 7] = [0.46, 1.1, 0.8, 0.45, 0.35, 0.35, 0.35];

pub(super) const ALL: &[Scenario] = &[
    ("a drive that is 1 ms late", || {
        on(|hello| hello.latency_us = 1_000, 1, 1_000)
    }),
    ("a drive that is 5 ms late", || {
        on(|hello| hello.latency_us = 5_000, 5, 1_000)
    }),
    ("a drive with visible motors", || {
        on(|hello| hello.motor_kg_m2 = MOTORS.into_iter().collect(), 0, 1_000)
    }),
    ("a late drive with visible motors", || {
        let change = |hello: &mut DriveHello| {
            hello.motor_kg_m2 = MOTORS.into_iter().collect();
            hello.latency_us = 2_000;
        };
        on(change, 2, 1_000)
    }),
    ("a drive that adds gravity", || {
        on(|hello| hello.compensates_gravity = true, 0, 1_000)
    }),
    ("a drive with the torques of the links", || {
        on(|hello| hello.torque_sign = TorqueSign::OfLink, 0, 1_000)
    }),
    ("a drive with tight limits", || {
        let change = |hello: &mut DriveHello| {
            hello.limits[0].max_rad = 0.25;
            hello.limits[0].velocity_rad_s = 0.4;
            hello.limits[1].torque_nm = 65.0;
        };
        on(change, 0, 1_000)
    }),
    ("a drive at 500 Hz", || on(|_| (), 0, 2_000)),
    ("a drive at 250 Hz", || on(|_| (), 0, 4_000)),
    ("a late drive at 500 Hz", || {
        on(|hello| hello.latency_us = 2_000, 1, 2_000)
    }),
    ("a drive that starts again", || {
        let mut bench = with_errors(Bench::new(procedure()));
        bench.session += 1;
        bench.tick = 0;
        bench.run(20);
        let mut again = hello();
        again.session += 1;
        bench.controller.connect(&again).expect("a drive that fits");
        bench.run(100);
        bench.controller.command(Command::ClearFault).expect("always");
        task(bench)
    }),
];

/// A motion, a contact, a pose and the way off, on the drive that `change` makes, whose torques
/// act `delay` ms late.
fn on(change: impl FnOnce(&mut DriveHello), delay: usize, period_us: u32) -> Bench {
    let mut procedure = procedure();
    // Beside visible motors the soft sphere of the bench would give way fast.
    procedure.seating.check_n = 4.0;
    let mut bench = Bench::at_period(procedure, period_us);
    let mut other = DriveHello { period_us, ..hello() };
    other.session += 1;
    change(&mut other);
    bench.controller.connect(&other).expect("a drive that fits");
    bench.session += 1;
    bench.delay = delay;
    for (motor, declared) in bench.motors.iter_mut().zip(&other.motor_kg_m2) {
        *motor = *declared;
    }
    bench.gravity_by_drive = other.compensates_gravity;
    bench.reversed = other.torque_sign == TorqueSign::OfLink;
    bench.run(10);
    bench.controller.command(Command::ClearFault).expect("always");
    task(with_errors(bench))
}

fn task(mut bench: Bench) -> Bench {
    bench = fresh(bench);
    let ticks = 1_000_000 / bench.period_us;
    let mut target = HOME;
    target[0] = 0.2;
    bench.go(&target).expect("idle");
    bench.until(Phase::Idle, 5 * ticks);
    bench.sphere = Some(bench.tcp() + nalgebra::Vector3::new(0.0, 0.0, -0.012));
    approach(&mut bench, [0.0, 0.0, -1.0]);
    bench.until(Phase::Coupled, 5 * ticks);
    bench.pose(0.3, true).expect("coupled");
    bench.until(Phase::Coupled, 5 * ticks);
    bench.controller.command(Command::Decouple).expect("coupled");
    bench.run(3 * ticks);
    bench
}
