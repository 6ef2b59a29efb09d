//! An arm that presses on something, or is pressed on, in a motion.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::{Command, Fault, Phase};

use crate::testing::{Bench, HOME};

/// A bench whose arm moves.
fn moving() -> Bench {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.run(300);
    let mut target = HOME;
    target[0] += 0.8;
    bench.go(&target).expect("idle");
    bench.run(300);
    assert_eq!(bench.controller.phase(), Phase::Moving);
    bench
}

// Fails if a push that lasts does not stop a free motion, or one that is short or weak
// does.
#[test]
fn a_push_that_lasts_stops_a_free_motion() {
    for (newton, ticks) in [(30.0, 30), (10.0, 600)] {
        let mut bench = moving();
        bench.push = Vector3::new(0.0, -newton, 0.0);
        bench.run(ticks);
        bench.push = Vector3::zeros();
        bench.until(Phase::Idle, 10_000);
        assert!(bench.faults().is_empty(), "{newton} N: {:?}", bench.faults());
    }
    let mut bench = moving();
    bench.push = Vector3::new(0.0, -25.0, 0.0);
    let from = bench.tick;
    bench.until_fault(500);
    // The observer takes 15 ms to show 15 N of 25.
    assert!((51..90).contains(&(bench.tick - from)), "{} ms", bench.tick - from);
    let report = bench.faults()[0];
    assert!(report.value > 15.0 && report.limit == 15.0, "{report:?}");
    bench.expect_fault(Fault::Pressing, Phase::Moving);
}

// Fails if the arm presses on against a push after the fault, if it runs away from it, or
// if it does not hold still once the push is over.
#[test]
fn the_hold_gives_way_to_a_push_and_to_nothing_else() {
    let mut bench = moving();
    bench.push = Vector3::new(0.0, 0.0, 30.0);
    bench.until_fault(500);
    assert_eq!(bench.faults()[0].fault, Fault::Pressing);
    let from = bench.tcp();
    let mut fastest = 0.0f64;
    let mut last = from;
    for _ in 0..200 {
        bench.run(1);
        fastest = fastest.max((bench.tcp() - last).norm() * 1e3);
        last = bench.tcp();
    }
    let given = bench.tcp() - from;
    assert!(given.z > 0.01, "it gives way: {given:?} m");
    assert!(fastest < 0.3, "{fastest} m/s");
    // It does not give way for ever.
    bench.run(5_000);
    let most = (bench.tcp() - from).norm();
    assert!(most < 0.15, "{most} m");
    bench.push = Vector3::zeros();
    bench.run(2_000);
    let there = bench.tcp();
    bench.run(1_000);
    assert!((bench.tcp() - there).norm() < 1e-4, "it holds");
    // A weak force does not move it away.
    bench.push = Vector3::new(0.0, 3.0, 0.0);
    bench.run(3_000);
    assert!((bench.tcp() - there).norm() < 0.01, "{:?}", bench.tcp() - there);
}

// Fails if anything of the fault stays after it is cleared: the hold is as stiff as
// before, the next motion arrives, and a push is judged anew.
#[test]
fn nothing_of_it_stays_after_the_fault_is_cleared() {
    let mut bench = moving();
    bench.push = Vector3::new(0.0, -25.0, 0.0);
    bench.until_fault(500);
    bench.push = Vector3::zeros();
    bench.run(1_000);
    bench.controller.command(Command::ClearFault).expect("a fault");
    bench.run(500);
    let from = bench.tcp();
    bench.push = Vector3::new(0.0, -12.0, 0.0);
    bench.run(2_000);
    let gave = (bench.tcp() - from).norm();
    assert!(gave < 0.02, "{gave} m: a stiff hold");
    bench.push = Vector3::zeros();
    bench.run(1_000);
    bench.go(&HOME).expect("idle");
    bench.until(Phase::Idle, 10_000);
    assert_eq!(bench.faults().len(), 1);
}

// Fails if the approach is judged by the guard of free motions, or if a nest that does not come
// off its sphere is pulled with more than the magnet explains.
#[test]
fn a_seated_nest_may_bear_more_and_an_approach_is_judged_by_its_trigger() {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.approach().expect("idle");
    bench.until(Phase::Approaching, 2_000);
    bench.push = Vector3::new(25.0, 0.0, 0.0);
    bench.run(100);
    assert!(bench.faults().is_empty(), "{:?}", bench.faults());

    // The sphere does not let go of the nest.
    let mut bench = Bench::coupled();
    bench.hold_n = 1e9;
    bench.controller.command(Command::Decouple).expect("coupled");
    bench.until_fault(5_000);
    let report = bench.faults()[0];
    assert_eq!((report.fault, report.phase), (Fault::Pressing, Phase::Decoupling));
    assert!(
        (34.0..40.0).contains(&report.value) && report.limit == 34.0,
        "{report:?}"
    );
    // The arm gives way: it no longer pulls.
    bench.run(1_000);
    let pull = bench.controller.contact_force().norm();
    assert!(pull < 10.0, "{pull} N");
}
