//! The exchange of a real-time loop allocates no memory.

use crate::common::{commanding, config, hold};
use spherecal_fri::client::MonitoredState;
use spherecal_fri::robot::START;

// Fails if one of 10,000 exchanges allocates: in a real-time thread an allocation may wait for a lock.
#[test]
#[ignore = "timed: the gate runs it"]
fn timed_ten_thousand_exchanges_allocate_nothing() {
    let mut settings = config();
    settings.spin = std::time::Duration::from_micros(50);
    settings.checksum = true;
    let (mut client, _side, _arm) = commanding(&settings);
    let mut state = MonitoredState::default();
    let law = hold(START);
    let mut commanded = 0;
    let count = allocation_counter::measure(|| {
        for _ in 0..10_000 {
            commanded += u32::from(client.exchange(&mut state, &law).is_ok_and(|c| c.commanded));
        }
    });
    assert_eq!(commanded, 10_000);
    assert_eq!(count.count_total, 0);
}
