//! Tests of the wires of Universal Robots, through the crate's public interface.

mod common;
mod loopback;
mod official_client;
mod registers;
mod robot_api;
mod torque;
mod wire;
