//! Measures the cost of each stage of the control law at configurations spread
//! over the workspace. Prints `name mean worst` in instructions on standard
//! output.

use core::fmt::Write;
use core::hint::black_box;

use heapless::String;
use nalgebra::{Matrix3, Vector3};
use spherecal_firmware::law::{
    CartesianSetpoint, Impedance, JointSetpoint, NullSpace, Observer, Snapshot, Stiffness, TorqueShaper, joint_spring,
};
use spherecal_shared::robot::{Arm, Dynamics, JointLimits, iiwa7, iiwa7_tool};

use crate::semihosting::{self, File, Mode};
use crate::timer::stopwatch;

const N: usize = 7;
/// Instructions per count of the stopwatch at `shift=3`.
const INSTRUCTIONS_A_COUNT: u32 = 5;
const CONFIGURATIONS: u32 = 16;

/// Cost of one stage over all configurations, in counts.
#[derive(Clone, Copy, Default)]
struct Cost {
    sum: u32,
    worst: u32,
}

/// Runs `stage` and adds its cost to `cost`.
#[inline(always)]
fn measure<T>(cost: &mut Cost, overhead: u32, stage: impl FnOnce() -> T) -> T {
    let from = stopwatch::read();
    let out = black_box(stage());
    let to = stopwatch::read();
    let counts = stopwatch::between(from, to).saturating_sub(overhead);
    cost.sum += counts;
    cost.worst = cost.worst.max(counts);
    out
}

/// Joint angles of configuration `k`, in rad, spread over the middle of the
/// joints' ranges.
fn configuration(k: u32) -> [f64; N] {
    core::array::from_fn(|i| {
        let phase = f64::from(k) * 0.618 + i as f64 * 0.377;
        (phase - libm::floor(phase) - 0.5) * 2.4 + [0.0, 0.5, 0.0, -1.4, 0.0, 1.0, 0.0][i]
    })
}

/// Measures all stages, prints the result and ends the process.
pub fn run() -> ! {
    let Some(output) = File::open(":tt\0", Mode::Write) else {
        semihosting::exit(crate::EXIT_HOST);
    };
    let Ok(arm) = Arm::<f64, N>::new(&iiwa7(), &iiwa7_tool()) else {
        semihosting::exit(crate::EXIT_FAILED);
    };
    let overhead = (0..8).map(|_| {
        let from = stopwatch::read();
        stopwatch::between(from, stopwatch::read())
    });
    let overhead = overhead.min().unwrap_or(0);
    let mut costs = [("", Cost::default()); 12];
    let names = [
        "frames, TCP and Jacobian",
        "bodies in the base frame",
        "mass matrix",
        "gravity",
        "Coriolis",
        "momentum",
        "the whole snapshot",
        "observer and wrench",
        "impedance and damping",
        "null space",
        "joint law",
        "saturation and rate",
    ];
    for (slot, name) in costs.iter_mut().zip(names) {
        slot.0 = name;
    }
    let mut observer = Observer::<N>::default();
    let mut impedance = Impedance::new(Stiffness::isotropic(20.0, 200.0));
    let mut shaper = TorqueShaper::<N>::default();
    let limits: [JointLimits; N] = core::array::from_fn(|i| iiwa7().joints[i].limits);
    for k in 0..CONFIGURATIONS {
        let q = black_box(configuration(k));
        let dq = black_box(configuration(k + 7).map(|x| 0.2 * x));
        let frames = measure(&mut costs[0].1, overhead, || {
            let frames = arm.frames(&q);
            let tcp = arm.tcp_frame(&frames);
            black_box(arm.jacobian(&frames, &tcp.position));
            frames
        });
        let bodies = measure(&mut costs[1].1, overhead, || arm.bodies(black_box(&frames)));
        let bodies = black_box(&bodies);
        measure(&mut costs[2].1, overhead, || bodies.mass_matrix());
        measure(&mut costs[3].1, overhead, || bodies.gravity());
        measure(&mut costs[4].1, overhead, || bodies.coriolis(&dq));
        measure(&mut costs[5].1, overhead, || bodies.momentum(&dq));
        let Some(snapshot) = measure(&mut costs[6].1, overhead, || Snapshot::new(&arm, &q, &dq)) else {
            semihosting::exit(crate::EXIT_FAILED);
        };
        let snapshot = black_box(&snapshot);
        measure(&mut costs[7].1, overhead, || {
            observer.update(snapshot, black_box(&dq), 60.0, 1e-3)
        });
        let setpoint = CartesianSetpoint::at(snapshot.tcp.position + Vector3::x() * 0.01, Matrix3::identity());
        measure(&mut costs[8].1, overhead, || {
            impedance.force(snapshot, black_box(&setpoint), 0.7)
        });
        let elbow = black_box(NullSpace::<N>::Elbow {
            angle: 0.1,
            rate: 0.0,
            acceleration: 0.0,
        });
        let torque = measure(&mut costs[9].1, overhead, || {
            elbow.torque(snapshot, black_box(&limits), 50.0, 0.7)
        });
        let hold = black_box(JointSetpoint { q: dq, dq: q });
        measure(&mut costs[10].1, overhead, || joint_spring(snapshot, &hold, 20.0, 1.0));
        measure(&mut costs[11].1, overhead, || {
            shaper.shape(&torque, &dq, &[100.0; N], 1.0, 1.0)
        });
    }
    for (name, cost) in costs {
        let mut line = String::<96>::new();
        let mean = cost.sum * INSTRUCTIONS_A_COUNT / CONFIGURATIONS;
        let worst = cost.worst * INSTRUCTIONS_A_COUNT;
        if writeln!(line, "{name}\t{mean}\t{worst}").is_err() || !output.write(line.as_bytes()) {
            semihosting::exit(crate::EXIT_HOST);
        }
    }
    semihosting::exit(0)
}
