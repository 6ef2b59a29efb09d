//! The host, and with it the controller, killed in the middle of a run over a robot's own interface.

#![cfg(unix)]

use std::net::UdpSocket;
use std::path::Path;
use std::process::{Child, Command};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use spherecal::job::Config;
use spherecal::simulated;
use spherecal_fci::robot::{RobotConfig, start_robot};
use spherecal_fci::wire::{RobotMode, Version};
use spherecal_fri::robot::{CabinetConfig, CabinetSide, Tolerance, start_cabinet};
use spherecal_fri::wire::SessionState;

use crate::kills::{has_run, recorded};
use crate::support::{start, text};

/// What no step waits longer for: the robots of this test run in real time.
const PATIENCE: Duration = Duration::from_mins(3);
/// A short job, but for the robot.
const CELL: &str = "[plan]\nposes = 4\nchoice = \"grid\"\napproach_height_m = 0.035\n\
    [procedure.couple]\nhold_s = 1.0\n[procedure.record]\nsamples = 200\n";

/// Waits until `done`; fails with `what` if it does not come, or if the program ends before.
fn until(what: &str, host: &mut Child, mut done: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !done() {
        assert!(begun.elapsed() < PATIENCE, "{what}: never");
        assert!(
            host.try_wait().expect("known").is_none(),
            "{what}: the program ended before"
        );
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// The configuration of a short job, also as a file in `folder`.
fn cell(folder: &Path, robot: &str) -> Config {
    let text = format!("robot = \"{robot}\"\n[plant]\npreset = \"typical\"\n{CELL}");
    std::fs::write(folder.join("cell.toml"), &text).expect("a file");
    Config::parse("cell.toml", &text).expect("a configuration")
}

fn measure(folder: &Path, link: &str, how: &[&str]) -> Child {
    start(
        folder,
        &[&["measure", "--json", "--link", link, "--out", "cell"], how].concat(),
    )
}

// Fails if a robot whose client is killed goes on moving, one whose client stalls does not end in its reflex for the
// missing commands, a command comes after that, a recording is lost, or `--resume` does not clear the reflex and finish.
#[test]
#[ignore = "long: 2 minutes of real time"]
fn long_a_host_killed_over_the_franka_control_interface_goes_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let config = cell(folder.path(), "panda");
    let arm = simulated::robot(&config, (0.0, 0.0)).expect("an arm");
    let robot = start_robot(RobotConfig::for_tests(Version::V5), Box::new(arm)).expect("a robot");
    let link = format!("franka:{}", robot.address());
    let database = folder.path().join("cell/calibration.db");
    let moving = || robot.statistics().mode == Some(RobotMode::Move);

    // Killed: the connection closes, and the robot holds.
    let mut host = measure(folder.path(), &link, &["--config", "cell.toml"]);
    until("a recording", &mut host, || moving() && !recorded(&database).is_empty());
    host.kill().expect("a signal");
    host.wait().expect("it ends");
    let begun = Instant::now();
    while moving() {
        assert!(begun.elapsed() < PATIENCE, "the robot goes on");
        std::thread::sleep(Duration::from_millis(10));
    }
    let first = recorded(&database);

    // Stalled: the connection stays open, but no command comes.
    let mut host = measure(folder.path(), &link, &["--resume"]);
    until("another recording", &mut host, || {
        moving() && recorded(&database).len() > first.len()
    });
    let stalled = Command::new("kill").args(["-STOP", &host.id().to_string()]).status();
    assert!(stalled.expect("a signal").success());
    until("a reflex", &mut host, || {
        robot.statistics().mode == Some(RobotMode::Reflex)
    });
    let missing = robot.statistics().missing;
    assert!(missing >= 20, "{missing}");
    host.kill().expect("a signal");
    host.wait().expect("it ends");
    let second = recorded(&database);
    assert!(second.starts_with(&first), "a stored recording is lost or changed");

    let output = measure(folder.path(), &link, &["--resume"])
        .wait_with_output()
        .expect("it ends");
    assert!(output.status.success(), "{}", text(&output.stderr));
    let all = recorded(&database);
    assert!(all.starts_with(&second), "a stored recording is lost or changed");
    assert_eq!(all.len(), 4);
    assert_eq!(robot.shut_down().commands_after_stop, 0);
}

/// Kills the program at one instant of each tenth of a visit and lets another go on, each on a robot and with a database of its own.
/// Fails if one that goes on does not finish. `robot` starts a robot; it gives the link to it and what ends it.
fn killed_at_ten_instants<R>(name: &str, robot: impl Fn(&Config) -> (String, R)) {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut took = Duration::ZERO;
    for instant in 0..=10 {
        let folder = tempfile::tempdir().expect("a folder");
        let config = cell(folder.path(), name);
        let (link, _robot) = robot(&config);
        let begun = Instant::now();
        let mut host = measure(folder.path(), &link, &["--config", "cell.toml"]);
        let mut how: &[&str] = &["--config", "cell.toml"];
        if instant == 0 {
            // Left alone, to know how long a visit takes.
            let output = host.wait_with_output().expect("it ends");
            assert!(output.status.success(), "{}", text(&output.stderr));
            took = begun.elapsed();
            continue;
        }
        let share = (f64::from(instant - 1) + rng.random::<f64>()) / 10.0;
        std::thread::sleep(took.mul_f64(share));
        host.kill().expect("a signal");
        host.wait().expect("it ends");
        let database = folder.path().join("cell/calibration.db");
        if has_run(&database) {
            how = &["--resume"];
        }
        let stored = recorded(&database);
        let output = measure(folder.path(), &link, how).wait_with_output().expect("it ends");
        assert!(output.status.success(), "at {share:.2}: {}", text(&output.stderr));
        let all = recorded(&database);
        assert!(all.starts_with(&stored), "a stored recording is lost or changed");
        assert_eq!(all.len(), 4, "at {share:.2}");
    }
}

// Fails if a run over the Franka Control Interface whose program is killed, at any instant of a visit, does not go on.
#[test]
#[ignore = "long: 20 minutes of real time"]
fn long_a_host_killed_at_any_instant_over_the_franka_control_interface_goes_on() {
    killed_at_ten_instants("panda", |config| {
        let arm = simulated::robot(config, (0.0, 0.0)).expect("an arm");
        let robot = start_robot(RobotConfig::for_tests(Version::V5), Box::new(arm)).expect("a robot");
        (format!("franka:{}", robot.address()), robot)
    });
}

/// The application on the cabinet: wants its motion, and half a second after its end the next one.
fn application(cabinet: &CabinetSide, ended: &AtomicBool) {
    let mut without_motion = Instant::now();
    while !ended.load(Ordering::Relaxed) {
        let command = &cabinet.controls().command;
        match cabinet.statistics().session {
            Some(SessionState::CommandingWait | SessionState::CommandingActive) => without_motion = Instant::now(),
            _ if !command.load(Ordering::Relaxed) => command.store(true, Ordering::Relaxed),
            _ if without_motion.elapsed() > Duration::from_millis(500) => {
                command.store(false, Ordering::Relaxed);
                without_motion = Instant::now();
            }
            _ => {}
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// The link to a cabinet that sends to a free port, and the cabinet.
fn a_cabinet(config: &Config) -> (String, CabinetSide) {
    let arm = simulated::robot(config, (0.0, 0.0)).expect("an arm");
    let probe = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    let client = probe.local_addr().expect("an address");
    drop(probe);
    let side = CabinetConfig {
        client,
        tolerance: Tolerance::tolerant(),
        ..CabinetConfig::new()
    };
    let cabinet = start_cabinet(side, Box::new(arm)).expect("a cabinet");
    (format!("fri:{client}"), cabinet)
}

/// Ends the application of a cabinet, also when a test fails.
struct Ends(Arc<AtomicBool>);

impl Drop for Ends {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

// Fails if a run over the Fast Robot Interface whose program is killed, at any instant of a visit, does not go on.
#[test]
#[ignore = "long: 20 minutes of real time"]
fn long_a_host_killed_at_any_instant_over_the_fast_robot_interface_goes_on() {
    killed_at_ten_instants("iiwa7", |config| {
        let (link, cabinet) = a_cabinet(config);
        let ended = Arc::new(AtomicBool::new(false));
        let end = Arc::clone(&ended);
        std::thread::spawn(move || application(&cabinet, &end));
        (link, Ends(ended))
    });
}

// Fails if a cabinet whose client is killed goes on moving, a torque comes after that, a recording is lost, or `--resume`
// does not finish.
#[test]
#[ignore = "long: 1 minute of real time"]
fn long_a_host_killed_over_the_fast_robot_interface_goes_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let config = cell(folder.path(), "iiwa7");
    let (link, cabinet) = a_cabinet(&config);
    let database = folder.path().join("cell/calibration.db");
    let moving = || cabinet.statistics().session == Some(SessionState::CommandingActive);
    let ended = Arc::new(AtomicBool::new(false));
    std::thread::scope(|scope| {
        let _ends = Ends(Arc::clone(&ended));
        scope.spawn(|| application(&cabinet, &ended));
        let mut host = measure(folder.path(), &link, &["--config", "cell.toml"]);
        until("a recording", &mut host, || moving() && !recorded(&database).is_empty());
        host.kill().expect("a signal");
        host.wait().expect("it ends");
        let begun = Instant::now();
        while moving() {
            assert!(begun.elapsed() < PATIENCE, "the cabinet goes on");
            std::thread::sleep(Duration::from_millis(10));
        }
        let first = recorded(&database);
        let output = measure(folder.path(), &link, &["--resume"])
            .wait_with_output()
            .expect("it ends");
        assert!(output.status.success(), "{}", text(&output.stderr));
        let all = recorded(&database);
        assert!(all.starts_with(&first), "a stored recording is lost or changed");
        assert_eq!(all.len(), 4);
    });
    assert_eq!(cabinet.shut_down().torques_after_stop, 0);
}
