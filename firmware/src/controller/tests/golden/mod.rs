//! Golden runs: every phase, every fault and every kind of drive, bit by bit.
//!
//! Each scenario is a scripted run of the simple arm ([`crate::testing`]), or a list of calls of
//! one part of the law. Its hash covers all torques, events, fault reports and telemetry samples.
//! So a change of behaviour that no other test states is noticed too. A golden run does not say
//! what is right: a property or an independent reference does, and stands beside the code.
//!
//! **A test here fails after a change on purpose?** It prints the new rows. Read which scenarios
//! changed, and whether their ends are still right. Then paste the rows into `table.rs`. A
//! refactoring changes no row.
//!
//! The bits are the same on every machine: arms, law and noise use `libm` alone, in one order.

mod drives;
mod faults;
mod guards;
mod law;
mod starts;
mod state_faults;
mod table;
mod tasks;

use std::format;
use std::string::String;
use std::vec::Vec;

use spherecal_shared::protocol::host::Command;

use crate::testing::{Bench, Digest};
use table::TABLE;

/// A scenario: its name, and what runs it.
type Scenario = (&'static str, fn() -> Bench);

/// How a run ended: its faults in order, and the last phase.
fn end(bench: &Bench) -> String {
    let faults: String = bench
        .faults()
        .iter()
        .map(|f| format!("{:?} in {:?}, ", f.fault, f.phase))
        .collect();
    format!("{faults}{:?}", bench.controller.phase())
}

/// Compares rows with the table. Fails with all rows that differ, ready to be pasted.
fn compare(rows: &[(&str, String, u64)]) {
    let text = |(name, end, hash): &(&str, String, u64)| format!("    ({name:?}, {end:?}, 0x{hash:016x}),\n");
    let differ: Vec<String> = rows
        .iter()
        .filter(|(name, end, hash)| !TABLE.contains(&(name, end.as_str(), *hash)))
        .map(text)
        .collect();
    assert!(
        differ.is_empty(),
        "{} of {} scenarios changed:\n{}",
        differ.len(),
        rows.len(),
        differ.concat()
    );
}

fn run(scenarios: &[Scenario]) {
    let rows: Vec<_> = scenarios
        .iter()
        .map(|(name, run)| {
            let bench = run();
            (*name, end(&bench), bench.digest.value())
        })
        .collect();
    compare(&rows);
}

/// After a fault: holds, then clears it and holds again.
fn recover(mut bench: Bench) -> Bench {
    bench.run(150);
    bench.controller.command(Command::ClearFault).expect("always");
    bench.run(100);
    bench
}

// Each of these fails if a bit of a torque, an event or a sample of its runs changes.

#[test]
fn tasks() {
    run(tasks::ALL);
}

#[test]
fn faults_of_phases() {
    run(faults::ALL);
}

#[test]
fn faults_of_states() {
    run(state_faults::ALL);
}

#[test]
fn kinds_of_drives() {
    run(drives::ALL);
}

#[test]
fn parts_of_the_law() {
    compare(&law::rows());
}

#[test]
fn parts_of_the_guards() {
    compare(&guards::rows());
}

// Fails if a row of the table belongs to no scenario, or two scenarios have one name.
#[test]
fn every_row_has_its_scenario() {
    let mut names: Vec<&str> = [tasks::ALL, faults::ALL, state_faults::ALL, drives::ALL]
        .concat()
        .iter()
        .map(|(name, _)| *name)
        .collect();
    names.extend(law::NAMES.iter().chain(guards::NAMES));
    names.sort_unstable();
    let mut rows: Vec<&str> = TABLE.iter().map(|(name, ..)| *name).collect();
    rows.sort_unstable();
    assert_eq!(names, rows);
    names.dedup();
    assert_eq!(names.len(), rows.len());
}

/// A digest of many values as a row.
fn row(name: &'static str, digest: Digest) -> (&'static str, String, u64) {
    (name, String::new(), digest.value())
}
