//! The 1 kHz exchange allocates no memory. On real sockets: a simulated network allocates.

use crate::common::{hold, on_this_machine, robot_with};
use spherecal_fci::client::{Client, ReadOnlyClient};
use spherecal_fci::robot::{READY, RobotConfig};
use spherecal_fci::wire::{RobotState, Version};

// Fails if one of 1,000 exchanges allocates: in a real-time thread an allocation may wait for a lock.
#[test]
fn a_thousand_exchanges_allocate_nothing() {
    for version in [Version::V5, Version::V10] {
        let (side, _arm) = robot_with(RobotConfig::for_tests(version));
        let mut settings = on_this_machine(side.address());
        settings.spin = std::time::Duration::from_micros(50);
        let mut client = Client::connect(&settings).expect("a connection");
        client.start_torque_motion().expect("a motion");
        let mut state = RobotState::default();
        let law = hold(READY);
        let mut cycles = 0;
        let count = allocation_counter::measure(|| {
            for _ in 0..500 {
                cycles += u32::from(client.exchange(&mut state, &law).is_ok());
            }
        });
        assert_eq!(cycles, 500);
        assert_eq!(count.count_total, 0, "version {version}");
        client.finish().expect("an end");
    }
}

// Fails if reading without a motion allocates.
#[test]
fn reading_allocates_nothing() {
    let (side, _arm) = robot_with(RobotConfig::for_tests(Version::V10));
    let mut observer = ReadOnlyClient::connect(&on_this_machine(side.address())).expect("a connection");
    let mut state = RobotState::default();
    let count = allocation_counter::measure(|| {
        for _ in 0..500 {
            observer.receive(&mut state).expect("a state");
        }
    });
    assert_eq!(count.count_total, 0);
}
