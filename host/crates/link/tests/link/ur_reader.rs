//! A robot of Universal Robots that is read through the drive's own trait, on a virtual clock.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use spherecal_cyclic::testing::{LOCAL, World};
use spherecal_link::{JointReading, StateReader as _, UrReader};
use spherecal_ur::client::ClientConfig;
use spherecal_ur::robot::{ArmState, RobotConfig, start_robot};
use spherecal_ur::wire::{KinematicsInfo, Series};

const POSE: [f64; 6] = [0.1, -1.2, 1.3, -1.4, -1.5, 0.6];

// Fails if a reading has other angles or another time than the robot's, torques that nobody measured, or if a program or a
// stop is not told.
#[test]
fn a_robot_of_universal_robots_is_read_and_its_stops_are_told() {
    let world = World::new(0);
    let state = ArmState {
        q: POSE,
        ..ArmState::default()
    };
    let side = RobotConfig {
        machine: world.machine(),
        address: LOCAL,
        ..RobotConfig::new(Series::ESeries, KinematicsInfo::default())
    };
    let side = start_robot(side, Box::new(Arc::new(Mutex::new(state)))).expect("a robot");
    let mut reader = UrReader::with(ClientConfig {
        machine: world.machine(),
        port: side.address().port(),
        ..ClientConfig::new("127.0.0.1")
    })
    .expect("a reader");
    assert_eq!((reader.joints(), reader.has_torques()), (6, false));
    assert_eq!(reader.kinematics().expect("a calibration"), KinematicsInfo::default());
    let mut reading = JointReading::default();
    for k in 0..10 {
        reader.read(&mut reading).expect("a reading");
        assert_eq!(reading.q, POSE);
        assert!((reading.time_s - 2e-3 * f64::from(k)).abs() < 1e-9, "{reading:?}");
        assert!(reading.tau.is_empty() && reading.unsigned_tau.is_empty() && reading.commanded.is_none());
    }
    let controls = side.controls();
    controls.runtime_state.store(2, Ordering::Relaxed);
    world.machine().sleep(Duration::from_millis(10));
    for _ in 0..8 {
        reader.read(&mut reading).expect("a reading");
    }
    assert!(
        reading.commanded.as_ref().is_some_and(|what| what.contains("PLAYING")),
        "{reading:?}"
    );
    controls.safety_mode.store(3, Ordering::Relaxed);
    let stopped = (0..20).find_map(|_| reader.read(&mut reading).err()).expect("a stop");
    assert!(stopped.to_string().contains("PROTECTIVE_STOP"), "{stopped}");
    assert!(!stopped.is_input());
}
