//! A plate that is moved: planned, asked for, measured and identified in two
//! placements, each with its own unknown pose.

use std::collections::BTreeSet;

use spherecal::campaign::CampaignError;
use spherecal::job::{Config, PreparedRun, evaluate, summarise};
use spherecal::link::{Device, LinkError, LocalDevice};
use spherecal::simulated::{self, prepare};
use spherecal_tests::plan::{carry_out, cell, measured, plant};

/// Two placements: the paper's, and one 120 mm to the side, 100 mm higher and turned.
fn two_places() -> PreparedRun {
    let mut config = Config::default().on_preset("typical");
    config.plan.poses = 60;
    config.plan.range.candidates = 700;
    let mut second = config.cell.placements[0];
    second.origin_m[1] += 0.12;
    second.origin_m[2] += 0.10;
    second.rpy_rad[2] += 0.3;
    config.cell.placements.push(second);
    prepare(&config).expect("a plan")
}

// Fails if a placement is left out, if the plate is moved to and fro, if a pose
// of either is not recorded, or if two placements, of which each brings six
// unknowns more, do not calibrate.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_two_placements_calibrate_the_arm() {
    let prepared = two_places();
    let places: Vec<u32> = prepared.plan.spheres.iter().map(|v| v.place).collect();
    assert!(places.is_sorted() && places.contains(&1), "{places:?}");
    let measurements = measured(&prepared);
    assert_eq!(measurements.recordings.len(), 60);
    assert!(measurements.faults.is_empty(), "{:?}", measurements.faults);
    // Whoever waits is told of each step: the fit, and each of the two models by the tracker.
    let mut steps = 0;
    let evaluation = evaluate(&measurements, &mut |_| steps += 1).expect("identified");
    assert_eq!(steps, 3);
    let summary = summarise(&measurements, &evaluation, "2026-11-23T10:00:00Z").expect("summarised");
    let error = |model: &str| summary.validation.models[model].best_fit.mean_mm;
    println!("sphere {:.3} mm, nominal {:.3} mm", error("sphere"), error("nominal"));
    assert!(error("sphere") < 0.15 * error("nominal"));
}

/// A cell whose plate only a person can move.
struct Real(LocalDevice);

impl Device for Real {
    fn now_us(&self) -> u64 {
        self.0.now_us()
    }

    fn ticks(&self) -> u64 {
        self.0.ticks()
    }

    fn step(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        self.0.step(down, up)
    }
}

// Fails if a campaign goes on, or waits for ever, where nobody can move the plate.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_nobody_to_move_the_plate_is_said() {
    let prepared = two_places();
    let plan = prepared.plan.clone();
    let mut real = Real(cell(plant(
        &simulated::plant(&prepared.config).expect("a plant"),
        &plan,
    )));
    let (_, _, result) = carry_out(&mut real, &plan, &BTreeSet::new());
    let error = result.expect_err("nobody is there");
    assert!(matches!(error, CampaignError::Plate { place: 0 }), "{error}");
    assert!(error.to_string().contains("placement 1"), "{error}");
}
