//! What the simulated cell costs on one core: plant, controller with its stages,
//! the whole loop, and the arm's kinematics and dynamics.
//!
//! ```text
//!   cargo bench -p spherecal --bench plant       times, by criterion
//!   scripts/counts                               instructions beside times, into host/benches/README.md
//!   scripts/speed                                against MuJoCo and Pinocchio, in one run
//! ```
//!
//! A tick is 1 ms: free, one Runge-Kutta step; in contact or with dry friction,
//! four implicit sub-steps. For the scripts the same cases run alone:
//! `--cases` names them, `--count CASE N` runs one N times, `--time CASE` prints
//! the least time of a call, in ns.

use std::hint::black_box;
use std::process::ExitCode;
use std::time::Instant;

use criterion::Criterion;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use spherecal::link::{Device, LocalDevice, controller_in_process};
use spherecal::sim::plant::{Plant, PlantConfig};
use spherecal::sim::simulated_arm;
use spherecal_firmware::Controller;
use spherecal_firmware::law::{
    CartesianSetpoint, Impedance, JointSetpoint, NullSpace, Observer, Snapshot, Stiffness, TorqueShaper, joint_spring,
};
use spherecal_shared::Joints;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveHello, DriveState, DriveStatus};
use spherecal_shared::protocol::host::{ApproachCommand, Command};
use spherecal_shared::robot::{Arm, Dynamics, iiwa7, iiwa7_tool};

/// Joint angles in the middle of the workspace.
const Q: [f64; 7] = [0.3, 0.6, -0.2, -1.2, 0.4, 0.9, 0.1];
/// Joint velocities to that.
const DQ: [f64; 7] = [0.05, -0.1, 0.02, 0.1, -0.05, 0.03, 0.2];

/// One thing to measure.
struct Case {
    name: &'static str,
    make: fn() -> Box<dyn FnMut()>,
}

fn arm() -> Arm<f64, 7> {
    Arm::new(&iiwa7(), &iiwa7_tool()).expect("a robot")
}

/// A plant seated on sphere 1 and the torque that holds it there.
fn seated(config: &PlantConfig) -> (Plant<7>, [f64; 7]) {
    let far = Plant::<7>::new(&iiwa7(), &iiwa7_tool(), config, &[0.0; 7]).expect("a plant");
    let sphere = far.world().spheres[0].expect("a sphere");
    let arm = arm();
    let down = Matrix3::new(-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0);
    let mut q = [0.0, 0.7, 0.0, -1.4, 0.0, 1.0, 0.0];
    for _ in 0..200 {
        // Newton on the true arm, through its encoders.
        let link = far.world().link_angles_at_rest(&q);
        let tcp = far.world().tcp(&link);
        let turn = nalgebra::Rotation3::from_matrix(&(down * tcp.rotation.transpose())).scaled_axis();
        let error = SVector::<f64, 6>::from_iterator((sphere - tcp.position).iter().chain(turn.iter()).copied());
        let j = arm.jacobian(&arm.frames(&q), &tcp.position);
        let damped = j * j.transpose() + SMatrix::<f64, 6, 6>::identity() * 1e-6;
        let step = j.transpose() * damped.try_inverse().expect("regular") * error;
        for i in 0..7 {
            q[i] += step[i].clamp(-0.2, 0.2);
        }
    }
    let mut plant = Plant::new(&iiwa7(), &iiwa7_tool(), config, &q).expect("a plant");
    let hold = Dynamics::bodies(&far.world().arm, &arm.frames(&q)).gravity();
    for _ in 0..2000 {
        let mut tau: [f64; 7] = hold.into();
        let sensed = plant.sensed();
        for i in 0..7 {
            tau[i] += 20.0 * (q[i] - sensed.q[i]) - 3.0 * sensed.dq[i];
        }
        plant.step(&tau);
    }
    assert_eq!(plant.truth().seated, Some(0), "{:?}", plant.truth());
    let tau = plant.sensed().tau;
    (plant, tau)
}

fn seated_case(config: &PlantConfig) -> Box<dyn FnMut()> {
    let (mut plant, tau) = seated(config);
    Box::new(move || {
        black_box(plant.step(black_box(&tau)));
    })
}

fn free_case(config: &PlantConfig) -> Box<dyn FnMut()> {
    let mut plant = Plant::<7>::new(&iiwa7(), &iiwa7_tool(), config, &Q).expect("a plant");
    let tau = plant.sensed().tau;
    Box::new(move || {
        black_box(plant.step(black_box(&tau)));
    })
}

fn dry() -> PlantConfig {
    let mut dry = PlantConfig::ideal();
    dry.friction.enabled = true;
    dry
}

/// A controller that approaches slowly for ever: its setpoint runs, its spring
/// follows, and nothing is touched.
fn controller_case() -> Box<dyn FnMut()> {
    let mut procedure = Procedure::default();
    procedure.approach.speed_m_s = 1e-4;
    let mut controller = Controller::<7>::default();
    let hello = DriveHello {
        lock_step: true,
        ..DriveHello::new(1, iiwa7().joints.iter().map(|joint| joint.limits))
    };
    controller.connect(&hello).expect("a drive that fits");
    controller
        .command(Command::Robot(iiwa7().driven().expect("seven joints")))
        .expect("a robot");
    let tool = iiwa7_tool();
    controller
        .command(Command::Configure { tool, procedure })
        .expect("a procedure");
    let joints = |values: [f64; 7]| Joints::from_slice(&values).expect("seven of eight");
    let arm = arm();
    let gravity = arm.bodies(&arm.frames(&Q)).gravity();
    let mut state = DriveState {
        session: 1,
        tick: 0,
        q: joints(Q),
        dq: joints([0.0; 7]),
        tau: joints(gravity.into()),
        status: DriveStatus::Ready,
    };
    let mut step = move |command: Option<Command>| {
        if let Some(command) = command {
            controller.command(command).expect("from idle");
        }
        state.tick += 1;
        controller.host_heard();
        let now = embassy_time::Instant::from_millis(state.tick);
        black_box(controller.tick(now, black_box(&state)));
        while controller.next_event().is_some() {}
        while controller.next_sample().is_some() {}
    };
    (0..10).for_each(|_| step(None));
    let direction = [0.0, 0.0, -1.0];
    step(Some(Command::Approach(ApproachCommand { sphere: 1, direction })));
    (0..1500).for_each(|_| step(None));
    Box::new(move || step(None))
}

/// Controller and typical plant in lock-step, host link included, holding.
fn loop_case() -> Box<dyn FnMut()> {
    let config = PlantConfig::typical();
    let drive = simulated_arm(&iiwa7(), &iiwa7_tool(), &config, &Q).expect("a plant");
    let mut cell = LocalDevice::new(controller_in_process(7).expect("a controller"), drive, 7).expect("a cell");
    let mut host = spherecal::link::HostEndpoint::new(spherecal::link::Timing::default());
    host.send(Command::Hello);
    host.send(Command::Robot(iiwa7().driven().expect("seven joints")));
    host.send(Command::Configure {
        tool: iiwa7_tool(),
        procedure: Procedure::default(),
    });
    let (mut down, mut up, mut arrived) = (Vec::new(), Vec::new(), Vec::new());
    let mut step = move || {
        down.clear();
        up.clear();
        arrived.clear();
        host.transmit(cell.now_us(), &mut down).expect("frames");
        cell.step(&down, &mut up).expect("a step");
        host.receive(&up, &mut arrived, |_| Ok::<(), spherecal::link::JournalError>(()))
            .expect("events");
    };
    (0..2000).for_each(|_| step());
    Box::new(step)
}

fn snapshot() -> Snapshot<7> {
    Snapshot::new(&arm(), &Q, &DQ).expect("a snapshot")
}

const CASES: &[Case] = &[
    Case {
        name: "plant: free, ideal",
        make: || {
            free_case(&PlantConfig {
                contact: false,
                ..PlantConfig::ideal()
            })
        },
    },
    Case {
        name: "plant: free, typical",
        make: || free_case(&PlantConfig::typical()),
    },
    Case {
        name: "plant: seated, ideal",
        make: || seated_case(&PlantConfig::ideal()),
    },
    Case {
        name: "plant: seated, joint friction",
        make: || seated_case(&dry()),
    },
    Case {
        name: "plant: seated, typical",
        make: || seated_case(&PlantConfig::typical()),
    },
    Case {
        name: "controller: whole tick",
        make: controller_case,
    },
    Case {
        name: "controller: snapshot",
        make: || {
            let arm = arm();
            Box::new(move || {
                black_box(Snapshot::new(black_box(&arm), black_box(&Q), black_box(&DQ)));
            })
        },
    },
    Case {
        name: "controller: observer and wrench",
        make: || {
            let (snapshot, mut observer) = (snapshot(), Observer::<7>::default());
            Box::new(move || {
                black_box(observer.update(black_box(&snapshot), black_box(&DQ), 60.0, 1e-3));
            })
        },
    },
    Case {
        name: "controller: impedance and damping",
        make: || {
            let snapshot = snapshot();
            let mut impedance = Impedance::new(Stiffness::isotropic(20.0, 200.0));
            let at = snapshot.tcp.position + Vector3::x() * 0.01;
            let setpoint = CartesianSetpoint::at(at, Matrix3::identity());
            Box::new(move || {
                black_box(impedance.force(black_box(&snapshot), black_box(&setpoint), 0.7));
            })
        },
    },
    Case {
        name: "controller: null space",
        make: || {
            let (snapshot, elbow) = (
                snapshot(),
                NullSpace::<7>::Elbow {
                    angle: 0.1,
                    rate: 0.0,
                    acceleration: 0.0,
                },
            );
            let limits: [_; 7] = std::array::from_fn(|joint| iiwa7().joints[joint].limits);
            Box::new(move || {
                black_box(elbow.torque(black_box(&snapshot), black_box(&limits), 50.0, 0.7));
            })
        },
    },
    Case {
        name: "controller: joint law",
        make: || {
            let (snapshot, hold) = (snapshot(), JointSetpoint { q: Q, dq: DQ });
            Box::new(move || {
                black_box(joint_spring(black_box(&snapshot), black_box(&hold), 20.0, 1.0));
            })
        },
    },
    Case {
        name: "controller: saturation and rate",
        make: || {
            let (mut shaper, wanted) = (TorqueShaper::<7>::default(), SVector::from(Q));
            Box::new(move || {
                black_box(shaper.shape(black_box(&wanted), black_box(&DQ), &[100.0; 7], 1.0, 1.0));
            })
        },
    },
    Case {
        name: "loop: controller, links and plant",
        make: loop_case,
    },
    Case {
        name: "arm: FK and Jacobian",
        make: || {
            let arm = arm();
            Box::new(move || {
                let frames = arm.frames(black_box(&Q));
                let tcp = arm.tcp_frame(&frames);
                black_box(arm.jacobian(&frames, &tcp.position));
            })
        },
    },
    Case {
        name: "arm: FK, Jacobian, gravity and mass matrix",
        make: || {
            let arm = arm();
            Box::new(move || {
                let frames = arm.frames(black_box(&Q));
                let tcp = arm.tcp_frame(&frames);
                black_box(arm.jacobian(&frames, &tcp.position));
                let bodies = arm.bodies(&frames);
                black_box(bodies.gravity());
                black_box(bodies.mass_matrix());
            })
        },
    },
];

/// Least time of a call over many batches, in ns.
fn least_ns(case: &Case) -> f64 {
    let mut run = (case.make)();
    let begin = Instant::now();
    let mut least = f64::INFINITY;
    while begin.elapsed().as_millis() < 1500 {
        let from = Instant::now();
        (0..1000).for_each(|_| run());
        least = least.min(from.elapsed().as_secs_f64() * 1e6);
    }
    least
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let find = |name: &str| CASES.iter().find(|c| c.name == name);
    match words[..] {
        ["--cases", ..] => CASES.iter().for_each(|case| println!("{}", case.name)),
        // For scripts/speed: whether the other side has the same arm.
        ["--gravity", ..] => println!("{:.12}", arm().bodies(&arm().frames(&Q)).gravity()[1]),
        ["--count", name, times, ..] => match (find(name), times.parse::<u64>()) {
            (Some(case), Ok(times)) => {
                let mut run = (case.make)();
                (0..times).for_each(|_| run());
            }
            _ => return ExitCode::from(2),
        },
        ["--time", name, ..] => match find(name) {
            Some(case) => println!("{:.1}", least_ns(case)),
            None => return ExitCode::from(2),
        },
        _ => {
            let mut criterion = Criterion::default().configure_from_args();
            for case in CASES {
                criterion.bench_function(case.name, |b| b.iter((case.make)()));
            }
            criterion.final_summary();
        }
    }
    ExitCode::SUCCESS
}
