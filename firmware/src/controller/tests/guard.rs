//! The faults that are possible in every phase: states, angles, torques, forces and
//! positions beyond their limits; and the hold after them.

use nalgebra::Vector3;
use spherecal_shared::protocol::drive::DriveStatus;
use spherecal_shared::protocol::host::{Command, Fault, Phase};

use crate::testing::{Bench, HOME};

#[test]
fn stale_states_are_bridged_then_refused() {
    let mut bench = Bench::new(Bench::fast_procedure());
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
    let mut bench = Bench::new(Bench::fast_procedure());
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
    let mut bench = Bench::new(Bench::fast_procedure());
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
    let mut bench = Bench::new(Bench::fast_procedure());
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
        let mut bench = Bench::new(Bench::fast_procedure());
        bench.status = status;
        bench.run(1);
        bench.expect_fault(Fault::Drive, Phase::Idle);
    }
}

#[test]
fn missed_periods_are_counted_then_refused() {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.controller.record_missed(2);
    bench.run(1);
    assert!(bench.faults().is_empty());
    assert_eq!(bench.controller.statistics().missed, 2);
    bench.controller.record_missed(4);
    bench.run(1);
    bench.expect_fault(Fault::Overrun, Phase::Idle);
}

// Fails if the number of missed ticks that is tolerated is not the configured one.
#[test]
fn how_many_ticks_may_be_missed_is_configured() {
    for allowed in [0, 3, 7] {
        let mut procedure = Bench::fast_procedure();
        procedure.limits.missed_ticks = allowed;
        let mut bench = Bench::new(procedure);
        for _ in 0..allowed {
            bench.controller.record_missed(1);
        }
        bench.run(1);
        assert!(bench.faults().is_empty(), "{allowed} missed ticks are a fault");
        bench.controller.record_missed(1);
        bench.run(1);
        let faults = bench.faults();
        assert_eq!(faults.len(), 1);
        assert_eq!((faults[0].fault, faults[0].limit), (Fault::Overrun, f64::from(allowed)));
    }
}

#[test]
fn joint_limits_are_kept() {
    let mut procedure = Bench::fast_procedure();
    procedure.limits.jump_rad = 10.0;
    let mut bench = Bench::new(procedure);
    bench.q[1] = 2.2;
    bench.run(1);
    let faults = bench.faults();
    assert_eq!((faults[0].fault, faults[0].joint), (Fault::JointPosition, 2));
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.dq[4] = 2.4;
    bench.run(1);
    let faults = bench.faults();
    assert_eq!((faults[0].fault, faults[0].joint), (Fault::JointVelocity, 5));
    bench.run(2_000);
    assert!(bench.dq.norm() < 1e-3);
}

// Fails if an arm in a joint's margin cannot leave its sphere, if the elbow does not turn the joint away from its
// limit against a push, or if it may enter the outer half of the margin.
#[test]
fn an_arm_in_its_margin_may_leave_its_sphere() {
    let margin = Bench::fast_procedure().limits.position_margin_rad;
    // Joint 1 stands at this share of the margin from its limit and turns outwards with this speed (rad/s), and
    // a push turns it outwards.
    let leave = |share: f64, speed: f64| {
        let mut bench = Bench::new(Bench::fast_procedure());
        let mut robot = spherecal_shared::robot::iiwa7();
        robot.joints[0].limits.max_rad = HOME[0] + share * margin;
        bench
            .controller
            .command(Command::Robot(robot.driven().expect("seven joints")))
            .expect("idle");
        let configure = Command::Configure {
            tool: spherecal_shared::robot::iiwa7_tool(),
            procedure: Bench::fast_procedure(),
        };
        bench.controller.command(configure).expect("idle");
        bench.run(10);
        let retreat = Command::Retreat {
            direction: [0.0, 0.0, -1.0],
        };
        bench.controller.command(retreat).expect("idle");
        bench.push = Vector3::new(0.0, 5.0, 0.0);
        bench.dq[0] = speed;
        bench.until_fault(2_000);
        bench
    };
    let mut bench = leave(0.95, 0.0);
    assert!(bench.faults().is_empty(), "{:?}", bench.faults());
    assert!(bench.q[0] - HOME[0] < -0.01, "{} rad outwards", bench.q[0] - HOME[0]);
    bench.until(Phase::Idle, 10_000);
    let faults = leave(0.6, 0.5).faults();
    assert_eq!((faults[0].fault, faults[0].joint), (Fault::JointPosition, 1));
}

#[test]
fn a_force_that_lasts_is_a_fault_an_impact_is_not() {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.push = Vector3::new(150.0, 0.0, 0.0);
    bench.run(5);
    bench.push = Vector3::zeros();
    bench.run(200);
    assert!(bench.faults().is_empty(), "{:?}", bench.faults());
    bench.push = Vector3::new(0.0, 0.0, -150.0);
    bench.until_fault(500);
    bench.expect_fault(Fault::Force, Phase::Idle);
}

#[test]
fn a_torque_that_stays_saturated_is_a_fault() {
    let mut bench = Bench::new(Bench::fast_procedure());
    let mut robot = spherecal_shared::robot::iiwa7();
    robot.joints[1].limits.torque_nm = 10.0;
    bench
        .controller
        .command(Command::Robot(robot.driven().expect("seven joints")))
        .expect("idle");
    let configure = Command::Configure {
        tool: spherecal_shared::robot::iiwa7_tool(),
        procedure: Bench::fast_procedure(),
    };
    bench.controller.command(configure).expect("idle");
    bench.until_fault(500);
    let faults = bench.faults();
    assert_eq!((faults[0].fault, faults[0].joint), (Fault::JointTorque, 2));
}

// Fails if an angle that jumps moves the arm, or if an angle that jumps back within
// the bridged ticks is a fault.
#[test]
fn an_angle_that_jumps_is_bridged_then_refused() {
    let mut bench = Bench::new(Bench::fast_procedure());
    for allowed in [3, 4] {
        let torque = bench.command.tau.clone();
        for k in 0..allowed {
            bench.tick += 1;
            let mut state = bench.state();
            state.q[1] += 0.1;
            bench.tick_with(&state);
            if k < 3 {
                assert_eq!(bench.command.tau, torque, "the last torque stands");
            } else {
                assert!(!bench.command.enable, "then the brakes");
            }
        }
        if allowed == 3 {
            bench.run(10);
            assert!(bench.faults().is_empty(), "three are bridged");
        }
    }
    let faults = bench.faults();
    assert_eq!((faults[0].fault, faults[0].joint), (Fault::PositionJump, 2));
    bench.expect_fault(Fault::PositionJump, Phase::Idle);
}

// Fails if torques are sent for ever without states, or if the arm is not held
// when states come again.
#[test]
fn a_blind_controller_asks_for_the_brakes() {
    let mut bench = Bench::new(Bench::fast_procedure());
    let state = bench.state();
    let blind = (0..100).find(|_| {
        bench.tick_with(&state);
        !bench.command.enable
    });
    assert_eq!(blind, Some(23), "three bridged, twenty more, then brakes");
    bench.run(1);
    assert!(bench.command.enable, "states are back");
    bench.expect_fault(Fault::StaleState, Phase::Idle);
}

#[test]
fn a_torque_that_does_not_arrive_is_a_fault() {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.torque_bias[1] = -40.0;
    bench.until_fault(200);
    assert!(bench.tick < 120, "noticed at {}", bench.tick);
    let faults = bench.faults();
    assert!(
        matches!(faults[0].fault, Fault::TorqueSensor | Fault::Force),
        "{:?}",
        faults[0]
    );
}

// Fails if an arm that holds after another fault stays held by motors that do not
// deliver the commanded torque. Found by a campaign of random faults, in which a
// weak motor first lost the sphere and then dropped the arm.
#[test]
fn a_motor_that_fails_while_the_arm_holds_gets_the_brakes() {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.controller.record_missed(10);
    bench.run(1);
    bench.expect_fault(Fault::Overrun, Phase::Idle);
    bench.run(50);
    assert!(bench.command.enable, "it holds");
    bench.torque_bias[1] = -40.0;
    bench.run(60);
    assert!(!bench.command.enable, "the brakes");
    assert_eq!(bench.faults().len(), 1, "and no other fault");
}

// Fails if the arm passes a bound of the workspace, does not slow down before it,
// or cannot come back from beyond it.
#[test]
fn the_workspace_is_not_left() {
    let mut procedure = Bench::fast_procedure();
    let wall = Bench::new(Bench::fast_procedure()).tcp().y + 0.15;
    procedure.limits.workspace_max_m[1] = wall;
    let mut bench = Bench::new(procedure);
    let mut target = HOME;
    target[0] = 1.0;
    bench.go(&target).expect("idle");
    let (mut last, mut fastest, mut near) = (bench.tcp(), 0.0f64, 0.0f64);
    for _ in 0..20_000 {
        if bench.controller.phase() == Phase::Fault {
            break;
        }
        bench.run(1);
        let speed = (bench.tcp() - last).norm() * 1e3;
        last = bench.tcp();
        fastest = fastest.max(speed);
        if last.y > wall - 0.005 {
            near = near.max(speed);
        }
    }
    let beyond = bench.tcp().y - wall;
    assert!(beyond < 0.01, "{beyond} m beyond the bound");
    assert!(
        near < 0.1 && fastest > 0.15,
        "{near} m/s at the bound, {fastest} before"
    );
    bench.expect_fault(Fault::Workspace, Phase::Moving);
    bench.controller.command(Command::ClearFault).expect("a fault");
    bench.run(10);
    bench.go(&HOME).expect("idle");
    bench.until(Phase::Idle, 20_000);
    assert_eq!(bench.faults().len(), 1, "the way back is free");
}

#[test]
fn a_tcp_that_runs_is_stopped() {
    let mut procedure = Bench::fast_procedure();
    procedure.limits.speed_m_s = 0.1;
    let mut bench = Bench::new(procedure);
    let mut target = HOME;
    target[0] = 1.0;
    bench.go(&target).expect("idle");
    bench.until_fault(5_000);
    bench.expect_fault(Fault::TcpSpeed, Phase::Moving);
}

// Fails if a free motion exceeds its soft speed by more than a quarter (the speed
// scaling takes time to act), or does not arrive.
#[test]
fn a_free_motion_keeps_its_soft_speed() {
    let run = |soft_speed_m_s: f64| {
        let mut procedure = Bench::fast_procedure();
        procedure.limits.soft_speed_m_s = soft_speed_m_s;
        let mut bench = Bench::new(procedure);
        let mut target = HOME;
        target[0] = 1.0;
        bench.go(&target).expect("idle");
        bench.run(1);
        let (mut last, mut fastest) = (bench.tcp(), 0.0f64);
        while bench.controller.phase() == Phase::Moving {
            bench.run(1);
            fastest = fastest.max((bench.tcp() - last).norm() * 1e3);
            last = bench.tcp();
        }
        bench.until(Phase::Idle, 1);
        fastest
    };
    let (free, slow) = (run(5.0), run(0.2));
    assert!(free > 0.3 && slow < 0.25, "{free} and {slow} m/s");
}
