//! The `typical` preset against Table 5 of the paper, over seeds.
//!
//! The laser study of Section 4.3 on the plant: base and tool from arcs, the
//! nominal model on the validation configurations, and a geometry fit to the
//! calibration configurations with base and tool held, as the paper did it.

use nalgebra::{DMatrix, DVector, Vector3};
use spherecal::identify::arcs::{Measured, MeasuredArc, MeasuredFrames, frames_from_arcs};
use spherecal::identify::validate::ErrorStatistics;
use spherecal::model::TrackerSession;
use spherecal::plan::laser::{Arc, LaserPlan, plan};
use spherecal::sim::plant::{Plant, PlantConfig};
use spherecal_shared::robot::{Arm, Robot, Tool, iiwa7, iiwa7_tool};

fn shoot(plant: &mut Plant<7>, session: TrackerSession, configurations: &[Vec<f64>]) -> Vec<Measured> {
    plant.tracker_session(session);
    configurations
        .iter()
        .map(|q| {
            let shot = plant.tracker_shot(&core::array::from_fn(|i| q[i]));
            Measured {
                q: shot.q_encoder.to_vec(),
                point_m: shot.point_m,
            }
        })
        .collect()
}

fn arcs(plant: &mut Plant<7>, session: TrackerSession, arcs: &[Arc]) -> Vec<MeasuredArc> {
    arcs.iter()
        .map(|arc| MeasuredArc {
            joint: arc.joint,
            measured: shoot(plant, session, &arc.configurations),
        })
        .collect()
}

/// Residual vectors (m, tracker frame) of a model on measurements.
fn residuals(robot: &Robot, frames: &MeasuredFrames, measured: &[Measured]) -> Vec<Vector3<f64>> {
    let tool = Tool {
        tcp_m: frames.tool_m,
        ..iiwa7_tool()
    };
    let arm = Arm::<f64, 7>::new(robot, &tool).expect("a robot");
    measured
        .iter()
        .map(|m| {
            let q = core::array::from_fn(|i| m.q[i]);
            let tcp = arm.tcp_frame(&arm.frames(&q)).position;
            Vector3::from(m.point_m) - frames.base.point(&tcp)
        })
        .collect()
}

/// The paper's 21 parameters fitted by Gauss-Newton to points, base and tool
/// held: alpha, a, theta, d of joints 2..7 but for a6, d6 and theta7.
fn fit_geometry(frames: &MeasuredFrames, measured: &[Measured]) -> Robot {
    let mut robot = iiwa7();
    for _ in 0..4 {
        let tool = Tool {
            tcp_m: frames.tool_m,
            ..iiwa7_tool()
        };
        let arm = Arm::<f64, 7>::new(&robot, &tool).expect("a robot");
        let wrong = residuals(&robot, frames, measured);
        let mut normal = DMatrix::<f64>::identity(24, 24) * 1e-9;
        let mut right = DVector::<f64>::zeros(24);
        for (m, r) in measured.iter().zip(&wrong) {
            let q = core::array::from_fn(|i| m.q[i]);
            let chain = arm.frames(&q);
            let columns = arm.parameter_jacobian(&chain, &arm.tcp_frame(&chain).position);
            let j = DMatrix::from_fn(3, 24, |i, k| {
                let c = &columns[1 + k / 4];
                let removed = [(5, 3), (6, 1), (6, 2)].contains(&(1 + k / 4, k % 4));
                if removed {
                    0.0
                } else {
                    [c.alpha, c.a, c.theta, c.d][k % 4][i]
                }
            });
            let local = frames.base.rotation.transpose() * r;
            normal += j.transpose() * &j;
            right += j.transpose() * DVector::from_column_slice(local.as_slice());
        }
        let step = normal.cholesky().expect("regularised").solve(&right);
        for (k, joint) in robot.joints.iter_mut().skip(1).enumerate() {
            joint.mdh.alpha += step[4 * k];
            joint.mdh.a += step[4 * k + 1];
            joint.mdh.theta += step[4 * k + 2];
            joint.mdh.d += step[4 * k + 3];
        }
    }
    robot
}

/// Nominal and laser-calibrated geometry's validation errors for one seed.
fn study(config: &PlantConfig, what: &LaserPlan) -> (ErrorStatistics, ErrorStatistics) {
    let mut plant = Plant::<7>::new(&iiwa7(), &iiwa7_tool(), config, &[0.0; 7]).expect("a plant");
    let base_arcs = arcs(&mut plant, TrackerSession::BaseArcs, &what.base_arcs);
    let tool_arcs = arcs(&mut plant, TrackerSession::ToolArcs, &what.tool_arcs);
    let frames = frames_from_arcs(&iiwa7(), &base_arcs, &tool_arcs).expect("arcs");
    let calibration = shoot(&mut plant, TrackerSession::Measurement, &what.calibration);
    let validation = shoot(&mut plant, TrackerSession::Measurement, &what.validation);
    let judged = |robot: &Robot| {
        let errors: Vec<f64> = residuals(robot, &frames, &validation)
            .iter()
            .map(|r| r.norm() * 1e3)
            .collect();
        ErrorStatistics::of(&errors)
    };
    (judged(&iiwa7()), judged(&fit_geometry(&frames, &calibration)))
}

fn spread(mut values: Vec<f64>) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    [0.1, 0.5, 0.9].map(|part| values[((values.len() - 1) as f64 * part).round() as usize])
}

/// Quantiles 0.1, 0.5 and 0.9 over seeds of mean, std and max: nominal, then laser.
fn quantiles(config: &PlantConfig, seeds: core::ops::RangeInclusive<u64>) -> [[[f64; 3]; 3]; 2] {
    let what = plan(&iiwa7(), &iiwa7_tool(), 1).expect("a laser plan");
    let both: Vec<_> = seeds
        .map(|seed| {
            let config = PlantConfig { seed, ..config.clone() };
            study(&config, &what)
        })
        .collect();
    let of = |f: fn(&(ErrorStatistics, ErrorStatistics)) -> f64| spread(both.iter().map(f).collect());
    [
        [of(|s| s.0.mean_mm), of(|s| s.0.std_mm), of(|s| s.0.max_mm)],
        [of(|s| s.1.mean_mm), of(|s| s.1.std_mm), of(|s| s.1.max_mm)],
    ]
}

/// Fails if the preset's sizes drift away from Table 5 of the paper: nominal
/// 1.403/0.392/2.381, laser 0.645/0.192/0.932 mm (mean/std/max).
///
/// The paper's laser row is three times what geometry alone leaves of this arm: 0.23 mm,
/// and 1.27 mm nominal. The test explains the rest by a reflector that is remounted
/// by 0.62 mm; the preset itself leaves it in place.
///
/// Measured over 40 seeds (10/50/90 %): nominal mean 1.30/1.40/1.48, std
/// 0.50/0.56/0.60, max 2.55/2.83/3.13; laser mean 0.63/0.65/0.71, std
/// 0.15/0.18/0.24, max 0.99/1.13/1.38. The means are the paper's; the nominal
/// std is not: errors that are sums of many Gaussian parts scatter by 0.4 of
/// their mean, the paper's one robot, ruled by two long links, by 0.28.
#[test]
fn typical_is_as_wrong_as_the_papers_robot() {
    let mut config = PlantConfig::typical();
    config.tracker.remount_m = 0.62e-3;
    let [nominal, laser] = quantiles(&config, 1..=40);
    println!(
        "10/50/90 % of 40 seeds, mm: nominal mean {:.3?} std {:.3?} max {:.3?}",
        nominal[0], nominal[1], nominal[2]
    );
    println!(
        "10/50/90 % of 40 seeds, mm: laser   mean {:.3?} std {:.3?} max {:.3?}",
        laser[0], laser[1], laser[2]
    );
    assert!((nominal[0][1] - 1.40).abs() < 0.05);
    assert!((laser[0][1] - 0.645).abs() < 0.04);
    for ([_, found, _], paper) in [
        (nominal[1], 0.392),
        (nominal[2], 2.381),
        (laser[1], 0.192),
        (laser[2], 0.932),
    ] {
        assert!((0.8..1.5).contains(&(found / paper)), "{found:.3} against {paper}");
    }
}

/// An ideal plant is its nominal model.
#[test]
fn ideal_is_nominal() {
    let [nominal, laser] = quantiles(&PlantConfig::ideal(), 1..=1);
    assert!(nominal[2][1] < 1e-6 && laser[2][1] < 1e-6, "{nominal:?} {laser:?}");
}
