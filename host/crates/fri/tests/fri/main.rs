//! KUKA's Fast Robot Interface: messages, client against cabinet, faults between them.

mod allocations;
mod cabinet;
mod common;
mod faults;
mod loopback;
mod messages;
mod wire;
