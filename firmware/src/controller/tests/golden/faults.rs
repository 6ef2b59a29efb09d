//! Every fault of a phase's task, provoked.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::Phase;

use super::starts::{approach, at, at_by, idle_by, moving_by, procedure, sent_along};
use super::{Scenario, recover};
use crate::testing::{Bench, HOME};

pub(super) const ALL: &[Scenario] = &[
    ("a blocked motion", || {
        let mut bench = at(Phase::Moving);
        bench.blocked = true;
        fails(bench, 5_000)
    }),
    ("a blocked motion that slows down", || {
        let mut procedure = procedure();
        procedure.limits.soft_force_n = 1.5;
        procedure.limits.path_rad = 1.0;
        let mut bench = moving_by(procedure);
        bench.blocked = true;
        fails(bench, 3_000)
    }),
    ("a motion that does not settle", || {
        let mut procedure = procedure();
        procedure.motion.tolerance_rad = 1e-4;
        let mut bench = idle_by(procedure);
        let mut target = HOME;
        target[0] = 0.02;
        bench.push.y -= 4.0;
        bench.go(&target).expect("idle");
        fails(bench, 3_000)
    }),
    ("a push in a motion", || {
        let mut bench = at(Phase::Moving);
        bench.push += Vector3::new(0.0, -26.0, 3.0);
        bench.run(600);
        bench.push = Vector3::zeros();
        fails(bench, 0)
    }),
    ("a push upwards in a motion", || {
        let mut bench = at(Phase::Moving);
        bench.push += Vector3::new(0.0, 0.0, 30.0);
        bench.run(2_000);
        bench.push = Vector3::zeros();
        fails(bench, 0)
    }),
    ("short pushes in a motion", || {
        let mut bench = at(Phase::Moving);
        for (newton, ticks) in [(30.0, 38), (0.0, 60), (-34.0, 38), (9.0, 400)] {
            bench.push = Vector3::new(0.3 * newton, newton, 0.2 * newton);
            bench.run(ticks);
        }
        bench
    }),
    ("a motion out of the workspace", || {
        let mut procedure = procedure();
        procedure.limits.workspace_max_m[1] = Bench::new(procedure).tcp().y + 0.15;
        let mut bench = moving_by(procedure);
        bench.until_fault(20_000);
        recover(bench)
    }),
    ("a motion through the plate", || {
        let mut procedure = procedure();
        let tcp = Bench::new(procedure).tcp();
        procedure.limits.plate_normal = [0.0, 0.6, 0.8];
        procedure.limits.plate_offset_m = 0.6 * tcp.y + 0.8 * tcp.z - 0.06;
        let mut bench = idle_by(procedure);
        let mut target = HOME;
        target[1] = 1.0;
        bench.go(&target).expect("idle");
        fails(bench, 20_000)
    }),
    ("a TCP that is too fast", || {
        let mut procedure = procedure();
        procedure.limits.speed_m_s = 0.25;
        fails(moving_by(procedure), 5_000)
    }),
    ("a large tare", || {
        let mut bench = at(Phase::Idle);
        bench.push += Vector3::new(3.0, 0.0, -14.0);
        bench.run(200);
        approach(&mut bench, [0.0, 0.0, -1.0]);
        fails(bench, 2_000)
    }),
    ("no sphere on the way", || {
        let mut bench = at(Phase::Idle);
        approach(&mut bench, [0.0, 0.0, -1.0]);
        fails(bench, 8_000)
    }),
    ("no sphere above the plate", || {
        let mut procedure = procedure();
        procedure.limits.plate_offset_m = Bench::new(procedure).tcp().z - 0.03;
        let mut bench = idle_by(procedure);
        approach(&mut bench, [0.6, 0.0, -0.8]);
        fails(bench, 8_000)
    }),
    ("an arm that hangs on its way down", || {
        let mut procedure = procedure();
        procedure.approach.trigger_n = 60.0;
        let bench = sent_along(idle_by(procedure), [0.0, 0.0, -1.0]);
        fails(bench, 12_000)
    }),
    ("an arm that is pushed on its way down", || {
        let mut bench = at(Phase::Approaching);
        bench.push += Vector3::new(25.0, 0.0, 0.0);
        fails(bench, 1_500)
    }),
    ("an impact before the sphere", || {
        let mut bench = at(Phase::Approaching);
        bench.push.z += 40.0;
        bench.run(12);
        bench.push.z -= 40.0;
        bench.run(1_500);
        bench
    }),
    ("a nest that wanders while it is seated", || {
        let mut bench = at(Phase::Coupling);
        bench.sphere = None;
        bench.push += Vector3::new(12.0, 6.0, 0.0);
        fails(bench, 3_000)
    }),
    ("a nest that stays loose", || {
        let mut bench = at(Phase::Coupling);
        bench.sphere = None;
        fails(bench, 12_000)
    }),
    ("a nest that stays loose, without a search", || {
        let mut procedure = procedure();
        procedure.couple.searches = 0;
        let mut bench = at_by(procedure, Phase::Coupling);
        bench.sphere = None;
        fails(bench, 3_000)
    }),
    ("a nest that wanders in a search", || {
        let mut bench = at(Phase::Coupling);
        bench.sphere = None;
        bench.until(Phase::Verifying, 3_000);
        bench.until(Phase::Coupling, 3_000);
        bench.push += Vector3::new(10.0, -6.0, 0.0);
        fails(bench, 3_000)
    }),
    ("a nest that leaves while it is coupled", || {
        let mut bench = at(Phase::Coupled);
        bench.sphere = None;
        bench.push.z += 6.0;
        fails(bench, 2_000)
    }),
    ("a nest that leaves slowly", || {
        let mut bench = at(Phase::Coupled);
        creep(&mut bench, 1_500, 5e-6);
        fails(bench, 0)
    }),
    ("a nest that leaves in a turn", || {
        let mut bench = at(Phase::Turning);
        bench.sphere = None;
        bench.push.x += 6.0;
        fails(bench, 2_000)
    }),
    ("a nest that leaves in a recording", || {
        let mut bench = at(Phase::Recording);
        bench.sphere = None;
        bench.push.z += 6.0;
        fails(bench, 2_000)
    }),
    ("a nest that is loose under the pull", || {
        let mut bench = at(Phase::Recording);
        bench.run(150);
        bench.sphere = None;
        fails(bench, 2_000)
    }),
    ("a sphere that creeps in a recording", || {
        let mut procedure = procedure();
        procedure.record.samples = 400;
        let mut bench = at_by(procedure, Phase::Recording);
        bench.run(150);
        creep(&mut bench, 250, 2e-6);
        fails(bench, 200)
    }),
    ("a turn that is blocked", || {
        let mut bench = at(Phase::Turning);
        bench.blocked = true;
        fails(bench, 5_000)
    }),
    ("a turn with a load that it cannot turn", || {
        let mut procedure = procedure();
        procedure.limits.turn_rad = 0.05;
        let mut bench = at_by(procedure, Phase::Turning);
        bench.blocked = true;
        fails(bench, 5_000)
    }),
    ("a turn whose elbow is held", || {
        let mut procedure = procedure();
        procedure.turn.elbow_tolerance_rad = 1e-3;
        procedure.law.elbow_nm_rad = 5.0;
        let mut bench = at_by(procedure, Phase::Turning);
        bench.torque_bias[0] += 3.0;
        fails(bench, 5_000)
    }),
    ("a turn that never rests", || {
        let mut procedure = procedure();
        procedure.turn.still_rad_s = 1e-5;
        let mut bench = at_by(procedure, Phase::Turning);
        shake(&mut bench, 6_000, 1, 0.01);
        recover(bench)
    }),
    ("a recording of an arm that never rests", || {
        let mut bench = at(Phase::Recording);
        shake(&mut bench, 3_000, 10, 0.03);
        recover(bench)
    }),
    ("a recording that begins anew for ever", || {
        let mut bench = at(Phase::Recording);
        shake(&mut bench, 5_000, 70, 0.03);
        recover(bench)
    }),
    ("a magnet that does not let go", || {
        let mut procedure = procedure();
        procedure.decouple.stiffness_n_m = 250.0;
        let mut bench = at_by(procedure, Phase::Decoupling);
        bench.hold_n = 1e9;
        fails(bench, 6_000)
    }),
    ("a magnet that is pulled too hard", || {
        let mut bench = at(Phase::Decoupling);
        bench.hold_n = 1e9;
        bench.until_fault(3_000);
        bench.run(500);
        recover(bench)
    }),
    ("a seated nest that is pressed", || {
        let mut bench = at(Phase::Turning);
        bench.torque_bias[1] += 24.0;
        fails(bench, 2_000)
    }),
    ("a silent host", || {
        let mut procedure = procedure();
        procedure.limits.host_silence_s = 0.25;
        let mut bench = at_by(procedure, Phase::Coupled);
        bench.host = false;
        bench.until_fault(400);
        recover(bench)
    }),
];

/// Runs until the fault, and until it is cleared. Fewer `ticks` end without a fault.
fn fails(mut bench: Bench, ticks: u32) -> Bench {
    bench.until_fault(ticks);
    bench.push = Vector3::zeros();
    // A wrist that was freed under its whole torque would jump.
    bench.run(50);
    bench.blocked = false;
    recover(bench)
}

/// Moves the sphere by `step_m` (m) per tick.
fn creep(bench: &mut Bench, ticks: u32, step_m: f64) {
    for _ in 0..ticks {
        if let Some(sphere) = &mut bench.sphere {
            sphere.x += step_m;
        }
        bench.run(1);
    }
}

/// Changes the speed of joint 3 to and fro by `by` (rad/s), once in `every` ticks.
fn shake(bench: &mut Bench, ticks: u32, every: u32, by: f64) {
    for k in 0..ticks {
        if bench.controller.phase() == Phase::Fault {
            return;
        }
        if k.is_multiple_of(every) {
            bench.dq[2] += if (k / every).is_multiple_of(2) { by } else { -by };
        }
        bench.run(1);
    }
}
