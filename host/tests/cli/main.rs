//! The program as its users run it: commands, processes, services, and what
//! others read of its files.
//!
//! What a feature brings is tested only where it is: `cargo test --workspace`
//! builds all of them (spherecal-tests asks for them), `cargo test -p spherecal` none.

mod accuracy;
mod arguments;
mod arms;
mod bags;
mod before_planning;
mod certificate;
mod chain_urdfs;
mod chains;
mod check;
mod circles;
mod collect;
#[cfg(target_os = "linux")]
mod commission;
mod contracts;
mod damaged;
mod docs;
mod everyday;
mod field;
mod first_cell;
#[cfg(all(feature = "services", feature = "postgres"))]
mod fleet;
#[cfg(target_os = "linux")]
mod floods;
mod folders;
mod hard;
#[cfg(target_os = "linux")]
mod hostile;
mod impedance;
mod kills;
mod left_out;
mod looks;
mod main_job;
mod mistakes;
mod official_clients;
mod page;
#[cfg(unix)]
mod pages;
mod paths;
mod processes;
mod real_data;
mod recorders;
mod refused;
#[cfg(unix)]
mod release;
mod robot_sides;
#[cfg(feature = "services")]
mod services;
mod slides;
mod sources;
mod support;
mod targets;
mod tips;
mod universal_robots;
mod wire_kills;
