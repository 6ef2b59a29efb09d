//! The interfaces of Universal Robots: the Real-Time Data Exchange (RTDE), the primary interface, and the dashboard or, on
//! PolyScope X, the Robot API.
//!
//! Three rooms:
//! - [`wire`]: packages of RTDE (protocol 2) and of the primary interface, and HTTP, encoded and decoded byte by byte.
//! - [`client`]: reads a real robot, and commands its torques.
//! - [`robot`]: the robot's side, in front of a simulated arm, so that any client can be tested without a robot.
//!
//! Data flow: arm ⇄ [`robot`] ⇄ TCP ⇄ [`client`]. The crate knows nothing of the rest of spherecal. It contains no part of
//! the maker's software.
//!
//! # Conventions
//! - SI units everywhere: rad, rad/s, m, N, N m, s. All numbers on the wire are big endian.
//! - Names are the maker's where it has one (`actual_q`, `PROTECTIVE_STOP`), so that users find them.
//!
//! Nothing in this crate has been tried on a real robot.

pub mod client;
pub mod robot;
pub mod wire;

/// Number of joints of every arm of this maker.
pub const JOINTS: usize = 6;
/// TCP port of RTDE on a robot.
pub const RTDE_PORT: u16 = 30004;
/// How far the port of the primary interface (30001 on a robot) is below that of RTDE.
pub const PRIMARY_BELOW_RTDE: u16 = 3;
/// How far the port of the dashboard (29999 on a robot) is below that of RTDE.
pub const DASHBOARD_BELOW_RTDE: u16 = 5;

/// The port of the Robot API of PolyScope X on a robot with this port of RTDE: 80 on a robot with the usual ports. Beside
/// another port of RTDE, as a simulated robot may have it, it takes the place of the dashboard, which PolyScope X has not.
pub const fn robot_api_port(rtde: u16) -> u16 {
    match rtde {
        RTDE_PORT => 80,
        other => other.saturating_sub(DASHBOARD_BELOW_RTDE),
    }
}
