//! The exchange of a real-time loop allocates no memory. On a real socket: a simulated network allocates.

use crate::common::{cabinet_with, for_client, hold, on_this_machine, rise};
use spherecal_fri::client::{Client, MonitoredState};
use spherecal_fri::robot::{CabinetConfig, START, Tolerance};

// Fails if one of 1,000 exchanges allocates: in a real-time thread an allocation may wait for a lock.
#[test]
fn a_thousand_exchanges_allocate_nothing() {
    let mut settings = on_this_machine();
    settings.spin = std::time::Duration::from_micros(50);
    settings.checksum = true;
    let mut client = Client::listen(&settings).expect("a client");
    let (side, _arm) = cabinet_with(CabinetConfig {
        tolerance: Tolerance::tolerant(),
        ..for_client(&settings.machine, client.address().expect("an address"))
    });
    rise(&mut client, &side);
    let mut state = MonitoredState::default();
    let law = hold(START);
    let mut commanded = 0;
    let count = allocation_counter::measure(|| {
        for _ in 0..1000 {
            commanded += u32::from(client.exchange(&mut state, &law).is_ok_and(|c| c.commanded));
        }
    });
    assert_eq!(commanded, 1000);
    assert_eq!(count.count_total, 0);
}
