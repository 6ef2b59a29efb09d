//! What the tests of client against cabinet share: a cabinet, a soft control law, and a network that can fail.

use std::net::SocketAddr;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use spherecal_cyclic::testing::{Faults, LOCAL, Relay, joint_impedance};
use spherecal_fri::client::{Client, ClientConfig, ClientError, Cycle, MonitoredState, TorqueLimits};
use spherecal_fri::robot::{CabinetConfig, CabinetSide, JointArm, START, Tolerance};
use spherecal_fri::wire::SessionState;

/// Settings of a client on this machine, on any free port. The timeout is long: two cores are shared.
pub(crate) fn config() -> ClientConfig {
    ClientConfig {
        address: LOCAL,
        timeout: Duration::from_secs(2),
        ..ClientConfig::new(TorqueLimits::IIWA_7)
    }
}

/// A tolerant cabinet with the simple arm, which the test can push, for the client at this address.
pub(crate) fn cabinet(client: SocketAddr) -> (CabinetSide, Arc<Mutex<JointArm>>) {
    cabinet_with(CabinetConfig {
        client,
        tolerance: Tolerance::tolerant(),
        ..CabinetConfig::new()
    })
}

pub(crate) fn cabinet_with(config: CabinetConfig) -> (CabinetSide, Arc<Mutex<JointArm>>) {
    let arm = Arc::new(Mutex::new(JointArm::new(START)));
    let side = CabinetSide::start(config, Box::new(Arc::clone(&arm))).expect("a cabinet");
    (side, arm)
}

/// A joint impedance that holds `at`, rad.
pub(crate) fn hold(at: [f64; 7]) -> impl Fn(&MonitoredState) -> [f64; 7] {
    let law = joint_impedance(at);
    move |state| law(&state.q, &state.dq)
}

/// The largest distance of a joint from `at`, rad.
pub(crate) fn deviation(state: &MonitoredState, at: &[f64; 7]) -> f64 {
    spherecal_cyclic::testing::deviation(&state.q, at)
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
        if state.session == session {
            return Ok(cycle);
        }
    }
    panic!("the session stays in {}", state.session);
}

/// A client that commands: the session is in COMMANDING_ACTIVE.
pub(crate) fn commanding(config: &ClientConfig) -> (Client, CabinetSide, Arc<Mutex<JointArm>>) {
    let mut client = Client::listen(config).expect("a client");
    let (side, arm) = cabinet(client.address().expect("an address"));
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

/// A network between cabinet (A) and client (B).
pub(crate) struct Network {
    pub(crate) faults: Arc<Faults>,
    /// Where the cabinet sends.
    pub(crate) address: SocketAddr,
    _relay: Relay,
}

impl Network {
    /// In front of the client at `client`. `seed` decides which datagrams are lost.
    pub(crate) fn before(client: SocketAddr, seed: u64) -> Self {
        let relay = Relay::start(seed);
        relay.set_b(client.port());
        Self {
            faults: Arc::clone(&relay.faults),
            address: relay.for_a,
            _relay: relay,
        }
    }
}
