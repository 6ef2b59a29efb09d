//! Jobs in real time: what the controller's thread allocates in a minute and measures of itself, and a slow disk.

use std::net::UdpSocket;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use spherecal::job::{self, Config, Link};
use spherecal::link::native::enter_real_time;
use spherecal::link::tcp::controller_server::HostService;
use spherecal::link::tcp::listen;
use spherecal::link::{Device as _, LocalDevice, controller_in_process};
use spherecal::simulated;
use spherecal_cyclic::testing::LOCAL;
use spherecal_fci::robot::{RobotConfig, RobotSide, start_robot};
use spherecal_fci::wire::{RobotMode, Version};
use spherecal_fri::robot::{CabinetConfig, Tolerance, start_cabinet};
use spherecal_fri::wire::SessionState;
use spherecal_shared::protocol::host::Phase;

use super::job::{Job, short};

/// Control periods of a minute.
const MINUTE: u32 = 60_000;

/// A Panda on this machine that waits for late answers, and how the host reaches it.
fn panda(config: &Config) -> (RobotSide, Link) {
    let arm = simulated::robot(config, (0.0, 0.0)).expect("an arm");
    let robot = start_robot(RobotConfig::for_tests(Version::V5), Box::new(arm)).expect("a robot");
    let (host, port) = (robot.address().ip().to_string(), robot.address().port());
    (robot, Link::Franka { host, port })
}

/// Runs a job of `config` with its controller in this thread. From the first motion on, a minute must allocate nothing.
fn minute(config: &Config, link: &Link, is_moving: impl Fn() -> bool) {
    let model = job::loaded_model(config).expect("a robot");
    let drive = job::native::drive(&model, config, link).expect("a drive");
    let joints = drive.hello().limits.len();
    let controller = controller_in_process(joints).expect("a controller");
    let mut cell = LocalDevice::new(controller, drive, joints).expect("a drive that fits");
    let (listener, address) = listen("0").expect("a port");
    let job = Job::over(config, Link::Controller(address.to_string()));
    let host = std::thread::spawn(move || job.measure(false, &mut |_| ()).acknowledged.len());

    let monitor = cell.monitor().expect("a monitor");
    enter_real_time(&monitor);
    let mut service = HostService::new(&listener).expect("a service");
    while !is_moving() {
        assert!(!service.turn(&mut cell).expect("a period"), "the host left");
    }
    let mut left = 0;
    let count = allocation_counter::measure(|| {
        for _ in 0..MINUTE {
            left += u32::from(service.turn(&mut cell).expect("a period"));
        }
    });
    assert_eq!(left, 0, "the host left: make the job longer");
    assert_eq!(count.count_total, 0);
    // The host is told that its controller is gone.
    drop(service);
    drop((listener, cell));
    let recorded = host.join().expect("a host");
    assert!(recorded >= 3, "the minute had only {recorded} recordings in it");

    let record = monitor.record();
    eprintln!(
        "  {} cycles, {} late, {} missed; turnaround {} us (median), {} us (99.9 %), {} us; jitter {} us (99.9 %)",
        record.cycles,
        record.late,
        record.missed,
        record.turnaround.percentile_us(0.5),
        record.turnaround.percentile_us(0.999),
        record.turnaround.max_us(),
        record.jitter.percentile_us(0.999),
    );
    // The arm followed torques nearly all the time, and each answer is in the histogram.
    assert!(record.cycles > u64::from(MINUTE) * 9 / 10, "{}", record.cycles);
    assert_eq!(record.turnaround.count(), record.cycles);
    assert!(record.jitter.count() > record.cycles * 9 / 10);
    assert_eq!(record.stops, 0);
}

/// A job that takes longer than a minute.
fn long(robot: &str) -> Config {
    let mut config = short(robot, 30);
    config.procedure.law.torque_rate_nm_s = 990.0;
    config
}

// Fails if the controller's thread allocates in one of 60,000 periods of a job over Franka's interface: an allocation may
// wait for a lock that a thread without priority holds.
#[test]
#[ignore = "long: 70 s of real time"]
fn long_a_minute_over_the_franka_control_interface_allocates_nothing() {
    let config = long("panda");
    let (robot, link) = panda(&config);
    minute(&config, &link, || robot.statistics().mode == Some(RobotMode::Move));
}

// Fails if it does over KUKA's interface.
#[test]
#[ignore = "long: 70 s of real time"]
fn long_a_minute_over_the_fast_robot_interface_allocates_nothing() {
    let config = long("iiwa7");
    let arm = simulated::robot(&config, (0.0, 0.0)).expect("an arm");
    let probe = UdpSocket::bind(LOCAL).expect("a free port");
    let client = probe.local_addr().expect("an address");
    drop(probe);
    let settings = CabinetConfig {
        client,
        tolerance: Tolerance::tolerant(),
        ..CabinetConfig::new()
    };
    let cabinet = Arc::new(start_cabinet(settings, Box::new(arm)).expect("a cabinet"));
    // A motion that begins while the host still plans is answered by nobody and ends: the application begins the next one.
    let application = Arc::clone(&cabinet);
    std::thread::spawn(move || {
        while Arc::strong_count(&application) > 1 {
            if application.statistics().session == Some(SessionState::MonitoringReady) {
                application.controls().command.fetch_xor(true, Ordering::Relaxed);
            }
            std::thread::sleep(Duration::from_millis(500));
        }
    });
    minute(&config, &Link::Fri(client), || {
        cabinet.statistics().session == Some(SessionState::CommandingActive)
    });
}

// Fails if a disk that takes 6 s to store an event lets the controller think that its host is gone: it stopped the arm after
// 2 s, and the run ended when that came again. A coupling, a turn and a recording meet such a disk.
#[test]
#[ignore = "long: 1 minute of real time"]
fn long_a_slow_disk_stops_no_arm() {
    let config = short("panda", 4);
    let (_robot, link) = panda(&config);
    let job = Job::over(&config, link);
    let mut lock = simulated::file_lock(job.database());
    let mut slow = vec![Phase::Recording, Phase::Turning, Phase::Coupling];
    let session = job.measure(false, &mut |now| {
        if slow.last() == Some(&now.phase) {
            slow.pop();
            eprintln!("  {:?}: the disk is slow", now.phase);
            lock(Duration::from_secs(6)).expect("a lock");
        }
    });
    session.well();
    job.finished(&[&session], &[]);
    assert!(slow.is_empty(), "{slow:?}");
}

// Fails if a program that is held up for 6 s (by a terminal that takes no text, a plan, a disk) lets the controller think
// that its host is gone, in a coupling, a turn and a recording; or if what it asks for then is late from the start.
#[test]
#[ignore = "long: 1 minute of real time"]
fn long_a_host_that_is_held_up_stops_no_arm() {
    let config = short("panda", 4);
    let (_robot, link) = panda(&config);
    let job = Job::over(&config, link);
    let mut held = vec![Phase::Recording, Phase::Turning, Phase::Coupling, Phase::Moving];
    let session = job.measure(false, &mut |now| {
        if held.last() == Some(&now.phase) {
            held.pop();
            eprintln!("  {:?}: held up", now.phase);
            std::thread::sleep(Duration::from_secs(6));
        }
    });
    session.well();
    job.finished(&[&session], &[]);
    assert!(held.is_empty(), "{held:?}");
}
