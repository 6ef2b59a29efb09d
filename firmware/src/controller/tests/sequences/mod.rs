//! The real phase machine under every sequence of inputs to a given depth, from a
//! state in every phase.
//!
//! Inputs are whatever may happen to the controller: commands, time, unusable
//! drive states, a silent host, pushes, a nest that leaves. Every tick of every
//! sequence must have these safety properties:
//!
//! 1. There is no new torque without a new drive state. For an unusable state the
//!    last torque is repeated, at most 23 times in a row; then the brakes are asked
//!    for. Torques are finite, within their limits and within the rate limit.
//! 2. A recording exists only if the nest was seated and still all the time.
//! 3. A fault leads to the fault phase in the same tick, and only `ClearFault` ends
//!    that phase.
//! 4. There is no deadlock: from every state a healthy drive, `Stop` and
//!    `ClearFault` lead to an idle controller that obeys.

mod world;

use std::collections::BTreeSet;
use std::format;
use std::string::String;
use std::vec::Vec;

use world::{INPUTS, Input, World};

/// Worlds in every phase.
fn beginnings() -> Vec<World> {
    let mut world = World::new();
    let mut all = Vec::from([world.clone()]);
    let mut guided = world.clone();
    guided.apply(Input::Guide);
    let mut moving = world.clone();
    moving.apply(Input::Move);
    moving.ticks(100);
    let mut failed = world.clone();
    failed.apply(Input::Gap);
    let mut sprung = world.clone();
    sprung.apply(Input::Spring);
    sprung.ticks(100);
    all.extend([guided, moving, failed, sprung]);
    world.apply(Input::Approach);
    for _ in 0..4 {
        all.push(world.clone());
        for _ in 0..20 {
            let phase = world.bench.controller.phase();
            world.pass(1200);
            if world.bench.controller.phase() != phase {
                break;
            }
        }
    }
    all.push(world.clone());
    world.apply(Input::Pose);
    world.ticks(50);
    all.push(world.clone());
    world.pass(1200);
    world.ticks(40);
    all.push(world.clone());
    world.pass(1200);
    world.apply(Input::Decouple);
    world.ticks(300);
    all.push(world);
    let phases: BTreeSet<String> = all
        .iter()
        .map(|w| format!("{:?}", w.bench.controller.phase()))
        .collect();
    assert_eq!(phases.len(), 13, "{phases:?}");
    all
}

/// Applies every sequence of `depth` inputs to `world`; returns the number of inputs.
fn explore(world: &World, depth: u32, keys: &mut BTreeSet<String>) -> u64 {
    if keys.insert(world.key()) {
        world.check_no_deadlock();
    }
    if depth == 0 {
        return 0;
    }
    let mut count = 0;
    for input in INPUTS {
        let mut next = world.clone();
        next.apply(input);
        count += 1 + explore(&next, depth - 1, keys);
    }
    count
}

// Fails if a sequence of two inputs, from a state in every phase, breaks one of the
// four properties, or if not every sequence was tried.
#[test]
fn every_sequence_of_events_is_safe() {
    let depth = std::env::var("SPHERECAL_DEPTH")
        .ok()
        .and_then(|d| d.parse().ok())
        .unwrap_or(2);
    let mut keys = BTreeSet::new();
    let count: u64 = beginnings().iter().map(|world| explore(world, depth, &mut keys)).sum();
    std::println!(
        "{count} inputs to depth {depth} from 13 phases, {} kinds of state",
        keys.len()
    );
    let inputs = INPUTS.len() as u64;
    let each: u64 = (1..=depth).map(|d| inputs.pow(d)).sum();
    assert_eq!(count, 13 * each);
    assert!(keys.len() >= 20, "{keys:?}");
}

// Fails if a kind of state that any number of inputs reaches breaks one of the four
// properties. Applies every input to each kind of state once, until no new kind
// appears.
#[test]
fn every_kind_of_state_is_safe() {
    let mut keys = BTreeSet::new();
    let mut open = beginnings();
    let mut inputs = 0;
    while let Some(world) = open.pop() {
        if !keys.insert(world.key()) {
            continue;
        }
        world.check_no_deadlock();
        for input in INPUTS {
            let mut next = world.clone();
            next.apply(input);
            inputs += 1;
            if !keys.contains(&next.key()) {
                open.push(next);
            }
        }
    }
    std::println!("{} kinds of state, {inputs} inputs between them", keys.len());
    assert!(keys.len() >= 30, "{keys:?}");
}
