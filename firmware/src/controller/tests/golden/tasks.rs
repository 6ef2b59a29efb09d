//! Runs that end as they should: motions, spheres, poses, hands.

use nalgebra::Vector3;
use spherecal_shared::Joints;
use spherecal_shared::protocol::host::{Command, Phase, PoseCommand};

use super::starts::{approach, at, at_by, described, fresh, idle_by, moving_by, procedure, sent_along};
use super::{Scenario, recover};
use crate::testing::{Bench, HOME};

pub(super) const ALL: &[Scenario] = &[
    ("a motion", || {
        let mut bench = moving_by(procedure());
        bench.until(Phase::Idle, 8_000);
        bench.go(&HOME).expect("idle");
        bench.until(Phase::Idle, 8_000);
        bench
    }),
    ("a motion to the ends of the joints", || {
        let mut bench = described(
            |robot| {
                robot.joints[0].limits.max_rad = 0.6;
                robot.joints[4].limits.min_rad = -0.4;
            },
            procedure(),
        );
        let mut target = HOME;
        (target[0], target[4]) = (0.57, -0.37);
        bench.go(&target).expect("idle");
        bench.until(Phase::Idle, 8_000);
        bench
    }),
    ("a motion towards a bound and the plate", || {
        let mut procedure = procedure();
        procedure.motion.speed_rad_s = 1.4;
        let tcp = Bench::new(procedure).tcp();
        procedure.limits.workspace_max_m[1] = tcp.y + 0.25;
        procedure.limits.plate_offset_m = tcp.z - 0.06;
        let mut bench = idle_by(procedure);
        let mut target = HOME;
        target[0] = 0.35;
        bench.go(&target).expect("idle");
        bench.until(Phase::Idle, 9_000);
        (target[0], target[1]) = (0.0, 0.75);
        bench.go(&target).expect("idle");
        bench.until(Phase::Idle, 9_000);
        bench
    }),
    ("a motion at its soft speed and force", || {
        let mut procedure = procedure();
        procedure.limits.soft_speed_m_s = 0.2;
        procedure.limits.soft_force_n = 9.0;
        let mut bench = moving_by(procedure);
        bench.push = Vector3::new(3.0, -10.0, 2.0);
        bench.run(400);
        bench.push = Vector3::zeros();
        bench.until(Phase::Idle, 12_000);
        bench
    }),
    ("a sphere with three poses", || {
        let mut bench = at(Phase::Coupled);
        for (angle, record) in [(0.25, true), (-0.2, false), (0.1, true)] {
            bench.pose(angle, record).expect("coupled");
            bench.until(Phase::Coupled, 6_000);
        }
        bench.controller.command(Command::Decouple).expect("coupled");
        bench.until(Phase::Idle, 6_000);
        bench.run(100);
        bench
    }),
    ("the way to a sphere", || {
        let mut bench = fresh(sent_along(at(Phase::Idle), [0.0, 0.0, -1.0]));
        bench.until(Phase::Coupled, 6_000);
        bench
    }),
    ("a sphere aside", || {
        let mut bench = fresh(sent_along(at(Phase::Idle), [0.48, -0.36, -0.8]));
        bench.until(Phase::Coupled, 6_000);
        pose(&mut bench, 0.15, Some(0.2), true);
        bench.until(Phase::Coupled, 6_000);
        bench.controller.command(Command::Decouple).expect("coupled");
        bench.run(1_500);
        bench
    }),
    ("a sphere ahead", || {
        let mut bench = fresh(sent_along(at(Phase::Idle), [0.6, 0.8, 0.0]));
        bench.run(2_500);
        bench
    }),
    ("a push across the line of an approach", || {
        let mut bench = fresh(sent_along(at(Phase::Idle), [0.0, 0.0, -1.0]));
        bench.sphere = None;
        bench.until(Phase::Approaching, 3_000);
        bench.push += Vector3::new(1.2, -0.9, 0.0);
        bench.run(1_500);
        bench
    }),
    ("poses without an elbow and with a posture", || {
        let mut bench = at(Phase::Coupled);
        pose(&mut bench, 0.1, None, true);
        bench.until(Phase::Coupled, 6_000);
        posture(&mut bench, 0.1);
        bench.run(2_500);
        bench
    }),
    ("a pose with a turned elbow", || {
        let mut bench = at(Phase::Coupled);
        pose(&mut bench, -0.1, Some(0.3), true);
        bench.run(4_000);
        bench
    }),
    ("a fast turn is slowed down", || {
        let mut procedure = procedure();
        procedure.turn.speed_rad_s = 1.0;
        procedure.turn.acceleration_rad_s2 = 3.0;
        procedure.limits.velocity_share = 0.3;
        let mut bench = at_by(procedure, Phase::Coupled);
        bench.pose(0.5, true).expect("coupled");
        bench.run(2_500);
        bench
    }),
    ("a recording without a pull", || {
        let mut procedure = procedure();
        procedure.seating.check_s = 0.0;
        let mut bench = at_by(procedure, Phase::Recording);
        bench.until(Phase::Coupled, 3_000);
        bench
    }),
    ("a recording that begins anew", || {
        let mut bench = at(Phase::Recording);
        bench.run(130);
        bench.dq[2] += 0.05;
        bench.run(600);
        bench
    }),
    ("a recording with missing states", || {
        let mut bench = at(Phase::Recording);
        bench.run(120);
        bench.tick += 2;
        bench.run(600);
        bench
    }),
    ("a search that finds the sphere", || {
        let mut bench = at(Phase::Coupling);
        bench.sphere = None;
        bench.until(Phase::Verifying, 3_000);
        bench.until(Phase::Coupling, 3_000);
        bench.run(300);
        bench.sphere = Some(bench.tcp() + Vector3::new(5e-4, 0.0, -1e-3));
        bench.until(Phase::Coupled, 8_000);
        bench
    }),
    ("a search along a slope", || {
        let mut bench = fresh(sent_along(at(Phase::Idle), [0.48, -0.6, -0.64]));
        bench.until(Phase::Coupling, 6_000);
        bench.sphere = None;
        bench.until(Phase::Verifying, 3_000);
        bench.until(Phase::Coupling, 3_000);
        bench.run(200);
        bench.sphere = Some(bench.tcp());
        bench.run(3_700);
        bench
    }),
    ("a hand that guides", || {
        let mut bench = at(Phase::Idle);
        let guide = |on| Command::HandGuide { on };
        bench.controller.command(guide(true)).expect("idle");
        for push in [[0.0, 20.0, 0.0], [25.0, 0.0, -15.0], [-10.0, -25.0, 5.0], [0.0; 3]] {
            bench.push = Vector3::from(push);
            bench.run(1_000);
        }
        bench.controller.command(guide(false)).expect("guiding");
        bench.run(200);
        bench
    }),
    ("a hand that leads to the ends of the joints", || {
        let mut bench = described(
            |robot| {
                robot.joints[0].limits.max_rad = 0.3;
                robot.joints[1].limits.max_rad = 1.0;
                robot.joints[3].limits.min_rad = -1.5;
            },
            procedure(),
        );
        bench.controller.command(Command::HandGuide { on: true }).expect("idle");
        for push in [[0.0, 25.0, 0.0], [20.0, 25.0, -25.0], [-35.0, 10.0, 0.0]] {
            bench.push = Vector3::from(push);
            bench.run(2_000);
        }
        bench
    }),
    ("a hand that pulls hard", || {
        let mut bench = at(Phase::Idle);
        bench.controller.command(Command::HandGuide { on: true }).expect("idle");
        bench.push = Vector3::new(45.0, 0.0, -45.0);
        bench.run(1_000);
        bench.push = Vector3::new(-30.0, -60.0, 20.0);
        bench.run(300);
        bench.push = Vector3::zeros();
        recover(bench)
    }),
    ("a retreat", || {
        let mut bench = at(Phase::Idle);
        let direction = [0.0, 0.6, -0.8];
        bench.controller.command(Command::Retreat { direction }).expect("idle");
        bench.until(Phase::Idle, 6_000);
        bench
    }),
    ("a way off a soft spring", || {
        let mut procedure = procedure();
        procedure.decouple.stiffness_n_m = 800.0;
        let mut bench = at_by(procedure, Phase::Decoupling);
        bench.until(Phase::Idle, 8_000);
        bench
    }),
    ("a stop in every phase", || {
        use Phase::{Approaching, Coupled, Coupling, Decoupling, Moving, Recording, Turning};
        let mut last = at(Phase::Idle);
        for phase in [Moving, Approaching, Coupling, Coupled, Turning, Recording, Decoupling] {
            let mut bench = at(phase);
            bench.digest = last.digest;
            bench.controller.command(Command::Stop).expect("always");
            bench.run(150);
            last = bench;
        }
        last
    }),
    ("a sphere that is left after a stop", || {
        let mut bench = at(Phase::Coupled);
        bench.controller.command(Command::Stop).expect("always");
        bench.run(300);
        bench.controller.command(Command::Decouple).expect("it may hang there");
        bench.until(Phase::Idle, 6_000);
        bench
    }),
    ("a second sphere", || {
        let mut bench = at(Phase::Decoupling);
        bench.until(Phase::Idle, 6_000);
        bench.run(200);
        bench.push = Vector3::new(-0.5, 0.6, 1.5);
        bench.run(400);
        approach(&mut bench, [0.0, 0.0, -1.0]);
        bench.run(2_500);
        bench
    }),
];

fn pose(bench: &mut Bench, angle: f64, elbow_rad: Option<f64>, record: bool) {
    let (s, c) = libm::sincos(0.5 * angle);
    let pose = PoseCommand {
        pose: 9,
        orientation: [0.0, -s, c, 0.0],
        elbow_rad,
        posture: Joints::new(),
        record,
    };
    bench.controller.command(Command::Pose(pose)).expect("coupled");
}

/// A pose by a posture that turns the tool about its own axis.
fn posture(bench: &mut Bench, angle: f64) {
    let mut posture: [f64; 7] = bench.q.into();
    posture[6] += angle;
    let turned = 0.1 - angle;
    let (s, c) = libm::sincos(0.5 * turned);
    let pose = PoseCommand {
        pose: 10,
        orientation: [0.0, -s, c, 0.0],
        elbow_rad: None,
        posture: posture.into_iter().collect(),
        record: true,
    };
    bench.controller.command(Command::Pose(pose)).expect("coupled");
}
