//! The Franka Control Interface: messages, client against robot side, faults between them, official clients.

mod allocations;
mod common;
mod faults;
mod loopback;
mod official_clients;
mod supervisor;
mod wire;
