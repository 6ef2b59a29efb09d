//! The 1 kHz exchange allocates no memory.

use crate::common::{config, hold, robot};
use spherecal_fci::client::{Client, ReadOnlyClient};
use spherecal_fci::robot::READY;
use spherecal_fci::wire::{RobotState, Version};

// Fails if one of 10,000 exchanges allocates: in a real-time thread an allocation may wait for a lock.
#[test]
#[ignore = "timed: the gate runs it"]
fn timed_ten_thousand_exchanges_allocate_nothing() {
    for version in [Version::V5, Version::V10] {
        let (side, _arm) = robot(version);
        let mut settings = config(side.address());
        settings.spin = std::time::Duration::from_micros(50);
        let mut client = Client::connect(&settings).expect("a connection");
        client.start_torque_motion().expect("a motion");
        let mut state = RobotState::default();
        let law = hold(READY);
        let mut cycles = 0;
        let count = allocation_counter::measure(|| {
            for _ in 0..5000 {
                cycles += u32::from(client.exchange(&mut state, &law).is_ok());
            }
        });
        assert_eq!(cycles, 5000);
        assert_eq!(count.count_total, 0, "version {version}");
        client.finish().expect("an end");
    }
}

// Fails if reading without a motion allocates.
#[test]
fn reading_allocates_nothing() {
    let (side, _arm) = robot(Version::V10);
    let mut observer = ReadOnlyClient::connect(&config(side.address())).expect("a connection");
    let mut state = RobotState::default();
    let count = allocation_counter::measure(|| {
        for _ in 0..500 {
            observer.receive(&mut state).expect("a state");
        }
    });
    assert_eq!(count.count_total, 0);
}
