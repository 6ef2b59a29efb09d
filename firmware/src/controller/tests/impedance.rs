//! The spring that a host sets.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::{Command, Fault, ImpedanceCommand, Phase, Refusal};

use crate::law::rotation_error;
use crate::testing::{Bench, HOME};

/// A spring where the arm is.
const SPRING: ImpedanceCommand = ImpedanceCommand {
    stiffness_n_m: [400.0, 400.0, 200.0],
    rotation_nm_rad: 50.0,
    offset_m: [0.0; 3],
    turn_rad: [0.0; 3],
};

fn bench() -> Bench {
    Bench::new(Bench::fast_procedure())
}

/// Sends a spring.
fn set(bench: &mut Bench, spring: ImpedanceCommand) -> Result<(), Refusal> {
    bench.controller.command(Command::Impedance(spring))
}

// Fails if the arm does not stay where it is, if a step is not reached or overshoots, or if a push bends the arm by another
// length than the stiffness says, on each axis and after the stiffness has changed.
#[test]
fn the_spring_is_rendered() {
    let mut bench = bench();
    let start = bench.tcp();
    set(&mut bench, SPRING).expect("idle");
    bench.run(500);
    assert_eq!(bench.controller.phase(), Phase::Impedance);
    assert!((bench.tcp() - start).norm() < 1e-5);
    let offset_m = [0.0, -0.004, 0.010];
    let stepped = ImpedanceCommand { offset_m, ..SPRING };
    set(&mut bench, stepped).expect("it holds");
    let mut highest = 0.0f64;
    for _ in 0..2_000 {
        bench.run(1);
        highest = highest.max(bench.tcp().z - start.z);
    }
    let there = start + Vector3::from(offset_m);
    assert!((bench.tcp() - there).norm() < 1e-4, "{}", bench.tcp() - there);
    assert!(highest < 0.011, "{highest}");
    bench.push = Vector3::new(4.0, -2.0, 3.0);
    for stiffness_n_m in [[400.0, 400.0, 200.0], [200.0, 800.0, 400.0]] {
        set(
            &mut bench,
            ImpedanceCommand {
                stiffness_n_m,
                ..stepped
            },
        )
        .expect("it holds");
        bench.run(2_000);
        let bent = (bench.tcp() - there).component_mul(&Vector3::from(stiffness_n_m));
        assert!((bent - bench.push).norm() < 0.05, "{bent} at {stiffness_n_m:?}");
    }
    assert_eq!(bench.phases(), [Phase::Impedance]);
}

// Fails if the tool does not turn by what is asked for, about the axes of F0, with the TCP at its place.
#[test]
fn the_tool_turns() {
    let mut bench = bench();
    let start = bench.tcp();
    let before = bench.rotation();
    let turn = Vector3::new(0.1, -0.05, 0.2);
    set(
        &mut bench,
        ImpedanceCommand {
            turn_rad: turn.into(),
            ..SPRING
        },
    )
    .expect("idle");
    bench.run(3_000);
    let turned = rotation_error(&bench.rotation(), &before);
    assert!((turned - turn).norm() < 1e-3, "{turned}");
    assert!((bench.tcp() - start).norm() < 1e-4);
}

// Fails if a soft spring gives way to what held the arm before, such as a wrong mass of its tool: 3 N would lower it
// by 15 mm.
#[test]
fn a_soft_spring_takes_over_what_held_the_arm() {
    let mut bench = bench();
    bench.push = Vector3::new(0.0, 0.0, -3.0);
    bench.run(1_000);
    let start = bench.tcp();
    set(&mut bench, SPRING).expect("idle");
    bench.run(2_000);
    assert!((bench.tcp() - start).norm() < 5e-4, "{}", bench.tcp() - start);
}

// Fails if a spring out of its range is taken, if its refusal disturbs the hold, or if one begins in a motion.
#[test]
fn what_no_spring_may_be_is_refused() {
    let mut bench = bench();
    set(&mut bench, SPRING).expect("idle");
    let start = bench.tcp();
    for bad in [
        ImpedanceCommand {
            stiffness_n_m: [400.0, 5001.0, 0.0],
            ..SPRING
        },
        ImpedanceCommand {
            stiffness_n_m: [400.0, -1.0, 0.0],
            ..SPRING
        },
        ImpedanceCommand {
            rotation_nm_rad: f64::NAN,
            ..SPRING
        },
        ImpedanceCommand {
            offset_m: [0.0, 0.0, 0.31],
            ..SPRING
        },
        ImpedanceCommand {
            turn_rad: [-1.1, 0.0, 0.0],
            ..SPRING
        },
    ] {
        assert_eq!(set(&mut bench, bad), Err(Refusal::Target), "{bad:?}");
        bench.run(100);
    }
    assert!((bench.tcp() - start).norm() < 1e-5);
    bench.controller.command(Command::Stop).expect("no fault");
    bench.run(1);
    let mut target = HOME;
    target[0] += 0.1;
    bench.go(&target).expect("idle");
    assert_eq!(set(&mut bench, SPRING), Err(Refusal::Phase));
    bench.run(1);
    assert_eq!(bench.phases(), [Phase::Impedance, Phase::Idle, Phase::Moving]);
}

// Fails if the hold outlives its host, or an arm that is pushed away farther than the limit of the path stays in it.
#[test]
fn the_guards_hold() {
    let mut silent = bench();
    set(&mut silent, SPRING).expect("idle");
    silent.host = false;
    silent.until_fault(3_000);
    silent.expect_fault(Fault::HostSilence, Phase::Impedance);
    let mut pushed = bench();
    set(&mut pushed, SPRING).expect("idle");
    for newtons in 0..70 {
        pushed.push = Vector3::new(f64::from(newtons), 0.0, 0.0);
        pushed.until_fault(60);
    }
    pushed.expect_fault(Fault::PathDeviation, Phase::Impedance);
}
