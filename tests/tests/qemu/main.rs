//! The controller on an emulated Cortex-M7: bit for bit as in-process, in
//! time, within its stack and its instruction budget.

mod budget;
mod golden;
mod links;
mod lockstep;
mod run;
mod time;
mod worst;
