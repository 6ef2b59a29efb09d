//! Every fault that the controller declares, and the hold that follows.

use nalgebra::Vector3;
use spherecal_shared::protocol::drive::DriveStatus;
use spherecal_shared::protocol::host::{Command, Fault, Phase};

use crate::testing::{Bench, HOME};

/// Runs until the fault phase, at most so many ticks.
fn until_fault(bench: &mut Bench, ticks: u32) {
    for _ in 0..ticks {
        if bench.controller.phase() == Phase::Fault {
            return;
        }
        bench.run(1);
    }
}

#[test]
fn a_blocked_arm_deviates_from_its_path() {
    let mut procedure = Bench::brisk();
    // Farther on, the springs push on what blocks with more than the force limit.
    procedure.limits.path_rad = 0.02;
    let mut bench = Bench::new(procedure);
    let mut target = HOME;
    target[0] = 1.0;
    bench.go(&target).expect("idle");
    bench.blocked = true;
    until_fault(&mut bench, 5_000);
    bench.expect_fault(Fault::PathDeviation, Phase::Moving);
}

#[test]
fn a_move_that_does_not_settle_times_out() {
    let mut bench = Bench::new(Bench::brisk());
    let mut target = HOME;
    target[0] = 0.05;
    bench.go(&target).expect("idle");
    bench.blocked = true;
    until_fault(&mut bench, 3_000);
    bench.expect_fault(Fault::MotionTimeout, Phase::Moving);
}

#[test]
fn an_absurd_tare_is_refused() {
    let mut bench = Bench::new(Bench::brisk());
    // 1.5 kg that nobody declared: the sensors carry its weight.
    bench.push = Vector3::new(0.0, 0.0, -14.7);
    bench.run(500);
    bench.approach().expect("idle");
    until_fault(&mut bench, 2_000);
    bench.expect_fault(Fault::Tare, Phase::Taring);
}

#[test]
fn a_sphere_that_is_not_there_is_not_touched() {
    let mut bench = Bench::new(Bench::brisk());
    bench.approach().expect("idle");
    until_fault(&mut bench, 20_000);
    bench.expect_fault(Fault::NoContact, Phase::Approaching);
}

#[test]
fn an_arm_that_hangs_on_the_way_deviates() {
    let mut procedure = Bench::brisk();
    procedure.approach.trigger_n = 60.0;
    let mut bench = Bench::new(procedure);
    bench.sphere = Some(bench.tcp() - Vector3::z() * 0.015);
    bench.approach().expect("idle");
    until_fault(&mut bench, 20_000);
    bench.expect_fault(Fault::PathDeviation, Phase::Approaching);
}

#[test]
fn a_nest_that_wanders_while_coupling_is_not_seated() {
    let mut bench = Bench::new(Bench::brisk());
    bench.sphere = Some(bench.tcp() - Vector3::z() * 0.015);
    bench.approach().expect("idle");
    bench.until(Phase::Coupling, 8_000);
    bench.sphere = None;
    bench.push = Vector3::new(15.0, 0.0, 0.0);
    until_fault(&mut bench, 3_000);
    bench.expect_fault(Fault::NotSeated, Phase::Coupling);
}

#[test]
fn a_loose_nest_fails_the_test_pull() {
    let mut bench = Bench::new(Bench::brisk());
    bench.sphere = Some(bench.tcp() - Vector3::z() * 0.015);
    bench.approach().expect("idle");
    bench.until(Phase::Coupling, 8_000);
    // The sphere goes; 5 N/m hold the arm nearly where it is.
    bench.sphere = None;
    until_fault(&mut bench, 3_000);
    // Found loose by the pull, and by every search for the seat after it.
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
        until_fault(&mut bench, 2_000);
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
    until_fault(&mut bench, 5_000);
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
        // Someone keeps rocking the elbow.
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
    let mut procedure = Bench::brisk();
    procedure.limits.force_n = 400.0;
    let mut bench = Bench::new(procedure);
    bench.sphere = Some(bench.tcp() - Vector3::z() * 0.015);
    bench.hold_n = 1e6;
    bench.approach().expect("idle");
    bench.until(Phase::Coupled, 8_000);
    bench.controller.command(Command::Decouple).expect("coupled");
    until_fault(&mut bench, 6_000);
    bench.expect_fault(Fault::StillCoupled, Phase::Decoupling);
}

#[test]
fn a_silent_host_is_noticed_while_it_is_needed() {
    let mut bench = Bench::coupled();
    bench.host = false;
    until_fault(&mut bench, 3_000);
    bench.expect_fault(Fault::HostSilence, Phase::Coupled);
    // An idle arm waits for ever.
    let mut bench = Bench::new(Bench::brisk());
    bench.host = false;
    bench.run(5_000);
    assert!(bench.faults().is_empty());
}

#[test]
fn stale_states_are_bridged_then_refused() {
    let mut bench = Bench::new(Bench::brisk());
    let state = bench.state();
    let torque = bench.command.tau.clone();
    for missed in 1..=3 {
        bench.tick_with(&state);
        assert_eq!(bench.command.tau, torque, "the last torque stands");
        assert!(bench.faults().is_empty(), "{missed} repeated states are bridged");
    }
    bench.tick_with(&state);
    bench.expect_fault(Fault::StaleState, Phase::Idle);
}

#[test]
fn a_gap_in_the_ticks_is_a_fault_when_it_is_long() {
    let mut bench = Bench::new(Bench::brisk());
    bench.tick += 3;
    bench.run(10);
    assert!(bench.faults().is_empty());
    assert_eq!(bench.controller.statistics().missed, 3);
    bench.tick += 10;
    bench.run(1);
    bench.expect_fault(Fault::StaleState, Phase::Idle);
}

#[test]
fn what_is_not_a_number_never_reaches_the_law() {
    let mut bench = Bench::new(Bench::brisk());
    for k in 0..4 {
        bench.tick += 1;
        let mut state = bench.state();
        match k % 3 {
            0 => state.q[2] = f64::NAN,
            1 => state.dq[0] = f64::INFINITY,
            _ => state.tau[6] = f64::NEG_INFINITY,
        }
        bench.tick_with(&state);
    }
    bench.expect_fault(Fault::NotFinite, Phase::Idle);
    let mut bench = Bench::new(Bench::brisk());
    for _ in 0..4 {
        bench.tick += 1;
        let mut state = bench.state();
        state.q.pop();
        bench.tick_with(&state);
    }
    bench.expect_fault(Fault::NotFinite, Phase::Idle);
}

#[test]
fn a_drive_that_is_not_ready_is_a_fault() {
    for status in [DriveStatus::Disabled, DriveStatus::EmergencyStop, DriveStatus::Failed] {
        let mut bench = Bench::new(Bench::brisk());
        bench.status = status;
        bench.run(1);
        bench.expect_fault(Fault::Drive, Phase::Idle);
    }
}

#[test]
fn missed_periods_are_counted_then_refused() {
    let mut bench = Bench::new(Bench::brisk());
    bench.controller.missed(2);
    bench.run(1);
    assert!(bench.faults().is_empty());
    assert_eq!(bench.controller.statistics().missed, 2);
    bench.controller.missed(4);
    bench.run(1);
    bench.expect_fault(Fault::Overrun, Phase::Idle);
}

// Fails if the number of missed ticks that is borne is not the configured one.
#[test]
fn how_many_ticks_may_be_missed_is_configured() {
    for allowed in [0, 3, 7] {
        let mut procedure = Bench::brisk();
        procedure.limits.missed_ticks = allowed;
        let mut bench = Bench::new(procedure);
        for _ in 0..allowed {
            bench.controller.missed(1);
        }
        bench.run(1);
        assert!(bench.faults().is_empty(), "{allowed} are borne");
        bench.controller.missed(1);
        bench.run(1);
        let faults = bench.faults();
        assert_eq!(faults.len(), 1);
        assert_eq!((faults[0].fault, faults[0].limit), (Fault::Overrun, f64::from(allowed)));
    }
}

#[test]
fn joint_limits_are_kept() {
    let mut bench = Bench::new(Bench::brisk());
    bench.q[1] = 2.2;
    bench.run(1);
    let faults = bench.faults();
    assert_eq!((faults[0].fault, faults[0].joint), (Fault::JointPosition, 2));
    let mut bench = Bench::new(Bench::brisk());
    bench.dq[4] = 2.4;
    bench.run(1);
    let faults = bench.faults();
    assert_eq!((faults[0].fault, faults[0].joint), (Fault::JointVelocity, 5));
    bench.run(2_000);
    assert!(bench.dq.norm() < 1e-3);
}

#[test]
fn a_force_that_lasts_is_a_fault_an_impact_is_not() {
    let mut bench = Bench::new(Bench::brisk());
    bench.push = Vector3::new(150.0, 0.0, 0.0);
    bench.run(5);
    bench.push = Vector3::zeros();
    bench.run(200);
    assert!(bench.faults().is_empty(), "{:?}", bench.faults());
    bench.push = Vector3::new(0.0, 0.0, -150.0);
    until_fault(&mut bench, 500);
    bench.expect_fault(Fault::Force, Phase::Idle);
}

#[test]
fn a_torque_that_stays_saturated_is_a_fault() {
    let mut bench = Bench::new(Bench::brisk());
    let mut robot = spherecal_shared::robot::iiwa7();
    robot.joints[1].limits.torque_nm = 10.0;
    bench.controller.command(Command::Robot(robot)).expect("idle");
    let configure = Command::Configure {
        tool: spherecal_shared::robot::iiwa7_tool(),
        procedure: Bench::brisk(),
    };
    bench.controller.command(configure).expect("idle");
    until_fault(&mut bench, 500);
    let faults = bench.faults();
    assert_eq!((faults[0].fault, faults[0].joint), (Fault::JointTorque, 2));
}
