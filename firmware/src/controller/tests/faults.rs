//! The faults of each phase's task, and leaving a sphere after a fault.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::{Command, Fault, Phase, Refusal};

use crate::testing::{Bench, HOME};

#[test]
fn a_blocked_arm_deviates_from_its_path() {
    let mut procedure = Bench::fast_procedure();
    // Beyond this error the springs press.
    procedure.limits.path_rad = 0.002;
    let mut bench = Bench::new(procedure);
    let mut target = HOME;
    target[0] = 1.0;
    bench.go(&target).expect("idle");
    bench.blocked = true;
    bench.until_fault(5_000);
    bench.expect_fault(Fault::PathDeviation, Phase::Moving);
}

// Fails if a motion of a blocked arm never ends, or the joint that is held is not named.
#[test]
fn a_move_that_does_not_settle_times_out() {
    let mut procedure = Bench::fast_procedure();
    procedure.motion.tolerance_rad = 0.005;
    let mut bench = Bench::new(procedure);
    let mut target = HOME;
    target[0] = 0.01;
    bench.go(&target).expect("idle");
    bench.blocked = true;
    bench.until_fault(3_000);
    bench.expect_fault(Fault::Disturbance, Phase::Moving);
    assert_eq!(bench.faults()[0].joint, 1);
}

// Fails if an arm that something holds slows down and is never stopped.
#[test]
fn an_arm_that_does_not_get_on_is_stopped() {
    let mut procedure = Bench::fast_procedure();
    // It slows down before it presses.
    procedure.limits.soft_force_n = 1.0;
    let mut bench = Bench::new(procedure);
    let mut target = HOME;
    target[0] = 1.0;
    bench.go(&target).expect("idle");
    bench.blocked = true;
    bench.until_fault(3_000);
    bench.expect_fault(Fault::PathDeviation, Phase::Moving);
}

#[test]
fn an_absurd_tare_is_refused() {
    let mut bench = Bench::new(Bench::fast_procedure());
    // A tool of 1.5 kg that was not declared: the sensors show its weight.
    bench.push = Vector3::new(0.0, 0.0, -14.7);
    bench.run(500);
    bench.approach().expect("idle");
    bench.until_fault(2_000);
    bench.expect_fault(Fault::Tare, Phase::Taring);
}

#[test]
fn a_sphere_that_is_not_there_is_not_touched() {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.approach().expect("idle");
    bench.until_fault(20_000);
    bench.expect_fault(Fault::NoContact, Phase::Approaching);
}

#[test]
fn an_arm_that_hangs_on_the_way_deviates() {
    let mut procedure = Bench::fast_procedure();
    procedure.approach.trigger_n = 60.0;
    let mut bench = Bench::new(procedure);
    bench.sphere = Some(bench.tcp() - Vector3::z() * 0.015);
    bench.approach().expect("idle");
    bench.until_fault(20_000);
    bench.expect_fault(Fault::PathDeviation, Phase::Approaching);
}

#[test]
fn a_nest_that_wanders_while_coupling_is_not_seated() {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.sphere = Some(bench.tcp() - Vector3::z() * 0.015);
    bench.approach().expect("idle");
    bench.until(Phase::Coupling, 8_000);
    bench.sphere = None;
    bench.push = Vector3::new(15.0, 0.0, 0.0);
    bench.until_fault(3_000);
    bench.expect_fault(Fault::NotSeated, Phase::Coupling);
}

#[test]
fn a_loose_nest_fails_the_test_pull() {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.sphere = Some(bench.tcp() - Vector3::z() * 0.015);
    bench.approach().expect("idle");
    bench.until(Phase::Coupling, 8_000);
    // The sphere vanishes; 5 N/m hold the arm almost where it is.
    bench.sphere = None;
    bench.until_fault(3_000);
    // The pull finds the nest loose, also after every search.
    bench.expect_fault(Fault::NotSeated, Phase::Coupling);
}

#[test]
fn a_nest_that_leaves_is_noticed_in_every_seated_phase() {
    for phase in [Phase::Coupled, Phase::Turning, Phase::Recording] {
        let mut bench = Bench::coupled();
        if phase != Phase::Coupled {
            bench.pose(0.2, true).expect("coupled");
            bench.until(phase, 5_000);
        }
        bench.sphere = None;
        bench.push = Vector3::new(0.0, 0.0, 6.0);
        let before = bench.tick;
        bench.until_fault(2_000);
        assert!(
            bench.tick - before < 150,
            "noticed after {} ms in {phase:?}",
            bench.tick - before
        );
        bench.expect_fault(Fault::ContactLost, phase);
        assert!(bench.recordings().is_empty());
    }
}

#[test]
fn a_turn_that_never_ends_times_out() {
    let mut bench = Bench::coupled();
    bench.pose(0.1, true).expect("coupled");
    bench.blocked = true;
    bench.until_fault(5_000);
    bench.expect_fault(Fault::MotionTimeout, Phase::Turning);
}

#[test]
fn an_arm_that_never_rests_is_not_recorded() {
    let mut bench = Bench::coupled();
    bench.pose(0.1, true).expect("coupled");
    bench.until(Phase::Recording, 5_000);
    for k in 0..6_000 {
        if bench.controller.phase() == Phase::Fault {
            break;
        }
        // An external torque keeps the elbow moving.
        if k % 20 == 0 {
            bench.dq[2] += 0.04;
        }
        bench.run(1);
    }
    bench.expect_fault(Fault::MotionTimeout, Phase::Recording);
    assert!(bench.recordings().is_empty());
}

#[test]
fn a_magnet_that_does_not_let_go_is_reported() {
    let mut procedure = Bench::fast_procedure();
    // So soft that the arm pulls less than it may.
    procedure.decouple.stiffness_n_m = 300.0;
    let mut bench = Bench::new(procedure);
    bench.sphere = Some(bench.tcp() - Vector3::z() * 0.015);
    bench.hold_n = 1e6;
    bench.approach().expect("idle");
    bench.until(Phase::Coupled, 8_000);
    bench.controller.command(Command::Decouple).expect("coupled");
    bench.until_fault(6_000);
    bench.expect_fault(Fault::StillCoupled, Phase::Decoupling);
}

#[test]
fn a_silent_host_is_noticed_while_it_is_needed() {
    let mut bench = Bench::coupled();
    bench.host = false;
    bench.until_fault(3_000);
    bench.expect_fault(Fault::HostSilence, Phase::Coupled);
    // An idle arm may wait for ever.
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.host = false;
    bench.run(5_000);
    assert!(bench.faults().is_empty());
}

// Fails if a nest that an earlier controller left on its sphere cannot be removed.
#[test]
fn a_controller_that_knows_nothing_can_retreat() {
    let mut bench = Bench::coupled();
    let mut fresh = Bench::new(Bench::fast_procedure());
    std::mem::swap(&mut bench.controller, &mut fresh.controller);
    // The new controller has no earlier states, as after a reset.
    let robot = spherecal_shared::robot::iiwa7();
    bench.controller = crate::Controller::default();
    bench
        .controller
        .connect(&crate::testing::hello())
        .expect("a drive that fits");
    bench
        .controller
        .command(Command::Robot(robot.driven().expect("seven joints")))
        .expect("a robot");
    let configure = Command::Configure {
        tool: spherecal_shared::robot::iiwa7_tool(),
        procedure: Bench::fast_procedure(),
    };
    bench.controller.command(configure).expect("a procedure");
    bench.run(100);
    assert_eq!(bench.controller.command(Command::Decouple), Err(Refusal::Phase));
    let before = bench.tcp();
    let retreat = |direction| Command::Retreat { direction };
    assert_eq!(bench.controller.command(retreat([0.0, 0.0, 2.0])), Err(Refusal::Target));
    bench.controller.command(retreat([0.0, 0.0, -1.0])).expect("idle");
    bench.until(Phase::Idle, 10_000);
    assert!(bench.tcp().z - before.z > 0.03);
}

// Fails if a turn follows the torque of a cable (5 N m/s) too slowly,
// if a hold after a nest that has left its sphere does not go on with it, so that the cable throws a light wrist, or if that
// after another fault of the turn does: it may have met something.
#[test]
fn what_a_turn_learns_of_a_cable_stays_where_the_nest_has_left() {
    const CABLE_NM: f64 = 1.5;
    for leaves in [true, false] {
        let mut bench = Bench::coupled_by(Bench::fast_procedure());
        bench.pose(0.3, true).expect("coupled");
        bench.until(Phase::Turning, 100);
        let before = bench.controller.disturbance.torque()[6];
        // The sensor shows less than the law gives, as if something pulled the joint on.
        for share in 1..=300 {
            bench.torque_bias[6] = -CABLE_NM * f64::from(share) / 300.0;
            bench.run(1);
        }
        let learned = bench.controller.observer.known()[6];
        let beyond = CABLE_NM - bench.controller.safety.limits()[6].sensor_error_nm();
        assert!(learned > 0.55 * beyond, "{learned} of {beyond} N m");
        if leaves {
            bench.sphere = None;
            bench.push = Vector3::new(0.0, 0.0, 6.0);
            bench.until_fault(2_000);
            bench.expect_fault(Fault::ContactLost, Phase::Turning);
        } else {
            bench.blocked = true;
            bench.until_fault(10_000);
            bench.expect_fault(Fault::JointTorque, Phase::Turning);
        }
        let kept = before - bench.controller.disturbance.torque()[6];
        assert!(
            if leaves { kept > 0.55 * beyond } else { kept.abs() < 0.1 },
            "{kept} N m"
        );
    }
}
