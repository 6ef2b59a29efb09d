//! Drives that answer late: what is refused, and what the law takes from a delay that shows.

use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::DriveHello;
use spherecal_shared::protocol::host::{ApproachCommand, Command, Refusal};
use spherecal_shared::robot::{Tool, built_in, iiwa7_tool};

use super::session::again;
use crate::Controller;
use crate::law::Actuation;
use crate::testing::{Bench, HOME};

/// What a controller says of this arm and tool on this drive, in the order that host or drive choose.
fn given<const N: usize>(
    name: &str,
    tool: Tool,
    latency_us: u32,
    motor_kg_m2: f64,
    drive_first: bool,
) -> Result<(), Refusal> {
    let robot = built_in(name).expect("built in");
    let mut hello = DriveHello {
        latency_us,
        ..DriveHello::new(1, robot.joints.iter().map(|joint| joint.limits))
    };
    if motor_kg_m2 > 0.0 {
        hello.motor_kg_m2 = robot.joints.iter().map(|_| motor_kg_m2).collect();
    }
    let mut controller = Controller::<N>::default();
    if drive_first {
        controller.connect(&hello)?;
    }
    controller.command(Command::Robot(robot.driven().expect("at most eight joints")))?;
    controller.command(Command::Configure {
        tool,
        procedure: Procedure::default(),
    })?;
    if drive_first {
        Ok(())
    } else {
        controller.connect(&hello)
    }
}

// Fails if an arm is taken whose last joint no safe spring holds against friction, whatever comes first,
// or if one is refused that works: with a nest, with motors, or on a drive that is fast enough.
#[test]
fn a_drive_too_late_for_the_inertia_that_it_shows_is_refused() {
    let (nest, nothing) = (iiwa7_tool(), Tool::default());
    for first in [true, false] {
        for late_us in [2_000, 5_000] {
            for name in ["fr3", "panda"] {
                let refused = given::<7>(name, nothing, late_us, 0.0, first).expect_err("too late");
                let Refusal::TooLate { latency_us, most_us } = refused else {
                    panic!("{refused:?}")
                };
                assert_eq!(latency_us, late_us);
                // What it says is what is possible.
                assert_eq!(
                    given::<7>(name, nothing, most_us, 0.0, first),
                    Ok(()),
                    "{name}, {most_us} µs"
                );
                assert!(given::<7>(name, nothing, most_us + 1, 0.0, first).is_err());
                assert_eq!(given::<7>(name, nothing, late_us, 0.1, first), Ok(()), "{name}");
            }
            for name in ["iiwa7", "iiwa14", "fr3", "panda"] {
                assert_eq!(given::<7>(name, nest, late_us, 0.0, first), Ok(()), "{name}");
            }
            for name in ["ur5e", "ur10e", "irb120"] {
                assert_eq!(given::<6>(name, nest, late_us, 0.0, first), Ok(()), "{name}");
            }
        }
        assert!(given::<7>("fr3", nothing, 1_250, 0.0, first).is_err());
        for name in ["iiwa7", "iiwa14", "fr3", "panda"] {
            assert_eq!(given::<7>(name, nothing, 1_000, 0.0, first), Ok(()), "{name}");
        }
    }
}

// Fails if a drive that answers later than it declares keeps the springs for what it declares, if a prompt one gets others, or
// if a session begins with what the last one has shown.
#[test]
fn a_delay_that_shows_softens_the_springs() {
    let drive = |periods: usize| Actuation::new([0.0; 7], 1e-3, 1e-3 * periods as f64);
    for delay in [0, 2] {
        let mut bench = Bench::new(Bench::fast_procedure());
        (bench.noise, bench.delay) = (1.0, delay);
        bench.run(2_000);
        assert_eq!(bench.controller.drive, drive(delay));
        bench.controller.connect(&again(|_| ())).expect("a drive that fits");
        assert_eq!(bench.controller.drive, drive(0));
    }
}

// Fails if an arm moves whose drive has shown a delay for which no springs are safe, if what is said of it is not that delay, or
// if an arm whose drive has shown a shorter one may not move.
#[test]
fn a_drive_that_shows_too_long_a_delay_moves_nothing() {
    for (delay, expected) in [
        (4, Ok(())),
        (
            7,
            Err(Refusal::TooLate {
                latency_us: 7_000,
                most_us: 5_000,
            }),
        ),
    ] {
        let mut bench = Bench::new(Bench::fast_procedure());
        (bench.noise, bench.delay) = (1.0, delay);
        bench.run(1_000);
        let approach = ApproachCommand {
            sphere: 1,
            direction: [0.0, 0.0, -1.0],
        };
        let mut other = bench.controller.clone();
        assert_eq!(other.command(Command::Approach(approach)), expected);
        let target = HOME.into_iter().collect();
        assert_eq!(bench.controller.command(Command::Move { target }), expected);
    }
}
