//! The control task.

use spherecal_shared::protocol::drive::DriveState;
use spherecal_shared::protocol::frame::MAX_FRAME;

use super::FromDrive;
use super::ports::{Clock, DrivePort, HostPort, Probe};
use crate::Node;

/// Bytes of the host link that the control task moves in one period at most.
pub const HOST_BYTES: usize = 8 * MAX_FRAME;

/// Why the control task ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Ended {
    /// The drive has gone for good.
    DriveGone,
    /// The drive is not one that this controller can work with.
    DriveRefused,
}

/// What the control task needs besides its ports: the buffers, kept out of its
/// stack frame.
#[derive(Debug)]
pub struct Workspace<const N: usize> {
    /// The controller and its host link.
    pub node: Node<N>,
    state: DriveState,
    down: [u8; HOST_BYTES],
    up: [u8; HOST_BYTES],
}

impl<const N: usize> Workspace<N> {
    /// A controller that says `build` in its banner.
    pub fn new(build: &str) -> Self {
        Self {
            node: Node::new(build),
            state: DriveState::default(),
            down: [0; HOST_BYTES],
            up: [0; HOST_BYTES],
        }
    }
}

/// Runs the controller: one tick on every beat of `clock`, until the drive has
/// gone for good (on a real board: for ever).
///
/// Without a fresh drive state the tick sees the last one again; the control
/// path tells it by its number, bridges a few and then faults. Missed periods
/// are told to the control path, which counts them, reports them to the host
/// and faults when they are too many.
pub async fn run<const N: usize>(
    work: &mut Workspace<N>,
    clock: &mut impl Clock,
    ports: &mut (impl DrivePort + HostPort + Probe),
) -> Ended {
    let Workspace { node, state, down, up } = work;
    let (mut heard, mut drive_us) = (false, 0);
    loop {
        let beat = clock.next().await;
        if beat.missed > 0 {
            log_warn!("overrun: {} periods missed", beat.missed);
        }
        node.controller().missed(beat.missed);
        while let Some(message) = DrivePort::receive(ports) {
            match message {
                FromDrive::State { state: new, time_us } => {
                    *state = new;
                    drive_us = time_us;
                    heard = true;
                }
                FromDrive::Hello(hello) => {
                    if node.controller().connect(&hello).is_err() {
                        log_error!(
                            "drive refused: protocol {}, {} joints, {} us",
                            hello.protocol,
                            hello.limits.len(),
                            hello.period_us
                        );
                        return Ended::DriveRefused;
                    }
                    log_info!("drive: {} joints, period {} us", hello.limits.len(), hello.period_us);
                }
            }
        }
        if ports.ended() {
            return Ended::DriveGone;
        }
        let now = clock.time(&beat, drive_us);
        let length = HostPort::receive(ports, down);
        let room = ports.room().min(HOST_BYTES);
        let before = node.controller().phase();
        let (command, sent) = node.exchange_probed(
            now,
            state,
            down.get(..length).unwrap_or_default(),
            up.get_mut(..room).unwrap_or_default(),
            ports,
        );
        let after = node.controller().phase();
        if after != before {
            log_info!("phase {} after {}, tick {}", after, before, state.tick);
        }
        if heard {
            DrivePort::send(ports, &command);
        }
        HostPort::send(ports, up.get(..sent).unwrap_or_default());
    }
}
