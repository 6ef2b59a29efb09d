//! The program as its users run it: commands, processes, services, and what
//! others read of its files.

mod arms;
mod docs;
mod everyday;
mod field;
mod fleet;
mod kills;
mod main_job;
mod page;
mod paths;
mod processes;
mod services;
mod support;
