//! A minute of the controller's thread in the middle of a job: what it allocates, and what it measures of itself.

use std::sync::Arc;

use spherecal::job::{self, Config, Link};
use spherecal::link::native::enter_real_time;
use spherecal::link::tcp::controller_server::HostService;
use spherecal::link::tcp::listen;
use spherecal::link::{Device as _, LocalDevice, controller_in_process};
use spherecal_fci::wire::Version;

use super::job::{Job, short};
use super::robots::{Franka, Kuka, LONG, Robot};

/// Control periods of a minute.
const MINUTE: u32 = 60_000;

/// Runs a job of `config` with its controller in this thread. From the first motion on, a minute must allocate nothing.
fn minute(config: &Config, robot: &Arc<dyn Robot>) {
    let model = job::loaded_model(config).expect("a robot");
    let drive = job::native::drive(&model, config, &robot.link()).expect("a drive");
    let joints = drive.hello().limits.len();
    let controller = controller_in_process(joints).expect("a controller");
    let mut cell = LocalDevice::new(controller, drive, joints).expect("a drive that fits");
    let (listener, address) = listen("0").expect("a port");
    let job = Job::over(config, Link::Controller(address.to_string()));
    let host = std::thread::spawn(move || job.measure(false, &mut |_| ()).acknowledged.len());

    let monitor = cell.monitor().expect("a monitor");
    enter_real_time(&monitor);
    let mut service = HostService::new(&listener).expect("a service");
    while !robot.is_moving() {
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
    let robot: Arc<dyn Robot> = Franka::start(&config, Version::V5, LONG);
    minute(&config, &robot);
}

// Fails if it does over KUKA's interface.
#[test]
#[ignore = "long: 70 s of real time"]
fn long_a_minute_over_the_fast_robot_interface_allocates_nothing() {
    let config = long("iiwa7");
    let robot: Arc<dyn Robot> = Kuka::start(&config, LONG);
    minute(&config, &robot);
}
