//! The geometry alone against the full model that it stands for.

use nalgebra::Vector3;
use spherecal_model::chain::Chain;
use spherecal_shared::robot::{iiwa7, iiwa7_tool};

use crate::statement::measured_rows;
use crate::testing::points;
use crate::{Calibration, Experiment, GeometryOnly, Method, Options, Statement, halton_configurations, identify};

/// The geometry alone of a calibration of `experiment`, over its own postures.
fn alone(full: &Calibration, experiment: &Experiment) -> GeometryOnly {
    let rows = measured_rows(experiment, full);
    let statement = Statement::new(full, &rows, &[], None);
    let postures: Vec<Vec<f64>> = experiment.observations.iter().map(|o| o.q.clone()).collect();
    GeometryOnly::of(full, experiment, &postures, statement.as_ref()).unwrap()
}

// Fails if the geometry alone is not closer to the full model than the full model's
// own table without its effects, or if its stated error is not its true one within
// 15 % on configurations that it was not fitted at.
#[test]
fn geometry_alone_takes_up_the_mean_of_the_effects() {
    let (robot, tool) = (iiwa7(), iiwa7_tool());
    let chain = Chain::unchecked(&robot, &tool);
    // Joints that yield under a load that turns with them. The cosine has a mean over the
    // range of a joint, which an offset can take up; a sine would have none.
    let yielding = |q: &[f64]| -> Vec<f64> { q.iter().map(|q| q - 6e-4 * q.cos()).collect() };
    let experiment = points((&robot, &tool), halton_configurations(&robot, 300), |q| {
        chain.tcp_of(&chain.frames(&yielding(q)))
    });
    let full = identify(&experiment, &Options::default()).unwrap();
    let alone = alone(&full, &experiment);
    let judging: Vec<Vec<f64>> = halton_configurations(&robot, 900).split_off(700);
    let truth: Vec<Vector3<f64>> = judging
        .iter()
        .map(|q| chain.tcp_of(&chain.frames(&yielding(q))))
        .collect();
    let error_mm = |robot: &spherecal_shared::robot::Robot, tool: &spherecal_shared::robot::Tool| {
        let chain = Chain::unchecked(robot, tool);
        let own: Vec<Vector3<f64>> = judging.iter().map(|q| chain.tcp_of(&chain.frames(q))).collect();
        let base = spherecal_model::fit_pose(&own, &truth).unwrap();
        let sum: f64 = own.iter().zip(&truth).map(|(a, b)| (base.point(a) - b).norm()).sum();
        sum * 1e3 / judging.len() as f64
    };
    let (bare, best) = (error_mm(&full.robot, &full.tool), error_mm(&alone.robot, &alone.tool));
    assert!(best < bare, "{best} mm against {bare} mm");
    let stated = alone.expected_error_mm.unwrap().mean;
    assert!((stated / best - 1.0).abs() < 0.15, "stated {stated} mm, true {best} mm");
    // A geometry has nothing to lose.
    let plain = Options {
        method: Method::Geometry,
        ..Options::default()
    };
    let plain = identify(&experiment, &plain).unwrap();
    assert!(
        super::GeometryOnly::of(&plain, &experiment, &judging, None)
            .unwrap()
            .apart_mm
            < 2e-2
    );
}

// Fails if directions that hardly move the TCP are bent to fit the effects: with the
// TCP on the last axis a table of any length would do for them.
#[test]
fn directions_that_hardly_move_the_tcp_stay_where_they_are() {
    let robot = iiwa7();
    let tool = spherecal_shared::robot::Tool {
        tcp_m: [0.0, 0.0, 0.04],
        ..iiwa7_tool()
    };
    let chain = Chain::unchecked(&robot, &tool);
    // Effects of several orders and of neighbours, which no table takes up.
    let yielding = |q: &[f64]| -> Vec<f64> {
        let next = |j: usize| q[(j + 1) % q.len()];
        (0..q.len())
            .map(|j| q[j] - 6e-4 * q[j].cos() - 4e-4 * (2.0 * q[j] + next(j)).sin())
            .collect()
    };
    let experiment = points((&robot, &tool), halton_configurations(&robot, 200), |q| {
        chain.tcp_of(&chain.frames(&yielding(q)))
    });
    let full = identify(&experiment, &Options::default()).unwrap();
    let alone = alone(&full, &experiment);
    for (own, table) in full.robot.joints.iter().zip(&alone.robot.joints) {
        let (own, table) = (own.mdh, table.mdh);
        assert!(
            (own.a - table.a).abs() < 0.02 && (own.d - table.d).abs() < 0.02,
            "{table:?}"
        );
        assert!(
            (own.alpha - table.alpha).abs() < 0.02 && (own.theta - table.theta).abs() < 0.1,
            "{table:?}"
        );
    }
}

// Fails if the projection takes a longer arm for a wrong scale of an instrument, which no file holds: of a real IRB 120 the file
// was 0.38 mm off in place of 0.12.
#[test]
fn a_longer_arm_is_no_wrong_scale() {
    let (robot, tool) = (iiwa7(), iiwa7_tool());
    let mut longer = robot.clone();
    for joint in &mut longer.joints {
        joint.mdh.a *= 1.001;
        joint.mdh.d *= 1.001;
    }
    let chain = Chain::unchecked(&longer, &tool);
    let experiment = points((&robot, &tool), halton_configurations(&robot, 150), |q| {
        chain.tcp_of(&chain.frames(q))
    });
    let mut full = identify(&experiment, &Options::default()).unwrap();
    // As if the lengths of this arm were known well.
    let lengths = full
        .parameters
        .iter_mut()
        .filter(|p| p.name.starts_with(['a', 'd']) && !p.name.starts_with("al"));
    lengths.for_each(|p| p.prior_sigma = 5e-5);
    let apart_mm = alone(&full, &experiment).apart_mm;
    assert!(apart_mm < 0.2, "{apart_mm} mm");
}
