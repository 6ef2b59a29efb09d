//! The example `drive`: the controller moves it over TCP.

use spherecal_link::tcp::{DriveServer, RemoteDrive, check_limits, listen};
use spherecal_link::{Arrival, Device as _, Drive as _, HostEndpoint, LocalDevice, Timing, controller_in_process};
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveCommand, DriveState};
use spherecal_shared::protocol::host::{Command, Event, Phase};
use spherecal_shared::robot::{Inertia, Robot, iiwa7, iiwa7_tool};

#[path = "../../examples/drive.rs"]
#[expect(dead_code, reason = "the example's own `main`")]
mod drive;

/// What `examples/python/point_arm.toml` describes: an iiwa 7's geometry whose mass is all in the motors.
fn point_arm() -> Robot {
    let mut robot = iiwa7();
    for (joint, inertia) in robot.joints.iter_mut().zip(drive::INERTIA) {
        (joint.link, joint.limits, joint.rotor_kg_m2) = (Inertia::default(), drive::LIMITS, inertia);
    }
    robot
}

/// Steps the cell until an event is `wanted`, for at most `periods`.
fn run_until(
    cell: &mut LocalDevice,
    host: &mut HostEndpoint,
    periods: usize,
    wanted: impl Fn(&Arrival) -> bool,
) -> bool {
    (0..periods).any(|_| {
        let (mut down, mut up, mut arrived) = (Vec::new(), Vec::new(), Vec::new());
        host.transmit(cell.now_us(), &mut down).expect("framed");
        cell.step(&down, &mut up).expect("the link lives");
        let stored: Result<(), ()> = host.receive(&up, &mut arrived, |_| Ok(()));
        stored.expect("nothing to store");
        arrived.iter().any(&wanted)
    })
}

// Fails if the example does not do what a drive must: introduce itself, answer each command with the next state, and
// carry out torques so that the controller moves the arm to joint angles.
#[test]
fn the_controller_moves_the_example() {
    let (listener, address) = listen("0").expect("a free port");
    let served = std::thread::spawn(move || {
        let mut server = DriveServer::new(Box::new(drive::Arm::new()), false);
        server.serve(&listener).expect("served")
    });
    let tcp = RemoteDrive::connect(&address.to_string()).expect("the drive answers");
    let robot = point_arm();
    check_limits(&tcp.hello().limits, &robot).expect("the limits of the robot");
    let controller = controller_in_process(7).expect("a controller");
    let mut cell = LocalDevice::new(controller, Box::new(tcp), 7).expect("a cell");
    let mut host = HostEndpoint::new(Timing::default());
    let target = [0.1, 0.5, -0.1, -1.4, 0.1, 0.9, 0.2];
    let mut tool = iiwa7_tool();
    tool.body = Inertia::default();
    let procedure = Procedure::default();
    for command in [
        Command::Hello,
        Command::Robot(robot.driven().expect("at most eight joints")),
        Command::Configure { tool, procedure },
        Command::Move {
            target: target.into_iter().collect(),
        },
    ] {
        let name = format!("{command:?}");
        host.send(command);
        let accepted = |a: &Arrival| matches!(&a.body, Event::Reply { result: Ok(()), .. });
        assert!(run_until(&mut cell, &mut host, 1000, accepted), "{name}");
    }
    let arrived = |a: &Arrival| match &a.body {
        Event::Phase(change) => change.phase == Phase::Idle && change.from == Phase::Moving,
        Event::Fault(report) => panic!("{report:?}"),
        _ => false,
    };
    assert!(
        run_until(&mut cell, &mut host, 20_000, arrived),
        "the arm did not arrive"
    );
    for (is, wanted) in cell.state().q.iter().zip(target) {
        assert!((is - wanted).abs() < 2e-3, "{is} rad for {wanted}");
    }
    let ticks = cell.ticks();
    drop(cell);
    let service = served.join().expect("no panic");
    assert_eq!((service.commands, service.late), (ticks - 1, 0));
}

// Fails if a command that does not enable the drive, or none at all, moves the arm.
#[test]
fn without_enable_the_brakes_are_closed() {
    let (mut arm, mut state) = (drive::Arm::new(), DriveState::default());
    arm.exchange(None, &mut state).expect("a state");
    let start = state.q.clone();
    let mut command = DriveCommand {
        session: 1,
        tick: state.tick,
        tau: [5.0; 7].into_iter().collect(),
        enable: true,
        ..DriveCommand::default()
    };
    arm.exchange(Some(&command), &mut state).expect("a state");
    assert_ne!(state.q, start);
    let moved = state.q.clone();
    command.enable = false;
    arm.exchange(Some(&command), &mut state).expect("a state");
    arm.exchange(None, &mut state).expect("a state");
    assert_eq!((&state.q, state.tick), (&moved, 4));
}
