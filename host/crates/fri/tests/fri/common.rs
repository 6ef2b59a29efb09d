//! What the tests of client against cabinet share: a cabinet, a soft control law, and a network that can fail.

use std::net::SocketAddr;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use spherecal_cyclic::testing::{LOCAL, World, joint_impedance};
use spherecal_cyclic::{JointArm, Machine};
use spherecal_fri::client::{Client, ClientConfig, ClientError, Cycle, MonitoredState, TorqueLimits};
use spherecal_fri::robot::{CabinetConfig, CabinetSide, START, joint_arm, start_cabinet};
use spherecal_fri::wire::SessionState;

/// Settings of a client in this world, on any free port.
pub(crate) fn config(world: &World) -> ClientConfig {
    ClientConfig {
        machine: world.machine(),
        ..on_this_machine()
    }
}

/// Settings of a client on this machine. The timeout is long: two cores are shared.
pub(crate) fn on_this_machine() -> ClientConfig {
    ClientConfig {
        address: LOCAL,
        timeout: Duration::from_secs(2),
        ..ClientConfig::new(TorqueLimits::IIWA_7)
    }
}

/// Settings of a cabinet on the machine of the client at this address. It does not wait, as a real one does not.
pub(crate) fn for_client(machine: &Arc<dyn Machine>, client: SocketAddr) -> CabinetConfig {
    CabinetConfig {
        machine: Arc::clone(machine),
        client,
        ..CabinetConfig::new()
    }
}

/// Such a cabinet with the simple arm, which the test can push.
pub(crate) fn cabinet(world: &World, client: SocketAddr) -> (CabinetSide, Arc<Mutex<JointArm>>) {
    cabinet_with(for_client(&world.machine(), client))
}

pub(crate) fn cabinet_with(config: CabinetConfig) -> (CabinetSide, Arc<Mutex<JointArm>>) {
    let arm = Arc::new(Mutex::new(joint_arm(START)));
    let side = start_cabinet(config, Box::new(Arc::clone(&arm))).expect("a cabinet");
    (side, arm)
}

/// A joint impedance that holds `at`, rad.
pub(crate) fn hold(at: [f64; 7]) -> impl Fn(&MonitoredState) -> [f64; 7] {
    let law = joint_impedance(at);
    move |state| law(&state.message.measured_position, &state.dq)
}

/// The largest distance of a joint from `at`, rad.
pub(crate) fn deviation(state: &MonitoredState, at: &[f64; 7]) -> f64 {
    spherecal_cyclic::testing::deviation(&state.message.measured_position, at)
}

/// Exchanges until the session has this state; fails after many messages.
pub(crate) fn until(
    client: &mut Client,
    session: SessionState,
    state: &mut MonitoredState,
) -> Result<Cycle, ClientError> {
    let law = hold(START);
    for _ in 0..20_000 {
        let cycle = client.exchange(state, &law)?;
        if state.message.connection.session == session {
            return Ok(cycle);
        }
    }
    panic!("the session stays in {}", state.message.connection.session);
}

/// A client that commands: the session is in COMMANDING_ACTIVE.
pub(crate) fn commanding(config: &ClientConfig) -> (Client, CabinetSide, Arc<Mutex<JointArm>>) {
    let mut client = Client::listen(config).expect("a client");
    let address = client.address().expect("an address");
    let (side, arm) = cabinet_with(for_client(&config.machine, address));
    rise(&mut client, &side);
    (client, side, arm)
}

/// Lets the session rise to COMMANDING_ACTIVE.
pub(crate) fn rise(client: &mut Client, side: &CabinetSide) {
    let mut state = MonitoredState::default();
    // The cabinet sees every control within two messages.
    for _ in 0..3 {
        client.exchange(&mut state, |_| [0.0; 7]).expect("a message");
    }
    until(client, SessionState::MonitoringReady, &mut state).expect("a good connection");
    client.enable().expect("a robot that may move");
    side.controls().command.store(true, Ordering::Relaxed);
    until(client, SessionState::CommandingActive, &mut state).expect("a motion");
}
