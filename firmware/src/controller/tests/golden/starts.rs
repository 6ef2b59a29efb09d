//! Where the scenarios start: the arm with noise and model errors in every phase.

use std::sync::OnceLock;

use nalgebra::{SVector, Vector3};
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::{ApproachCommand, Command, Phase};
use spherecal_shared::robot::{Robot, iiwa7_tool};

use crate::testing::{Bench, Digest, HOME};

/// The procedure of the scenarios, with telemetry in all phases.
pub(super) fn procedure() -> Procedure {
    let mut procedure = Bench::fast_procedure();
    procedure.telemetry.other_ticks = 3;
    procedure
}

/// Adds noise, an error of the tool's mass and errors of the torque sensors.
pub(super) fn with_errors(mut bench: Bench) -> Bench {
    bench.noise = 1.0;
    bench.push = Vector3::new(0.4, -0.3, -1.0);
    bench.torque_bias = SVector::from([0.3, -0.2, 0.2, 0.15, -0.1, 0.1, -0.05]);
    bench.run(250);
    bench
}

/// An idle arm under a procedure.
pub(super) fn idle_by(procedure: Procedure) -> Bench {
    with_errors(Bench::new(procedure))
}

/// An arm that is told to approach a sphere 15 mm before its TCP.
pub(super) fn sent_along(mut bench: Bench, direction: [f64; 3]) -> Bench {
    bench.sphere = Some(bench.tcp() + Vector3::from(direction) * 0.015);
    approach(&mut bench, direction);
    bench
}

pub(super) fn approach(bench: &mut Bench, direction: [f64; 3]) {
    let command = Command::Approach(ApproachCommand { sphere: 5, direction });
    bench.controller.command(command).expect("idle");
}

/// An arm in a phase of the task, under a procedure.
pub(super) fn at_by(procedure: Procedure, phase: Phase) -> Bench {
    let mut bench = sent_along(idle_by(procedure), [0.0, 0.0, -1.0]);
    if matches!(phase, Phase::Turning | Phase::Recording) {
        bench.until(Phase::Coupled, 8_000);
        bench.pose(0.25, true).expect("coupled");
    }
    if phase == Phase::Decoupling {
        bench.until(Phase::Coupled, 8_000);
        bench.controller.command(Command::Decouple).expect("coupled");
    }
    bench.until(phase, 8_000);
    bench.run(30);
    fresh(bench)
}

/// An arm in a motion.
pub(super) fn moving_by(procedure: Procedure) -> Bench {
    let mut bench = idle_by(procedure);
    let mut target = HOME;
    (target[0], target[2], target[5]) = (0.9, -0.2, 1.4);
    bench.go(&target).expect("idle");
    bench.run(300);
    fresh(bench)
}

/// An arm in a phase, under the usual procedure. Its hash starts anew.
pub(super) fn at(phase: Phase) -> Bench {
    static ALL: OnceLock<std::vec::Vec<Bench>> = OnceLock::new();
    let all = ALL.get_or_init(|| {
        use Phase::{Approaching, Coupled, Coupling, Decoupling, Recording, Turning};
        let mut all: std::vec::Vec<Bench> = [Approaching, Coupling, Coupled, Turning, Recording, Decoupling]
            .map(|phase| at_by(procedure(), phase))
            .into();
        all.extend([idle_by(procedure()), moving_by(procedure())]);
        all
    });
    let found = all.iter().find(|bench| bench.controller.phase() == phase);
    fresh(found.expect("a start").clone())
}

/// The bench without its past.
pub(super) fn fresh(mut bench: Bench) -> Bench {
    bench.digest = Digest::default();
    bench.events.clear();
    bench
}

/// An idle arm of another description.
pub(super) fn described(change: impl FnOnce(&mut Robot), procedure: Procedure) -> Bench {
    let mut robot = spherecal_shared::robot::iiwa7();
    change(&mut robot);
    let mut bench = Bench::new(procedure);
    bench
        .controller
        .command(Command::Robot(robot.driven().expect("seven joints")))
        .expect("idle");
    let tool = iiwa7_tool();
    bench
        .controller
        .command(Command::Configure { tool, procedure })
        .expect("idle");
    with_errors(bench)
}
