//! Tests of every phase, every transition and every fault; they step the time.

mod commands;
mod faults;
mod guard;
mod hostile;
mod poison;
mod sequences;
mod transitions;
