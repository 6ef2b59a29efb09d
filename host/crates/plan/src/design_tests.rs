use spherecal_shared::robot::iiwa7_tool;

use super::*;
use crate::test_support::assert_continuous;
use crate::{PlatePose, Visit, paper_plan};

fn quick(poses: usize) -> DesignRequest {
    let mut request = DesignRequest::new(poses);
    request.range.candidates = 700;
    request.passes = 1;
    request
}

fn promised(plan: &Plan) -> Accuracy {
    *plan.promise.last().expect("a design promises")
}

// Fails if the chosen poses do not predict a smaller error than thirty times as many on the paper's
// grid, if the prediction differs from the one computed from the plan alone, if a move is not
// continuous, or if planning is not deterministic.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_sixty_chosen_poses_promise_more_than_the_papers_grid() {
    let cell = Cell::iiwa7();
    let request = quick(60);
    let designed = design(&cell, &request).expect("a plan");
    let promise = promised(&designed);
    assert_eq!(designed.recorded(), 60);
    assert_continuous(&cell, &request.rules, &designed);
    let from_plan = predicted_accuracy(&cell, &designed, &request.options).expect("a valid plan");
    assert!((from_plan.mean_mm - promise.mean_mm).abs() < 1e-9);
    let grid = paper_plan(&cell).expect("a plan");
    let paper = predicted_accuracy(&cell, &grid, &request.options).expect("a valid plan");
    println!(
        "60 chosen {:?} in {:.0} s, paper {paper:?} in {:.0} s",
        promise, designed.robot_s, grid.robot_s
    );
    assert!(promise.mean_mm < 0.9 * paper.mean_mm);
    let falling = designed.promise.windows(2).all(|w| w[1].mean_mm <= w[0].mean_mm * 1.02);
    assert!(falling, "{:?}", designed.promise);
    let again = design(&cell, &request).expect("a plan");
    assert_eq!(designed, again);
}

// Fails if the plan for a requested accuracy does not predict it, if far fewer poses would do, or
// if an unreachable or impossible accuracy is accepted.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_an_asked_accuracy_says_how_many_poses_it_takes() {
    let cell = Cell::iiwa7();
    let mut request = quick(60);
    request.range.candidates = 400;
    let plan = design_for(&cell, &request, 0.25).expect("a plan");
    let poses = plan.recorded();
    println!("{poses} poses: {:?}", promised(&plan));
    assert!(promised(&plan).mean_mm <= 0.25 && (10..100).contains(&poses));
    let fewer = DesignRequest {
        poses: poses * 3 / 4,
        ..request.clone()
    };
    assert!(promised(&design(&cell, &fewer).expect("a plan")).mean_mm > 0.25);
    let refused = design_for(&cell, &request, 0.01).expect_err("out of reach");
    assert!(matches!(refused, PlanError::Accuracy { .. }), "{refused}");
    assert!(design_for(&cell, &request, f64::NAN).is_err());
}

// Fails if more contacts are planned than allowed, if a sphere is left out, if a branch brings
// nothing, or if less patience takes more time.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_contacts_and_robot_time_are_bounded_as_asked() {
    let cell = Cell::iiwa7();
    let plan_of = |contacts: usize, patience: f64| {
        let request = DesignRequest {
            contacts,
            patience,
            ..quick(60)
        };
        design(&cell, &request).expect("a plan")
    };
    let (three, five) = (plan_of(3, 1.0), plan_of(5, 1.0));
    let mut ids: Vec<u32> = three.spheres.iter().map(|s| s.sphere_id).collect();
    ids.sort_unstable();
    assert_eq!(ids, [1, 2, 3]);
    assert!(five.spheres.len() <= 5 && five.spheres.len() > 3);
    assert!(promised(&five).mean_mm < promised(&three).mean_mm);
    let hasty = plan_of(3, 0.05);
    println!("patient {:.0} s, hasty {:.0} s", three.robot_s, hasty.robot_s);
    assert!(hasty.robot_s <= three.robot_s);
}

// Fails if the arm leaves a sphere in another orientation than it came, or if the first visit does
// not begin at home.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_visits_begin_where_the_last_one_ended() {
    let cell = Cell::iiwa7();
    let plan = design(&cell, &quick(60)).expect("a plan");
    for visit in &plan.spheres {
        let last = visit.poses.last().expect("poses");
        let same_turn = last
            .orientation
            .iter()
            .zip(&visit.approach.orientation)
            .all(|(a, b)| (a - b).abs() < 1e-9);
        assert!(last.via && same_turn, "sphere {} is left in neutral", visit.sphere_id);
    }
    assert!(plan.spheres[0].over_home || plan.spheres.len() == 1);
}

#[test]
#[ignore = "slow: the gate runs it"]
fn slow_arms_without_an_elbow_and_several_placements_are_planned() {
    let mut cell = Cell {
        robot: spherecal_model::robots::built_in("ur10e").expect("built in").robot,
        tool: iiwa7_tool(),
        tool_yaw_rad: None,
        plates: vec![PlatePose::level([0.65, 0.0, 0.2], 0.0)],
        ..Cell::iiwa7()
    };
    let mut request = quick(45);
    request.range.candidates = 300;
    let one = design(&cell, &request).expect("a plan");
    assert_continuous(&cell, &request.rules, &one);
    cell.plates.push(PlatePose::level([0.1, 0.6, 0.5], 0.7));
    let two = design(&cell, &request).expect("a plan");
    println!("ur10e: one place {:?}, two places {:?}", promised(&one), promised(&two));
    assert!(two.spheres.iter().any(|s| s.place == 1));
    let places: Vec<usize> = (0..2)
        .map(|k| two.spheres.iter().filter(|s| s.place == k).map(Visit::recorded).sum())
        .collect();
    assert!(places.iter().all(|count| *count >= 10), "{places:?}");
    let from_plan = predicted_accuracy(&cell, &two, &request.options).expect("a valid plan");
    assert!((from_plan.mean_mm - promised(&two).mean_mm).abs() < 1e-9);
}

#[test]
fn any_positive_number_of_poses_can_be_asked_for() {
    let cell = Cell::iiwa7();
    for poses in [1, 2, 7] {
        let mut request = quick(poses);
        request.range.candidates = 100;
        assert_eq!(design(&cell, &request).expect("a plan").recorded(), poses);
    }
    let refusal = design(&cell, &DesignRequest::new(0)).expect_err("none");
    assert!(refusal.to_string().contains("poses is 0"), "{refusal}");
}
