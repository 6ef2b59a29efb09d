//! Where the robot is, how the client talks to it, and the limits that it keeps.

use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;
use std::time::Duration;

use spherecal_budget::robot as budget;
use spherecal_cyclic::{Machine, this_machine};

use crate::wire::Version;
use crate::{JOINTS, PERIOD_S, TCP_PORT};

/// Settings of a connection.
#[derive(Clone, Debug)]
pub struct ClientConfig {
    /// Time and network of this side.
    pub machine: Arc<dyn Machine>,
    /// Address or host name of the robot's control unit.
    pub host: String,
    /// TCP port. A real robot has 1337.
    pub port: u16,
    /// Address of the network card that receives the states.
    pub local: IpAddr,
    /// The versions to try, in this order.
    pub versions: Vec<Version>,
    /// How long to wait for the TCP connection.
    pub connect_timeout: Duration,
    /// How long to wait for a response. An error recovery takes some seconds.
    pub response_timeout: Duration,
    /// How long to wait for a state before the robot counts as silent.
    pub state_timeout: Duration,
    /// Lets the kernel poll the network card for this many microseconds before it sleeps (`SO_BUSY_POLL`, Linux only).
    pub busy_poll_us: Option<u32>,
    /// Polls the socket in a loop for this long before the thread sleeps. It costs a processor core and saves the
    /// wake-up.
    pub spin: Duration,
    /// Limits of the torques that the client sends.
    pub limits: TorqueLimits,
}

impl ClientConfig {
    /// The defaults for a robot at `host`: port 1337, all versions, newest first.
    pub fn new(host: impl Into<String>) -> Self {
        Self {
            machine: this_machine(),
            host: host.into(),
            port: TCP_PORT,
            local: IpAddr::V4(Ipv4Addr::UNSPECIFIED),
            versions: Version::ALL.to_vec(),
            connect_timeout: budget::CONNECT,
            response_timeout: budget::FRANKA_ANSWER,
            state_timeout: Duration::from_millis(100),
            busy_poll_us: None,
            spin: Duration::ZERO,
            limits: TorqueLimits::default(),
        }
    }
}

/// Limits of the torques that the client sends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TorqueLimits {
    /// Largest torque of each joint, N m.
    pub torque: [f64; JOINTS],
    /// Largest change of a joint's torque, N m/s. The robot stops at 1,000.
    pub torque_rate: f64,
}

impl Default for TorqueLimits {
    /// The robot's limits: 87 N m for the joints 1 to 4 and 12 N m for 5 to 7. The rate keeps a margin of 1 N m/s to
    /// the robot's 1,000 N m/s, because version 10 reports the desired torque rounded to 32 bits.
    fn default() -> Self {
        Self {
            torque: [87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0],
            torque_rate: 999.0,
        }
    }
}

/// What the clamp did to a command.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Clamped {
    /// A torque exceeded its limit.
    pub(super) torque: bool,
    /// A torque changed too fast.
    pub(super) rate: bool,
}

impl TorqueLimits {
    /// Brings `wanted` within the limits. All torques must be finite.
    ///
    /// `desired` is the robot's last desired torque (`tau_J_d` of the newest state), `sent` the client's last command.
    /// They differ while a command is under way or lost. The result is within one step of both where that is possible,
    /// and within one step of `desired` always: that is what the robot checks.
    pub(super) fn clamp(
        &self,
        wanted: &[f64; JOINTS],
        desired: &[f64; JOINTS],
        sent: &[f64; JOINTS],
    ) -> ([f64; JOINTS], Clamped) {
        let step = self.torque_rate * PERIOD_S;
        let mut clamped = Clamped::default();
        let mut out = [0.0; JOINTS];
        for joint in 0..JOINTS {
            let limit = self.torque[joint];
            let within = wanted[joint].max(-limit).min(limit);
            clamped.torque |= within != wanted[joint];
            let near_sent = within.max(sent[joint] - step).min(sent[joint] + step);
            out[joint] = near_sent.max(desired[joint] - step).min(desired[joint] + step);
            clamped.rate |= out[joint] != within;
        }
        (out, clamped)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clamp(wanted: f64, desired: f64, sent: f64) -> (f64, Clamped) {
        let first = |value| [value, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let (out, clamped) = TorqueLimits::default().clamp(&first(wanted), &first(desired), &first(sent));
        (out[0], clamped)
    }

    // Fails if a command that the robot would refuse leaves the client, whatever the control law asks for.
    #[test]
    fn every_command_is_within_a_step_of_the_robots_desired_torque() {
        let step = 0.999;
        for wanted in [-1e9, -90.0, -1.0, 0.0, 0.5, 3.0, 90.0, 1e9] {
            for desired in [-87.0, -1.0, 0.0, 0.3, 86.5] {
                for sent in [desired - 1.9, desired - 0.4, desired, desired + 1.9] {
                    let (out, _) = clamp(wanted, desired, sent);
                    assert!(
                        (out - desired).abs() <= step + 1e-12,
                        "{wanted} {desired} {sent}: {out}"
                    );
                }
            }
        }
    }

    // Fails if the clamp changes a command that keeps all limits, or does not say that it changed one.
    #[test]
    fn the_clamp_counts_what_it_changes() {
        assert_eq!(clamp(0.9, 0.0, 0.0), (0.9, Clamped::default()));
        let (out, clamped) = clamp(5.0, 0.0, 0.0);
        assert!((out - 0.999).abs() < 1e-12);
        assert!(clamped.rate && !clamped.torque);
        let (out, clamped) = clamp(100.0, 86.9, 86.9);
        assert_eq!(out, 87.0);
        assert!(clamped.torque && !clamped.rate);
    }

    // Fails if two commands that reach the robot in one period could differ by more than the robot permits: the state
    // does not show the first one yet.
    #[test]
    fn a_command_under_way_is_taken_into_account() {
        let (out, _) = clamp(-5.0, 0.0, 0.999);
        assert!((0.999 - out) <= 0.999 + 1e-12, "{out}");
    }
}
