//! Which commands are refused, in which phase, and why.

use spherecal_shared::Joints;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::{ApproachCommand, Command, Phase, PoseCommand, Refusal};
use spherecal_shared::robot::{iiwa7, iiwa7_tool};

use crate::Controller;
use crate::testing::{Bench, HOME};

#[test]
fn nothing_moves_before_there_is_a_robot() {
    let mut controller = Controller::<7>::default();
    let target = Joints::from_slice(&HOME).expect("seven of eight");
    assert_eq!(
        controller.command(Command::Move { target }),
        Err(Refusal::NotConfigured)
    );
    let tool = iiwa7_tool();
    let configure = Command::Configure {
        tool,
        procedure: Procedure::default(),
    };
    assert_eq!(controller.command(configure.clone()), Err(Refusal::NotConfigured));
    let state = Bench::new(Procedure::default()).state();
    let command = controller.tick(embassy_time::Instant::from_millis(1), &state);
    assert!(!command.enable, "brakes until there is a robot");
    controller
        .command(Command::Robot(iiwa7().driven().expect("seven joints")))
        .expect("a robot");
    controller.command(configure).expect("a tool");
}

#[test]
fn bad_descriptions_are_refused() {
    let mut controller = Controller::<7>::default();
    let mut robot = iiwa7().driven().expect("seven joints");
    robot.joints[2].mdh.d = f64::NAN;
    assert_eq!(controller.command(Command::Robot(robot)), Err(Refusal::Robot));
    let mut robot = iiwa7().driven().expect("seven joints");
    robot.joints.pop();
    assert_eq!(controller.command(Command::Robot(robot)), Err(Refusal::Robot));
    controller
        .command(Command::Robot(iiwa7().driven().expect("seven joints")))
        .expect("a robot");
    let mut procedure = Procedure::default();
    procedure.turn.stiffness_n_m = -20.0;
    let configure = Command::Configure {
        tool: iiwa7_tool(),
        procedure,
    };
    assert_eq!(controller.command(configure), Err(Refusal::Procedure));
}

#[test]
fn targets_are_checked_at_the_door() {
    let mut bench = Bench::new(Bench::fast_procedure());
    let mut far = HOME;
    far[1] = 3.0;
    assert_eq!(bench.go(&far), Err(Refusal::Target), "beyond the joint's limit");
    far[1] = f64::NAN;
    assert_eq!(bench.go(&far), Err(Refusal::Target), "not a number");
    assert_eq!(bench.go(&HOME[..6]), Err(Refusal::Target), "a joint is missing");
    let crooked = ApproachCommand {
        sphere: 1,
        direction: [0.0, 0.0, -2.0],
    };
    assert_eq!(
        bench.controller.command(Command::Approach(crooked)),
        Err(Refusal::Target)
    );
    let mut bench = Bench::coupled();
    let pose = |orientation, elbow| {
        Command::Pose(PoseCommand {
            pose: 1,
            orientation,
            elbow_rad: elbow,
            posture: Joints::new(),
            record: true,
        })
    };
    let not_unit = pose([1.0, 1.0, 0.0, 0.0], None);
    assert_eq!(bench.controller.command(not_unit), Err(Refusal::Target));
    let not_finite = pose([0.0, 0.0, 1.0, 0.0], Some(f64::INFINITY));
    assert_eq!(bench.controller.command(not_finite), Err(Refusal::Target));
    assert_eq!(bench.controller.phase(), Phase::Coupled, "nothing has changed");
}

#[test]
fn commands_are_refused_in_phases_that_do_not_allow_them() {
    let mut bench = Bench::new(Bench::fast_procedure());
    assert_eq!(bench.pose(0.1, true), Err(Refusal::Phase), "not coupled");
    assert_eq!(
        bench.controller.command(Command::Decouple),
        Err(Refusal::Phase),
        "never touched"
    );
    bench.approach().expect("idle");
    assert_eq!(bench.go(&HOME), Err(Refusal::Phase));
    assert_eq!(bench.approach(), Err(Refusal::Phase));
    assert_eq!(
        bench
            .controller
            .command(Command::Robot(iiwa7().driven().expect("seven joints"))),
        Err(Refusal::Phase)
    );
    assert_eq!(
        bench.controller.command(Command::HandGuide { on: true }),
        Err(Refusal::Phase)
    );
    bench.controller.command(Command::Stop).expect("stop is always heard");
    assert_eq!(bench.controller.phase(), Phase::Idle);
    bench.go(&HOME).expect("idle again");
}

#[test]
fn a_fault_must_be_cleared_first() {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.controller.record_missed(50);
    assert_eq!(bench.controller.phase(), Phase::Fault);
    assert_eq!(bench.go(&HOME), Err(Refusal::FaultPending));
    assert_eq!(bench.controller.command(Command::Stop), Err(Refusal::FaultPending));
    bench.controller.command(Command::ClearFault).expect("a fault");
    bench.go(&HOME).expect("cleared");
}

/// Fails if a coupled arm cannot leave after a fault without homing (Section 6).
#[test]
fn after_a_fault_the_arm_decouples_and_moves_away() {
    let mut bench = Bench::coupled();
    bench.controller.record_missed(50);
    bench.run(100);
    bench.controller.command(Command::ClearFault).expect("a fault");
    bench
        .controller
        .command(Command::Decouple)
        .expect("it may hang on the sphere");
    bench.until(Phase::Idle, 6_000);
    assert!((bench.tcp() - bench.sphere.expect("a sphere")).norm() > 0.030);
    // And couples to the next sphere.
    bench.sphere = Some(bench.tcp() - nalgebra::Vector3::z() * 0.02);
    bench.approach().expect("idle");
    bench.until(Phase::Coupled, 8_000);
}
