//! Chains with a joint that slides or follows another, as good as plain least squares, and written back.

use crate::chain_urdfs::{lift, parallelogram, rail, scara, telescope};
use crate::chains::circle;

/// Fails as [`circle`] says, or if the chain that is shown lacks a joint.
fn check(urdf: &str, ends: &str, others: &[&str], shown: &[&str]) {
    let folder = tempfile::tempdir().expect("a folder");
    let said = circle(folder.path(), urdf, ends, others, "talos_tcp");
    assert!(shown.iter().all(|words| said.contains(words)), "{said}");
}

// A torso that slides, with a head whose column is not used.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_an_arm_on_a_lift_is_identified() {
    check(
        &lift(),
        "base_link:tool0",
        &["head_joint"],
        &["(lift_joint) was fitted with the whole chain"],
    );
}

#[test]
#[ignore = "slow: the gate runs it"]
fn slow_an_arm_on_a_rail_is_identified() {
    check(&rail(), "world:tool0", &[], &["(rail_joint) was fitted"]);
}

#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_scara_is_identified() {
    check(&scara(), "base_link:tool0", &[], &["(j3) was fitted"]);
}

// A slide between hinges: its own zero is a part of the chain.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_boom_between_hinges_is_identified() {
    check(&telescope(), "base_link:tool0", &[], &["(boom) was fitted"]);
}

// A joint that follows another has no column.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_parallelogram_is_identified() {
    check(&parallelogram(), "base_link:tool0", &[], &[]);
}
