use nalgebra::Vector3;
use spherecal_model::chain::{Chain, TcpPose};
use spherecal_shared::procedure::Limits;
use spherecal_shared::robot::{Tool, iiwa7_tool};

use crate::{Cell, DesignRequest, Plan, Rules, Scene, design, spread_plan, suggest};

fn cell() -> (Plan, Chain) {
    let cell = Cell::iiwa7();
    let chain = Chain::new(&cell.robot, &cell.tool).expect("an arm");
    (spread_plan(&cell, 60).expect("a plan"), chain)
}

fn scene(plan: &Plan, chain: &Chain) -> Scene {
    Scene::new(plan, chain, 0, &Limits::default(), &[])
}

/// The arm at a pose of a plan, moved by `by` (F0, m).
fn beside(chain: &Chain, joints: &[f64], by: Vector3<f64>) -> Option<Vec<f64>> {
    let pose = chain.pose(joints);
    let moved = TcpPose {
        position: pose.position + by,
        elbow: None,
        ..pose
    };
    chain.follow(&moved, joints)
}

// Fails if a planned move of an undisturbed run needs a via: its recordings would change.
#[test]
fn planned_travel_is_clear() {
    let (plan, chain) = cell();
    let scene = scene(&plan, &chain);
    for visit in &plan.spheres {
        assert!(
            scene.is_clear(&plan.home.joints, &visit.approach.joints),
            "sphere {}",
            visit.sphere_id
        );
        assert!(scene.is_clear(&visit.approach.joints, &plan.home.joints));
    }
}

// Fails if the planner chooses a branch for a built-in arm in which a link is in the plate or in
// another sphere, or from which no clear motion leads home or to the next visit. The arms of Universal
// Robots reach the default plate with the elbow below it, too. Each arm has the paper's tool, and none.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_every_built_in_arm_stands_clear() {
    let tools = [iiwa7_tool(), Tool::default()];
    let arms = spherecal_shared::robot::BUILT_IN.iter();
    for (name, tool) in arms.flat_map(|name| tools.map(|tool| (name, tool))) {
        let robot = spherecal_shared::robot::built_in(name).expect("built in");
        let mut cell = Cell {
            robot,
            tool,
            tool_yaw_rad: None,
            ..Cell::iiwa7()
        };
        let chain = Chain::new(&cell.robot, &cell.tool).expect("an arm");
        let mut request = DesignRequest::new(24);
        request.range.candidates = 120;
        request.passes = 1;
        let plan = design(&cell, &request).or_else(|_| {
            cell.plates = vec![suggest(&cell, &chain, &Rules::default()).expect("a placement")];
            design(&cell, &request)
        });
        let plan = plan.unwrap_or_else(|error| panic!("{name}: {error}"));
        let scene = scene(&plan, &chain);
        let mut here = &plan.home.joints;
        for visit in &plan.spheres {
            let id = visit.sphere_id;
            if visit.over_home {
                assert!(scene.way(here, &plan.home.joints).is_some(), "{name}: home");
                here = &plan.home.joints;
            }
            let way = scene.way(here, &visit.approach.joints);
            let way = way.unwrap_or_else(|| panic!("{name}: no way to sphere {id}"));
            assert!(way.len() == 1, "{name}: {} vias to sphere {id}", way.len() - 1);
            for pose in &visit.poses {
                let clear = scene.standing(&pose.joints, Some(id));
                assert_eq!(clear, Ok(()), "{name}: pose {} at sphere {id}", pose.id);
            }
            here = &visit.approach.joints;
        }
        assert!(scene.way(here, &plan.home.joints).is_some(), "{name}: home at the end");
    }
}

// Fails if a retreat or a return from any pose of the plan, with the nest on the sphere or pushed
// off it to any side, touches a sphere or the plate, or if no way is found.
#[test]
fn from_every_pose_a_clear_way_leads_back() {
    let (plan, chain) = cell();
    let scene = scene(&plan, &chain);
    let (mut ways, mut vias, mut tight) = (0, 0, 0);
    for visit in &plan.spheres {
        for pose in visit.poses.iter().filter(|p| !p.via) {
            for k in 0..5 {
                let angle = f64::from(k) * core::f64::consts::TAU / 4.0;
                let side = Vector3::new(angle.cos(), angle.sin(), 0.3) * if k == 4 { 0.0 } else { 0.03 };
                let Some(q) = beside(&chain, &pose.joints, side) else {
                    continue;
                };
                let direction = scene.retreat(&q, visit.approach_direction, 0.05, 0);
                tight += usize::from(!scene.leaves_clear(&q, direction, 0.05));
                let Some(off) = beside(&chain, &q, -Vector3::from(direction) * 0.05) else {
                    continue;
                };
                let way = scene
                    .way(&off, &visit.approach.joints)
                    .unwrap_or_else(|| panic!("pose {} pushed to side {k}: no way", pose.id));
                assert_eq!(way.last(), Some(&visit.approach.joints));
                vias += way.len() - 1;
                ways += 1;
                // Checked again with finer steps, for the nest against the spheres alone.
                let mut from = off;
                for to in &way {
                    for part in 0..=200 {
                        let t = f64::from(part) / 200.0;
                        let q: Vec<f64> = from.iter().zip(to).map(|(a, b)| a + (b - a) * t).collect();
                        let pose = chain.pose(&q);
                        let centre = pose.rotation.inverse() * (Vector3::from(visit.position_m) - pose.position);
                        let inside = centre.xy().norm() < 0.042 && centre.z < -0.02 && centre.z > -0.06;
                        assert!(!inside, "the sphere's centre is in the nest's body");
                    }
                    from.clone_from(to);
                }
            }
        }
    }
    assert!(ways > 200, "{ways} ways, {vias} vias, {tight} tight retreats");
    assert!(tight * 10 < ways, "{tight} of {ways} retreats are not clear");
}

// Fails if a way leads over a via that the controller refuses: an arm that was pushed to the end of a joint's range, or beyond
// the margin of it, was told to lift itself there, and the run ended.
#[test]
fn no_via_is_at_the_end_of_a_range() {
    let (plan, chain) = cell();
    let scene = scene(&plan, &chain);
    let margin = Limits::default().position_margin_rad;
    let last = chain.limits()[6];
    let mut vias = 0;
    for visit in &plan.spheres {
        for pose in &visit.poses {
            for room in [0.003, 0.0095, 0.012] {
                for end in [last.min_rad + room, last.max_rad - room] {
                    let mut q = pose.joints.clone();
                    q[6] = end;
                    let way = scene.way(&q, &visit.approach.joints).unwrap_or_default();
                    vias += way.len().saturating_sub(1);
                    let tight = way.iter().find(|via| chain.limit_margin(via) < margin);
                    assert_eq!(tight, None, "pose {}, {room} rad from the end", pose.id);
                }
            }
        }
    }
    assert!(vias > 0, "nothing was in the way");
}

// Fails if a way leads from under the plate through it: its first move hit a sphere from below.
#[test]
fn from_under_the_plate_no_way_is_known() {
    let (plan, chain) = cell();
    let scene = scene(&plan, &chain);
    let sphere = &plan.spheres[2];
    let home = &plan.home.joints;
    assert!(scene.way(&sphere.approach.joints, home).is_some());
    let down = Vector3::new(0.0, 0.0, -0.019);
    let start = sphere.approach.joints.clone();
    let under = (0..10)
        .try_fold(start, |q, _| beside(&chain, &q, down))
        .expect("within reach");
    assert!(scene.way(&under, home).is_none());
}

// Fails if a motion through a sphere or through its post counts as clear, or
// if one that only comes back in does not.
#[test]
fn what_is_in_the_way_is_noticed() {
    let (plan, chain) = cell();
    let visit = &plan.spheres[0];
    let at = |by: Vector3<f64>| {
        let seated = beside(
            &chain,
            &visit.approach.joints,
            Vector3::from(visit.approach_direction) * 0.05,
        );
        beside(&chain, &seated.expect("the sphere"), by).expect("within reach")
    };
    let clear = scene(&plan, &chain);
    let (left, right) = (at(Vector3::new(0.0, -0.12, 0.0)), at(Vector3::new(0.0, 0.12, 0.0)));
    assert!(!clear.is_clear(&left, &right), "through the sphere");
    let way = clear.way(&left, &right).expect("a way over it");
    assert!(way.len() > 1);
    let (low, other) = (
        at(Vector3::new(0.0, -0.12, -0.055)),
        at(Vector3::new(0.0, 0.12, -0.055)),
    );
    assert!(!clear.is_clear(&low, &other), "through the post");
    assert!(clear.is_clear(&low, &left), "out of the plate's margin");
    let limits = Limits {
        workspace_max_m: [10.0, chain.pose(&left).position.y - 0.001, 10.0],
        ..Limits::default()
    };
    let fenced = Scene::new(&plan, &chain, 0, &limits, &[]);
    let inside = at(Vector3::new(0.0, -0.2, 0.0));
    assert!(fenced.is_clear(&left, &inside), "back in");
}
