//! A loop that becomes unstable: the brakes close, in every phase.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::{Command, Fault, Phase};

use crate::testing::{Bench, HOME};

/// Lets torques act 8 ms later from now on, gives the arm a little push, and runs until
/// the brakes close. Returns the speed of the fastest joint, in rad/s.
fn late(bench: &mut Bench) -> f64 {
    bench.delay = 8;
    bench.push = Vector3::new(0.3, 0.3, 0.0);
    bench.run(20);
    bench.push = Vector3::zeros();
    let mut fastest = 0.0f64;
    for _ in 0..3_000 {
        bench.run(1);
        fastest = fastest.max(bench.dq.amax());
        if !bench.command.enable {
            return fastest;
        }
    }
    panic!("no brakes: {fastest} rad/s, {:?}", bench.faults());
}

// Fails if the brakes stay open while a late drive makes a hold oscillate, if a joint
// gets faster than 1.5 rad/s before, or if the fault does not say so.
#[test]
fn a_hold_that_oscillates_is_braked() {
    let mut bench = Bench::new(Bench::fast_procedure());
    let fastest = late(&mut bench);
    assert!(fastest < 1.5, "{fastest} rad/s");
    let report = bench.faults()[0];
    assert_eq!((report.fault, report.phase), (Fault::Unstable, Phase::Idle));
    assert!(report.joint > 0 && report.value.abs() > report.limit, "{report:?}");
    // The brakes stay closed until the host clears the fault.
    bench.delay = 0;
    bench.run(1_000);
    assert!(!bench.command.enable);
    bench.controller.command(Command::ClearFault).expect("a fault");
    bench.run(1_000);
    assert!(bench.command.enable && bench.dq.amax() < 1e-3);
    assert_eq!(bench.faults().len(), 1);
}

// Fails if the brakes stay open when the hold after another fault oscillates.
#[test]
fn the_fault_phase_is_braked_too() {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.host = false;
    bench.go(&HOME).expect("idle");
    let mut target = HOME;
    target[0] = 1.5;
    bench.until(Phase::Idle, 1_000);
    bench.go(&target).expect("idle");
    bench.until_fault(5_000);
    assert_eq!(bench.faults()[0].fault, Fault::HostSilence);
    bench.run(1_000);
    let fastest = late(&mut bench);
    assert!(fastest < 1.5, "{fastest} rad/s");
    assert_eq!(bench.faults().len(), 1, "one fault is reported once");
}

// Fails if a push, or one that ends, on a sound arm closes the brakes.
#[test]
fn a_push_on_a_sound_arm_is_no_instability() {
    let mut bench = Bench::new(Bench::fast_procedure());
    for newton in [20.0, -40.0, 0.0, 40.0, 0.0] {
        bench.push = Vector3::new(0.3 * newton, newton, 0.0);
        bench.run(400);
        assert!(bench.command.enable, "{newton} N: {:?}", bench.faults());
    }
    assert!(bench.faults().is_empty(), "{:?}", bench.faults());
}
