//! Tests of every phase, every transition and every fault; they step the time.

mod commands;
mod details;
mod faults;
mod golden;
mod guard;
mod hostile;
mod impedance;
mod late;
mod poison;
mod pressing;
mod sequences;
mod session;
mod transitions;
mod unstable;
