//! For tests of a client against a robot side: a simulated network with a clock of its own, and a soft control law.

mod ports;
mod world;

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

pub use world::{Faults, World};

/// Any free port of this machine.
pub const LOCAL: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

/// A joint impedance that holds `at`, rad: from `q`, rad, and `dq`, rad/s, to torques, N m.
pub fn joint_impedance(at: [f64; 7]) -> impl Fn(&[f64; 7], &[f64; 7]) -> [f64; 7] {
    let stiffness = [600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0];
    let damping = [50.0, 50.0, 40.0, 40.0, 10.0, 8.0, 2.0];
    move |q, dq| std::array::from_fn(|j| stiffness[j] * (at[j] - q[j]) - damping[j] * dq[j])
}

/// The largest distance of a joint from `at`, rad.
pub fn deviation(q: &[f64; 7], at: &[f64; 7]) -> f64 {
    (0..7).fold(0.0, |most: f64, j| most.max((q[j] - at[j]).abs()))
}
