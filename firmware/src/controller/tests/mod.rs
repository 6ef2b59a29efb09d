//! Every phase, every transition, every fault: time stepped by hand.

mod commands;
mod faults;
mod guard;
mod hostile;
mod model;
mod transitions;
