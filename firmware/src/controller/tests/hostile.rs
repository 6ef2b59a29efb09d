//! Commands with impossible numbers: refused with a reason, without effect on the
//! arm.

use proptest::prelude::*;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::{ApproachCommand, Command, Phase, PoseCommand, Refusal, START_MOST_US};
use spherecal_shared::robot::{DrivenRobot, iiwa7, iiwa7_tool};
use std::vec::Vec;

use crate::testing::{Bench, HOME};

/// One valid command of every kind that carries numbers.
fn good() -> Vec<Command> {
    let target: spherecal_shared::Joints = HOME.iter().copied().collect();
    std::vec![
        Command::Robot(iiwa7().driven().expect("seven joints")),
        Command::Configure {
            tool: iiwa7_tool(),
            procedure: Procedure::default(),
        },
        Command::Move { target: target.clone() },
        Command::Approach(ApproachCommand {
            sphere: 1,
            direction: [0.0, 0.0, -1.0],
        }),
        Command::Pose(PoseCommand {
            pose: 1,
            orientation: [0.0, 0.0, 1.0, 0.0],
            elbow_rad: Some(0.0),
            posture: target,
            record: true,
        }),
    ]
}

/// Numbers that no sensor, file or person means.
fn bad() -> impl Strategy<Value = f64> {
    prop::sample::select(std::vec![
        f64::NAN,
        -f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::MAX,
        f64::MIN,
        1e300,
        -1e300,
        1e12,
        -1e12,
        1e-310,
        -0.0,
    ])
}

/// The command with eight of its encoded bytes replaced by those of `value`.
fn spoilt(command: &Command, at: usize, value: f64) -> Option<Command> {
    let mut buffer = [0; spherecal_shared::protocol::frame::MAX_FRAME];
    let bytes = postcard::to_slice(command, &mut buffer).ok()?;
    // After the byte that says which command it is.
    let at = 1 + at % bytes.len().checked_sub(9)?.max(1);
    bytes.get_mut(at..at + 8)?.copy_from_slice(&value.to_le_bytes());
    postcard::from_bytes(bytes).ok()
}

/// Whether the commanded torques are within the limits of `robot`, the bench's arm.
fn within_limits(bench: &Bench, robot: &DrivenRobot) -> bool {
    bench
        .command
        .tau
        .iter()
        .zip(&robot.joints)
        .all(|(tau, joint)| tau.abs() <= joint.limits.torque_nm * (1.0 + 1e-12))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    // Fails if an impossible number in any field of any command causes a panic or
    // a torque that is not finite or beyond the limits, or if a refused command
    // changes what the arm does.
    #[test]
    fn no_number_of_any_command_gets_through(kind in 0usize..5, at in 0usize..2000, value in bad()) {
        let good = good();
        if let Some(command) = spoilt(&good[kind], at, value) {
            let mut bench = Bench::new(Bench::fast_procedure());
            let mut twin = Bench::new(Bench::fast_procedure());
            if bench.controller.command(command.clone()).is_err() {
                bench.run(40);
                twin.run(40);
                prop_assert_eq!(&bench.command, &twin.command, "a refused command has an effect: {:?}", command);
            } else {
                let robot = match command {
                    Command::Robot(robot) => robot,
                    _ => iiwa7().driven().expect("seven joints"),
                };
                for _ in 0..60 {
                    bench.run(1);
                    prop_assert!(within_limits(&bench, &robot), "{:?}", bench.command);
                }
            }
        }
    }
}

fn refused(command: Command) -> Refusal {
    let mut bench = Bench::coupled();
    let refusal = bench.controller.command(command).expect_err("refused");
    bench.run(200);
    assert_eq!(
        bench.controller.phase(),
        Phase::Coupled,
        "a refused command has an effect"
    );
    refusal
}

#[test]
fn what_is_out_of_range_is_refused_by_name() {
    let pose = |orientation, elbow_rad, posture: &[f64]| {
        Command::Pose(PoseCommand {
            pose: 1,
            orientation,
            elbow_rad,
            posture: posture.iter().copied().collect(),
            record: true,
        })
    };
    let down = [0.0, 0.0, 1.0, 0.0];
    assert_eq!(refused(pose([0.0; 4], None, &[])), Refusal::Target);
    assert_eq!(refused(pose([0.0, 0.0, 1.001, 0.0], None, &[])), Refusal::Target);
    assert_eq!(refused(pose([f64::NAN, 0.0, 1.0, 0.0], None, &[])), Refusal::Target);
    assert_eq!(refused(pose(down, Some(f64::INFINITY), &[])), Refusal::Target);
    assert_eq!(refused(pose(down, None, &[9.0; 7])), Refusal::Target);
    assert_eq!(refused(pose(down, None, &[0.0; 3])), Refusal::Target);
    // A posture within reach that belongs to another pose.
    let mut elsewhere = HOME;
    elsewhere[5] -= 1.0;
    assert_eq!(refused(pose(down, None, &elsewhere)), Refusal::Target);
}

#[test]
fn absurd_durations_and_stiffnesses_are_refused() {
    let mut bench = Bench::new(Bench::fast_procedure());
    let mut refuse = |spoil: fn(&mut Procedure)| {
        let mut procedure = Procedure::default();
        spoil(&mut procedure);
        let tool = iiwa7_tool();
        let refusal = bench.controller.command(Command::Configure { tool, procedure });
        assert_eq!(refusal, Err(Refusal::Procedure));
    };
    refuse(|p| p.turn.stiffness_n_m = 5001.0);
    refuse(|p| p.record.stiffness_n_m = -1.0);
    refuse(|p| p.law.rotation_nm_rad = 301.0);
    refuse(|p| p.couple.hold_s = 1e9);
    refuse(|p| p.record.samples = u32::MAX);
    refuse(|p| p.limits.host_silence_s = f64::NAN);
}

// Fails if a command that starts in a year is accepted, or if a waiting command
// starts before its time or after a newer one has replaced it.
#[test]
fn a_start_is_kept_and_an_absurd_one_refused() {
    let mut bench = Bench::new(Bench::fast_procedure());
    let mut target = HOME;
    target[0] += 0.1;
    let go = || Command::Move {
        target: target.iter().copied().collect(),
    };
    let now_us = bench.tick * 1000;
    assert!(
        bench
            .controller
            .queue_command(1, now_us + START_MOST_US + 1_000_000, &go())
    );
    let outcome = bench.controller.command_outcome().expect("at once");
    assert_eq!(outcome.result, Err(Refusal::Start));
    assert!(bench.controller.queue_command(2, now_us + 20_000, &go()));
    bench.run(19);
    assert_eq!(
        (bench.controller.phase(), bench.controller.command_outcome()),
        (Phase::Idle, None)
    );
    bench.run(1);
    assert_eq!(bench.controller.phase(), Phase::Moving);
    assert!(
        bench
            .controller
            .command_outcome()
            .is_some_and(|v| v.sequence == 2 && v.result.is_ok())
    );
    assert_eq!(bench.controller.statistics().late, 0);
    bench.until(Phase::Idle, 4_000);
    let now_us = bench.tick * 1000;
    assert!(bench.controller.queue_command(3, now_us + 20_000, &go()));
    assert!(bench.controller.queue_command(4, 0, &Command::Stop));
    bench.run(100);
    assert_eq!(bench.controller.phase(), Phase::Idle);
    assert!(bench.controller.command_outcome().is_some_and(|v| v.sequence == 4));
    assert_eq!(bench.controller.command_outcome(), None);
    // Too late: it starts at the next tick and is counted.
    let back = Command::Move {
        target: HOME.into_iter().collect(),
    };
    assert!(bench.controller.queue_command(5, now_us, &back));
    bench.run(1);
    // The arm is there already, so the move may end at once.
    assert!(
        bench
            .controller
            .command_outcome()
            .is_some_and(|v| v.sequence == 5 && v.result.is_ok())
    );
    assert_eq!(bench.controller.statistics().late, 1);
}
